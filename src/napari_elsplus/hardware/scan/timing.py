"""Exposure time of each row, relative to the camera's strobe."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Seconds = NDArray[np.float64]


class StrobePhase(StrEnum):
    """Event that the camera's strobe marks: exposure or readout of the first row."""

    EXPOSURE = "exposure"
    READOUT = "readout"


@dataclass(frozen=True, slots=True)
class ScanTiming:
    """Exposure time of each row, relative to the strobe.

    Parameters
    ----------
    line_period_s, line_periods_per_frame : float
        As the camera reports them.
    slit_rows : int
        Exposure in line periods.
    strobe : StrobePhase
        Event that the strobe marks.
    """

    line_period_s: float
    line_periods_per_frame: float
    slit_rows: int
    strobe: StrobePhase = StrobePhase.EXPOSURE

    @property
    def frame_period_s(self) -> float:
        """Seconds from strobe to strobe."""
        return self.line_periods_per_frame * self.line_period_s

    @property
    def row_zero_s(self) -> float:
        """Readout of row 0, in seconds after the strobe."""
        return self.slit_rows * self.line_period_s if self.strobe is StrobePhase.EXPOSURE else 0.0

    def slit_row(self, time_s: Seconds) -> Seconds:
        """Row on which the slit is centred, a time after the strobe."""
        return (time_s - self.row_zero_s) / self.line_period_s + self.slit_rows / 2

    def time_s(self, slit_row: float) -> float:
        """Return when the slit is centred on a row `slit_row`, in seconds after the strobe."""
        return self.row_zero_s + (slit_row - self.slit_rows / 2) * self.line_period_s
