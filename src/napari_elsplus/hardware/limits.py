"""Limits that cameras state or that are measured: sensor, frame rate, bus; and a preset's region within them."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING, Final, Protocol, runtime_checkable

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.protocols import Region
from napari_elsplus.instrument.optics import BUNDLE_UM, PRESETS

if TYPE_CHECKING:
    from napari_elsplus.hardware.protocols import Camera
    from napari_elsplus.instrument.optics import Preset

RATE_TOLERANCE: Final = 1e-4
"""Relative excess over a camera's highest rate that is rounding, as the drivers allow it; chosen: a thousand times that
of float32."""


@dataclass(frozen=True, slots=True)
class SensorLimits:
    """Rows and columns of a camera's sensor, and the steps in which a region's size and origin go."""

    rows: int
    cols: int
    row_step: int
    col_step: int
    origin_row_step: int = 1
    origin_col_step: int = 1

    def region(self, share: float = 1.0) -> Region:
        """Return the region of all columns and a share of the rows, rounded down to the camera's steps."""
        rows = max(int(self.rows * share) // self.row_step, 1) * self.row_step
        return Region(0, 0, rows, self.cols // self.col_step * self.col_step)

    def centred(self, shape: tuple[int, int]) -> Region:
        """Return the region of a shape in the middle of the sensor, cut to it and rounded down to its steps."""
        rows = max(min(shape[0], self.rows) // self.row_step, 1) * self.row_step
        cols = max(min(shape[1], self.cols) // self.col_step, 1) * self.col_step
        row = (self.rows - rows) // 2 // self.origin_row_step * self.origin_row_step
        col = (self.cols - cols) // 2 // self.origin_col_step * self.origin_col_step
        return Region(row, col, rows, cols)


@runtime_checkable
class StatesLimits(Protocol):
    """A camera that states its limits; read them while it does not stream."""

    @property
    def sensor(self) -> SensorLimits:
        """Size of the sensor, and the steps of a region."""

    @property
    def frame_rate_limits_hz(self) -> tuple[float, float]:
        """Lowest and highest frame rate at the present region and exposure, in Hz."""


@runtime_checkable
class MeasuresBus(Protocol):
    """A camera that measures how fast its frames come over the bus."""

    @property
    def carried_rate_hz(self) -> float | None:
        """Frames per second that the bus carries, from the frames since `Camera.start`; None until enough came."""


def preset_region(camera: Camera, preset: Preset) -> Region:
    """Return the region of a preset on the sensor of a camera: in its middle, cut to it where it is smaller.

    Parameters
    ----------
    camera : Camera
        It does not stream. One that does not state its sensor has that of the presets.
    preset : Preset
        Camera mode.

    Raises
    ------
    InputError
        If both views of the bundle do not fit on the sensor at the preset's scale.
    """
    if not isinstance(camera, StatesLimits):
        return Region(*preset.sensor_origin, *preset.frame_shape)
    sensor = camera.sensor
    region = sensor.centred(preset.frame_shape)
    if not _holds_views(region, preset):
        rows, cols = _views(preset)
        fitting = [other.name for other in PRESETS.values() if _holds_views(sensor.centred(other.frame_shape), other)]
        raise InputError(
            f"preset {preset.name} on a sensor of {sensor.rows} x {sensor.cols}: the two views of the bundle take "
            f"{rows} x {cols} pixels",
            f"{' or '.join(fitting)} fits" if fitting else "use a camera with a larger sensor",
        )
    return region


def _views(preset: Preset) -> tuple[int, int]:
    """Return the rows and columns of both views of the bundle, side by side."""
    diameter_px = preset.optics.rows(BUNDLE_UM)
    return ceil(diameter_px), ceil(2 * diameter_px)


def _holds_views(region: Region, preset: Preset) -> bool:
    rows, cols = _views(preset)
    return region.rows >= rows and region.cols >= cols


def allowed_rate_hz(camera: Camera, region: Region, slit_rows: int, wanted_hz: float) -> float:
    """Return a wanted frame rate, or the camera's highest where that is lower, in Hz; it may be left at its lowest.

    Parameters
    ----------
    camera : Camera
        It does not stream. One that does not state its limits has none.
    region : Region
        Part of the sensor that is read.
    slit_rows : int
        Exposure in line periods.
    wanted_hz : float
        Frame rate.
    """
    if not isinstance(camera, StatesLimits):
        return wanted_hz
    camera.configure(region, slit_rows=slit_rows, frame_rate_hz=camera.frame_rate_limits_hz[0])
    limit_hz = camera.frame_rate_limits_hz[1]
    return wanted_hz if wanted_hz <= limit_hz * (1 + RATE_TOLERANCE) else limit_hz
