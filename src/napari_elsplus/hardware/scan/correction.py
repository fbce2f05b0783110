"""Correction of the line's path, row by row: a smooth periodic function of time through the rows of a calibration."""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.hardware.scan.timing import ScanTiming

    Series = NDArray[np.float64]

MAX_HZ: Final = 5800.0
"""Hz; highest harmonic; chosen: five times the resonance of a common galvo, which passes a thirtieth."""
SMOOTH_HZ: Final = 4000.0
"""Hz at which the penalty on acceleration halves a correction; chosen: below, it follows the rows."""


class PathCorrection:
    """Rows added to the path against time, repeated in every frame; free while nothing is exposed.

    Parameters
    ----------
    rows : numpy.ndarray
        Correction at each row of the frame, shape (rows,).
    exposed : tuple of float
        First and last exposed row.
    timing : ScanTiming
        Exposure times of the rows.
    """

    def __init__(self, rows: NDArray[np.floating], exposed: tuple[float, float], timing: ScanTiming) -> None:
        first, last = max(int(exposed[0]), 0), min(int(exposed[1]) + 1, len(rows) - 1)
        numbers = np.arange(first, last + 1)
        times = np.array([timing.time_s(float(row)) for row in numbers])
        self._omega = 2 * pi * np.arange(int(MAX_HZ * timing.frame_period_s) + 1) / timing.frame_period_s
        waves = self._waves(times)
        stiffness = np.tile(np.square(np.square(self._omega / (2 * pi * SMOOTH_HZ))), 2)
        normal = waves.T @ waves / len(numbers) + np.diag(stiffness + 1e-9)
        self._amplitudes = np.linalg.solve(normal, waves.T @ np.asarray(rows[numbers], np.float64) / len(numbers))

    def __call__(self, times_s: Series) -> tuple[Series, Series, Series]:
        """Return rows, rows per second and rows per second squared at each time after the strobe."""
        cos, sin = np.split(self._amplitudes, 2)
        turned = np.r_[self._omega * sin, -self._omega * cos]
        bent = -np.square(np.tile(self._omega, 2)) * self._amplitudes
        waves = self._waves(times_s)
        row, speed, bend = (np.asarray(waves @ amplitudes) for amplitudes in (self._amplitudes, turned, bent))
        return row, speed, bend

    def _waves(self, times_s: Series) -> Series:
        angle = times_s[:, None] * self._omega
        return np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
