"""Position of the laser line during a scan, and its correction: on the slit for exposed rows, then on a flyback."""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.hardware.scan.timing import ScanTiming

    Series = NDArray[np.float64]

MAX_HZ: Final = 5800.0
"""Hz; highest harmonic; chosen: five times the resonance of a common galvo, which passes a thirtieth."""
SMOOTH_HZ: Final = 4000.0
"""Hz at which the penalty on acceleration halves a correction; chosen: below, it follows the rows."""
TURN_S: Final = 0.9e-3
LEAD_IN_S: Final = 0.5e-3
"""Seconds of the turn after the last row and of the run-up before the first.

Where both fit, the galvo turns, rests above the image and runs up again instead of flying through; chosen: some
settling times of a 1 kHz galvo."""


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


class ScanPath:
    """Row of the line against time over all ramps: on the slit while rows are exposed, smooth throughout.

    Parameters
    ----------
    begin_s, end_s : float
        Beginning and end of the ramp, in seconds after the strobe.
    timing : ScanTiming
        Exposure times of the rows.
    shifts_rows : tuple of float
        Shifts in rows of the ramps that alternate.

    Raises
    ------
    InputError
        If the ramp leaves no time for the flyback.
    """

    def __init__(self, begin_s: float, end_s: float, timing: ScanTiming, shifts_rows: tuple[float, ...]) -> None:
        self.timing, self.shifts = timing, shifts_rows
        self.begin_s, self.end_s = begin_s, end_s
        self.speed = 1 / timing.line_period_s
        self.free_s = timing.frame_period_s - (end_s - begin_s)
        if self.free_s <= 0:
            exposed_rows = (end_s - begin_s) * self.speed
            raise InputError(
                f"{exposed_rows:.0f} rows are exposed in a frame of {timing.line_periods_per_frame:.1f} line periods",
                "nothing is left for the flyback: choose a lower frame rate",
            )

    def __call__(self, times_s: Series) -> tuple[Series, Series, Series]:
        """Return row, rows per second and rows per second squared at each time."""
        period = self.timing.frame_period_s
        frame = np.floor((times_s - self.begin_s) / period)
        t = times_s - frame * period  # from begin_s on
        shift = np.asarray(self.shifts)
        here = shift[frame.astype(int) % len(shift)]
        there = shift[(frame.astype(int) + 1) % len(shift)]
        on_slit = self.timing.slit_row(t)
        top, bottom = self.timing.slit_row(np.array([self.begin_s, self.end_s]))
        back = t - self.end_s
        turn = (back >= 0) & (back < self._turn_s)
        lead = back >= self.free_s - self._lead_s
        rest = (back >= self._turn_s) & ~lead
        row, speed, bend = on_slit + here, np.full_like(t, self.speed), np.zeros_like(t)
        if not self._rests:
            fly = back >= 0
            row[fly], speed[fly], bend[fly] = _quintic(
                back[fly] / self.free_s, self.free_s, bottom + here[fly], self.speed, top + there[fly], self.speed
            )
            return row, speed, bend
        resting = top + there - self.speed * self._lead_s / 2
        row[turn], speed[turn], bend[turn] = _quintic(
            back[turn] / self._turn_s, self._turn_s, bottom + here[turn], self.speed, resting[turn], 0.0
        )
        row[rest], speed[rest] = resting[rest], 0.0
        run = (back[lead] - (self.free_s - self._lead_s)) / self._lead_s
        row[lead], speed[lead], bend[lead] = _quintic(
            run, self._lead_s, resting[lead], 0.0, top + there[lead], self.speed
        )
        return row, speed, bend

    @property
    def _rests(self) -> bool:
        return self.free_s >= TURN_S + LEAD_IN_S

    @property
    def _turn_s(self) -> float:
        return TURN_S if self._rests else self.free_s

    @property
    def _lead_s(self) -> float:
        return LEAD_IN_S if self._rests else 0.0


def _quintic(
    u: Series, span_s: float, start: Series, start_speed: float, end: Series, end_speed: float
) -> tuple[Series, Series, Series]:
    """Smoothest path (least jerk) between two rows and speeds, unaccelerated at both ends; `u` runs from 0 to 1."""
    v0, v1 = start_speed * span_s, end_speed * span_s
    way = end - start
    c3, c4, c5 = 10 * way - 6 * v0 - 4 * v1, -15 * way + 8 * v0 + 7 * v1, 6 * way - 3 * v0 - 3 * v1
    row = start + u * (v0 + u * u * (c3 + u * (c4 + u * c5)))
    speed = (v0 + u * u * (3 * c3 + u * (4 * c4 + 5 * u * c5))) / span_s
    bend = u * (6 * c3 + u * (12 * c4 + 20 * u * c5)) / span_s**2
    return row, speed, bend
