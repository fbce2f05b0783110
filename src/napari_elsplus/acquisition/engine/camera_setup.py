"""Settings of the rig's camera, what follows from them, and what a calibration keeps of them."""

from __future__ import annotations

import time
from math import inf, nan
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.limits import MeasuresBus, allowed_rate_hz, preset_region
from napari_elsplus.hardware.protocols import Region
from napari_elsplus.hardware.scan.timing import ScanTiming
from napari_elsplus.instrument.calibration import AcquiredWith, FrameSection
from napari_elsplus.instrument.optics import preset
from napari_elsplus.instrument.staleness import stale_sections

if TYPE_CHECKING:
    from napari_elsplus.hardware.protocols import Camera
    from napari_elsplus.hardware.rig import Rig
    from napari_elsplus.hardware.scan.timing import StrobePhase
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.instrument.optics import Preset

BUS_SHARE: Final = 0.95
"""Share of the bus that the default frame rate takes where the bus is slow; chosen: leaves time between frames."""
BUS_TIMEOUT_S: Final = 2.0
"""Seconds in which the bus is measured; chosen: 12 frames of a bus of USB 2."""
BUS_POLL_S: Final = 2e-3
"""Seconds between two readings of the measured rate; chosen: half a frame period at 240 Hz."""
SETTLING_FRAMES: Final = 2
"""Invalid frames after a change of region or exposure; documented for another camera of the same maker."""


class SlowBusError(DeviceError):
    """The bus carries fewer frames per second than the default rate."""


class CameraSetup:
    """The camera of a rig and its settings.

    Parameters
    ----------
    rig : Rig
        Open.

    Attributes
    ----------
    settings : Settings
        Of the camera; the defaults until it is configured.
    settling : int
        Frames of the next stream that are invalid.
    notice : str
        Why the frame rate is lower than the preset's; empty if it is not.
    """

    def __init__(self, rig: Rig) -> None:
        self.camera: Camera = rig.camera
        self._rig_name = rig.name
        self.settings = Settings()
        self.settling = 0
        self.notice = ""
        self._region = Region(*self._preset.sensor_origin, *self._preset.frame_shape)
        self._rate_hz = self._preset.optics.frame_rate_hz
        self._bus_bytes_per_s = inf
        self._measured: Region | None = None
        self.bytes_per_s = nan
        """Data rate of raw frames; kept, so that whoever asks does not disturb the camera. NaN until configured."""
        self.configured = False
        """True if the camera has the settings."""

    def configure(self, settings: Settings) -> None:
        """Configure a camera that does not stream by settings; if that fails it is unconfigured.

        Raises
        ------
        InputError
            If the camera cannot do that.
        DeviceError
            If the camera does not answer.
        """
        chosen, camera = preset(settings.preset), self.camera
        self.configured, self.notice = False, ""
        region = preset_region(camera, chosen)
        rate_hz = settings.frame_rate_hz or chosen.optics.frame_rate_hz
        if settings.frame_rate_hz is None:
            rate_hz = self._default_rate_hz(region, settings, rate_hz)
        camera.configure(region, slit_rows=settings.slit_rows, frame_rate_hz=rate_hz, gain_db=settings.gain_db)
        self.settings, self._region, self._rate_hz, self.configured = settings, region, rate_hz, True
        self.bytes_per_s = region.rows * region.cols * self.frame_rate_hz
        self.settling = SETTLING_FRAMES

    def require(self) -> None:
        """Refuse to go on with an unconfigured camera.

        Raises
        ------
        InputError
            If the camera is not configured.
        """
        if not self.configured:
            raise InputError("the camera is unconfigured: it has no settings, or they failed", "configure it first")

    def require_bus(self) -> None:
        """Measure what the bus carries while frames stream at the default rate, once for each region.

        Raises
        ------
        SlowBusError
            If it carries less; the default rate is lower when the camera is configured again.
        """
        camera, region, rate_hz = self.camera, self._region, self.frame_rate_hz
        if self.settings.frame_rate_hz is not None or region == self._measured or not isinstance(camera, MeasuresBus):
            return
        self._measured = region
        end_s = time.monotonic() + BUS_TIMEOUT_S
        while (carried_hz := camera.carried_rate_hz) is None and time.monotonic() < end_s:
            time.sleep(BUS_POLL_S)
        if carried_hz is not None and carried_hz < rate_hz:
            self._bus_bytes_per_s = carried_hz * region.rows * region.cols
            raise SlowBusError(
                f"the bus carries {carried_hz:.1f} of {rate_hz:.1f} frames per second",
                "use a USB 3 port of the camera's own, or a lower frame rate",
            )

    @property
    def frame_shape(self) -> tuple[int, int]:
        """Rows and columns of a raw frame."""
        return self.camera.frame_shape

    @property
    def frame(self) -> FrameSection:
        """The region of the sensor, as a calibration keeps it."""
        region = self._region
        return FrameSection(shape=region.shape, sensor_origin=(region.row, region.col))

    @property
    def line_period_s(self) -> float:
        """Seconds from the readout of one row to that of the next."""
        return self.camera.line_period_s

    @property
    def line_periods_per_frame(self) -> float:
        """Line periods from one frame to the next, idle time included."""
        return self.camera.line_periods_per_frame

    @property
    def frame_rate_hz(self) -> float:
        """Frames per second of the camera."""
        return 1 / (self.line_periods_per_frame * self.line_period_s)

    @property
    def acquired_with(self) -> AcquiredWith:
        """The settings, as a calibration keeps them."""
        settings, chosen = self.settings, self._preset
        return AcquiredWith(
            rig=self._rig_name,
            objective=chosen.objective,
            slit_rows=settings.slit_rows,
            frame_rate_hz=self._rate_hz,
            gain_db=settings.gain_db,
        )

    def timing(self, strobe: StrobePhase) -> ScanTiming:
        """Return the times at which rows are exposed, with respect to the strobe."""
        return ScanTiming(self.line_period_s, self.line_periods_per_frame, self.settings.slit_rows, strobe)

    def described(self) -> dict[str, Any]:
        """Return the settings as a recording keeps them."""
        return {
            **self.acquired_with.model_dump(),
            "preset": self.settings.preset,
            "line_period_s": self.line_period_s,
            "rows_per_frame": self.line_periods_per_frame,
        }

    def stale(self, calibration: Calibration | None) -> dict[str, str]:
        """Return the sections of a calibration that are stale with these settings, with the reason."""
        if calibration is None or not self.configured:
            return {}
        return stale_sections(calibration, self.acquired_with, self.frame)

    def _default_rate_hz(self, region: Region, settings: Settings, preset_hz: float) -> float:
        """Return the preset's rate, or the highest that camera and bus allow, with a notice."""
        camera_hz = allowed_rate_hz(self.camera, region, settings.slit_rows, preset_hz)
        bus_hz = BUS_SHARE * self._bus_bytes_per_s / (region.rows * region.cols)
        rate_hz = min(camera_hz, bus_hz)
        if rate_hz < preset_hz:
            cause = "the bus carries no more" if bus_hz < camera_hz else "the camera takes no more in this region"
            self.notice = f"{rate_hz:.1f} instead of {preset_hz:g} frames per second: {cause}"
        return rate_hz

    @property
    def _preset(self) -> Preset:
        return preset(self.settings.preset)
