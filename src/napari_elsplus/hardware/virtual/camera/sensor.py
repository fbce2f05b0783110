"""The virtual camera's sensor: its settings, their limits, and which of them are locked while it streams."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.hardware.virtual.camera.standard import ACCESS_DENIED, INVALID_PARAMETER, Refusal
from napari_elsplus.instrument.optics import LINE_RATE_HZ, SENSOR_SHAPE

if TYPE_CHECKING:
    from collections.abc import Callable

IDLE: Final = LINE_RATE_HZ / 240 / 524
"""Shortest frame period over the time in which its rows are read, as in the paper's modes."""


@dataclass(frozen=True, slots=True)
class SensorModel:
    """Capabilities of a make of sensor.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns.
    size_step, origin_step : tuple of int
        Rows and columns in which size and origin of the region go.
    line_rate_hz : float
        Rows per second.
    automatic : frozenset of str
        What the camera chooses by itself after a reset: ``exposure``, ``rate``, ``gain``.
    """

    shape: tuple[int, int] = SENSOR_SHAPE
    size_step: tuple[int, int] = (4, 16)
    origin_step: tuple[int, int] = (2, 4)
    line_rate_hz: float = LINE_RATE_HZ
    automatic: frozenset[str] = frozenset({"exposure", "rate", "gain"})


@dataclass
class Settings:
    """Settings with the values that they have after a reset."""

    rows: int = 0
    cols: int = 0
    row: int = 0
    col: int = 0
    exposure_s: float = 0.005
    frame_rate_hz: float = 30.0
    gain_db: float = 0.0
    automatic: frozenset[str] = frozenset()
    rate_limited: bool = False
    trigger: bool = False
    gamma: bool = False
    chunks: bool = False
    binning: int = 1
    frame_info: int = 0
    """Bits of the numbers that are written over the first pixels."""


class Sensor:
    """Settings of the sensor, each checked when it is written.

    Parameters
    ----------
    model : SensorModel
        What it can do.
    locked : callable
        Returns True while region and format may not be changed.
    """

    def __init__(self, model: SensorModel, locked: Callable[[], bool]) -> None:
        self.model, self._locked = model, locked
        self.settings = self._defaults()

    def reset(self) -> None:
        """Load the default settings; `Refusal` while they are locked."""
        self._refuse_if_locked()
        self.settings = self._defaults()

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the sensor, binned."""
        rows, cols = self.model.shape
        return rows // self.settings.binning, cols // self.settings.binning

    @property
    def line_period_s(self) -> float:
        """Seconds per row."""
        return 1 / self.model.line_rate_hz

    @property
    def region(self) -> tuple[int, int, int, int]:
        """Row, col, rows, cols."""
        return self.settings.row, self.settings.col, self.settings.rows, self.settings.cols

    @property
    def max_rate_hz(self) -> float:
        """Highest frame rate at this region and exposure."""
        return 1 / max(self.settings.rows * IDLE * self.line_period_s, self.settings.exposure_s)

    @property
    def max_exposure_s(self) -> float:
        """Longest exposure at this frame rate."""
        return 1 / self.settings.frame_rate_hz if self.settings.rate_limited else 1.0

    @property
    def rate_hz(self) -> float:
        """Frame rate at which it runs."""
        limited = self.settings.rate_limited
        return min(self.settings.frame_rate_hz, self.max_rate_hz) if limited else min(30.0, self.max_rate_hz)

    def set_region(self, **changes: int) -> None:
        """Change row, col, rows or cols; `Refusal` if the result is no region of the sensor."""
        self._refuse_if_locked()
        row, col, rows, cols = (changes.get(name, getattr(self.settings, name)) for name in _REGION)
        (tall, wide), (row_step, col_step) = self.shape, self.model.size_step
        inside = rows > 0 and cols > 0 and row + rows <= tall and col + cols <= wide
        even = rows % row_step == 0 and cols % col_step == 0
        even &= row % self.model.origin_step[0] == 0 and col % self.model.origin_step[1] == 0
        if not (inside and even):
            raise Refusal(INVALID_PARAMETER)
        self.settings.row, self.settings.col, self.settings.rows, self.settings.cols = row, col, rows, cols

    def set_exposure(self, seconds: float) -> None:
        """Set the exposure in `seconds`; `Refusal` where it is automatic or out of range."""
        self._refuse_outside("exposure", 1e-6, seconds, self.max_exposure_s)
        self.settings.exposure_s = seconds

    def set_rate(self, rate_hz: float) -> None:
        """Set the frame rate; `Refusal` where it is automatic or out of range."""
        self._refuse_outside("rate", 1.0, rate_hz, self.max_rate_hz)
        self.settings.frame_rate_hz = rate_hz

    def set_gain(self, gain_db: float) -> None:
        """Set the gain; `Refusal` where it is automatic or out of range."""
        self._refuse_outside("gain", 0.0, gain_db, 24.0)
        self.settings.gain_db = gain_db

    def set_automatic(self, name: str, on: bool) -> None:
        """Switch the automatic choice of a setting `name` (exposure, rate, gain) `on` or off."""
        self.settings.automatic = self.settings.automatic | {name} if on else self.settings.automatic - {name}

    def set_format(self, **changes: Any) -> None:
        """Change settings that change the payload; `Refusal` while they are locked."""
        self._refuse_if_locked()
        binning = self.settings.binning
        assert set(changes) <= {field.name for field in fields(Settings)}
        for name, value in changes.items():
            setattr(self.settings, name, value)
        if self.settings.binning != binning:
            self.settings.rows, self.settings.cols = self.shape
            self.settings.row = self.settings.col = 0

    def _defaults(self) -> Settings:
        rows, cols = self.model.shape
        return Settings(rows, cols, automatic=self.model.automatic)

    def _refuse_if_locked(self) -> None:
        if self._locked():
            raise Refusal(ACCESS_DENIED)

    def _refuse_outside(self, name: str, low: float, value: float, high: float) -> None:
        if name in self.settings.automatic:
            raise Refusal(ACCESS_DENIED)
        if not low * (1 - 1e-4) <= value <= high * (1 + 1e-4):
            raise Refusal(INVALID_PARAMETER)


_REGION: Final = ("row", "col", "rows", "cols")
