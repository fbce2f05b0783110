"""The galvo's response, fitted to the row errors of a scan: a damped resonance, a delay, and a static curve.

The drive repeats with the frame, so that the galvo's motion is a Fourier series: each harmonic of the drive times the
response at its frequency.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import pi
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import least_squares

from napari_elsplus.processing.analysis.uncertainty import clustered_influence

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

HARMONICS_HZ: Final = 12_000.0
"""Hz; highest harmonic of the drive; chosen: a galvo of 2 kHz passes a thirtieth of it."""
FITTED_EVERY: Final = 3
"""Rows from one that is fitted to the next; chosen: errors are smoothed over more."""
STARTS: Final = 3
"""Best starts from which the fit is made; chosen: the basins of delay and resonance are shallow."""
RESONANCES_HZ: Final = (450.0, 600.0, 800.0, 1000.0, 1300.0, 1700.0, 2200.0)
DAMPINGS: Final = (0.3, 0.5, 0.75, 1.1)
DELAYS_S: Final = (0.0, 1e-4, 3e-4)
"""Hz, damping ratio and seconds at which the fit starts; chosen: closer together than its basins."""
BOUNDS: Final = ((200.0, 0.05, -5e-5), (8000.0, 3.0, 1.5e-3))
"""Of resonance (Hz), damping and delay (s); chosen, beyond those of galvos and their triggers."""
_SCALE: Final = (300.0, 0.2, 1e-4, 1.0, 1.0, 1.0)
"""Typical changes of resonance (Hz), damping, delay (s), offset, slope and cubic (rows), for the solver; chosen."""
ROWS_PER_RUN: Final = 10
"""Fitted rows whose errors are summed for the uncertainty; chosen: wider than a core and than the smoothing."""
STATIC_SIGMAS: Final = np.array([0.3, 0.3, 5.0])
"""Prior standard deviations in rows of offset, slope and cubic over the rows; chosen: the galvo map gives the first two
to a tenth, but a cubic only as its residuals."""
ROBUST_ROWS: Final = 0.5
"""Error in rows beyond which a row weighs less (soft L1); chosen, above the noise of a row."""


@dataclass(frozen=True, slots=True)
class Drive:
    """The drive of a scan over one frame period, and the times at which rows are exposed.

    Parameters
    ----------
    rows : numpy.ndarray
        Drive as row of the galvo map, mean over equal steps that begin with the strobe, shape (steps,).
    period_s : float
        Frame period.
    row_zero_s : float
        Middle of the exposure of row 0, in seconds after the strobe.
    line_period_s : float
        Seconds from one row to the next.
    """

    rows: Floats
    period_s: float
    row_zero_s: float
    line_period_s: float


@dataclass(frozen=True, slots=True)
class GalvoResponse:
    """Response of galvo and trigger to the drive.

    Parameters
    ----------
    natural_hz, damping : float
        Resonance and damping ratio.
    delay_s : float
        Delay in addition to that of the resonance.
    static_rows : numpy.ndarray
        Static departure from the galvo map at each row of the frame, in rows, shape (rows,).
    rms_rows : float
        Remainder of the fit.
    lag_uncertainty_s : float
        One standard deviation of :attr:`lag_s`.
    """

    natural_hz: float
    damping: float
    delay_s: float
    static_rows: Floats
    rms_rows: float
    lag_uncertainty_s: float

    @property
    def lag_s(self) -> float:
        """Lag behind a steady ramp, in seconds."""
        return self.delay_s + self.damping / (pi * self.natural_hz)


@dataclass(frozen=True, slots=True)
class ScanRecord:
    """Drive of a scan, and the row errors that were found: row of the line minus row of the slit, NaN where unknown."""

    drive: Drive
    errors: Floats

    def unexplained(self, response: GalvoResponse) -> Floats:
        """Return the row errors beyond those that a response predicts, shape (rows,)."""
        rows = np.arange(len(self.errors), dtype=np.float64)
        motion = _Motion(self.drive, rows)(response.natural_hz, response.damping, response.delay_s)
        return np.asarray(rows + self.errors - motion - response.static_rows, np.float64)


def fit_galvo_response(scans: Sequence[ScanRecord], near: GalvoResponse | None = None) -> GalvoResponse:
    """Fit the response of the galvo to the row errors of one scan or several with different drives.

    Parameters
    ----------
    scans : sequence of ScanRecord
        In at least one, most of the errors are known.
    near : GalvoResponse, optional
        Response from fewer scans, from which the fit starts, too.
    """
    count = len(scans[0].errors)
    known = [np.flatnonzero(np.isfinite(scan.errors))[::FITTED_EVERY] for scan in scans]
    motions = [_Motion(scan.drive, rows.astype(np.float64)) for scan, rows in zip(scans, known, strict=True)]
    targets = np.concatenate([rows + scan.errors[rows] for scan, rows in zip(scans, known, strict=True)])
    curve = _static_curve(np.concatenate(known).astype(np.float64), count)

    def left(guess: Floats) -> Floats:
        return np.asarray(targets - np.concatenate([follow(*guess[:3]) for follow in motions]), np.float64)

    def remainder(guess: Floats) -> Floats:
        return np.asarray(np.r_[left(guess) - curve @ guess[3:], guess[3:] / STATIC_SIGMAS], np.float64)

    def cost(guess: Floats) -> float:
        return float(np.sqrt(1 + np.square(remainder(guess) / ROBUST_ROWS)).sum())

    dynamics = [np.array(dynamic) for dynamic in product(RESONANCES_HZ, DAMPINGS, DELAYS_S)]
    starts = sorted((np.r_[dynamic, _fit_static(curve, left(dynamic))] for dynamic in dynamics), key=cost)[:STARTS]
    if near is not None:
        dynamic = np.array([near.natural_hz, near.damping, near.delay_s])
        starts.append(np.r_[dynamic, _fit_static(curve, left(dynamic))])
    bounds = [np.r_[side, np.full(3, sign * np.inf)] for side, sign in zip(BOUNDS, (-1, 1), strict=True)]
    options = {"bounds": bounds, "x_scale": _SCALE, "loss": "soft_l1", "f_scale": ROBUST_ROWS, "max_nfev": 60}
    fit = min((least_squares(remainder, start, **options) for start in starts), key=lambda found: float(found.cost))
    natural_hz, damping, delay_s = (float(value) for value in fit.x[:3])
    static = _static_curve(np.arange(count, dtype=np.float64), count) @ fit.x[3:]
    wrong = remainder(fit.x)
    rms = float(np.sqrt(np.mean(np.square(wrong[: len(targets)]))))
    runs = np.arange(len(wrong)) // ROWS_PER_RUN
    influence = clustered_influence(np.asarray(fit.jac), wrong, runs, int(runs[-1]) + 1)
    by_lag = np.array([-damping / (pi * natural_hz**2), 1 / (pi * natural_hz), 1.0, 0.0, 0.0, 0.0])
    lag_uncertainty_s = float(np.linalg.norm(influence @ by_lag))
    return GalvoResponse(natural_hz, damping, delay_s, np.asarray(static, np.float64), rms, lag_uncertainty_s)


def _static_curve(rows: Floats, count: int) -> Floats:
    """Return offset, slope and cubic over the rows of a frame, shape (rows, 3)."""
    u = (rows - (count - 1) / 2) / (count / 2)
    return np.stack([np.ones_like(u), u, 2.5 * u**3 - 1.5 * u], axis=1)


def _fit_static(curve: Floats, left: Floats) -> Floats:
    prior = np.diag(np.square(1 / STATIC_SIGMAS))
    return np.asarray(np.linalg.solve(curve.T @ curve + prior, curve.T @ left), np.float64)


class _Motion:
    """The line's row while given rows are exposed, for any resonance, damping and delay."""

    def __init__(self, drive: Drive, rows: Floats) -> None:
        count = min(int(HARMONICS_HZ * drive.period_s), len(drive.rows) // 2 - 1)
        order = np.arange(count + 1)
        self._omega = 2 * pi * order / drive.period_s
        step_s = drive.period_s / len(drive.rows)
        centred = np.fft.rfft(drive.rows)[: count + 1] / len(drive.rows) * np.exp(-0.5j * self._omega * step_s)
        times_s = drive.row_zero_s + rows * drive.line_period_s
        waves = np.exp(1j * times_s[:, None] * self._omega)
        self._waves = waves * centred * np.where(order > 0, 2.0, 1.0)

    def __call__(self, natural_hz: float, damping: float, delay_s: float) -> Floats:
        ratio = self._omega / (2 * pi * natural_hz)
        response = np.exp(-1j * self._omega * delay_s) / (1 - ratio**2 + 2j * damping * ratio)
        return np.asarray((self._waves @ response).real, np.float64)
