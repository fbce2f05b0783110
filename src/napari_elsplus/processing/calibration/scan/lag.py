"""The scan lag, fitted to the signal at full speed.

The galvo responds late and the trigger has a delay, so a scan must run ahead of the slit by a lead. The light that
passes the slit is largest where the lead equals the lag; against the lead it falls off as the line's profile does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import least_squares

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.analysis.uncertainty import small_sample_factor

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.scan.learned_ramp import LearnedRamp
    from napari_elsplus.processing.calibration.scan.row_errors import RowErrors
    from napari_elsplus.processing.progress import ProgressWrapper

    Floats = NDArray[np.float64]

_FIT_RANGE_ROWS: Final = 13.0
"""To either side of the best lead; chosen: farther leads measure the halo of the line, not the line."""
_MIN_POINTS: Final = 6
"""Chosen: the Gaussian on a pedestal has four parameters."""
MAX_LAG_S: Final = 0.8e-3
"""Longest lead that is tried; chosen, above the lag of galvos of 1 kHz with their triggers."""
_COARSE_STEP_ROWS: Final = 5.0
"""Chosen: narrower than the line with its slit, so that one lead meets it."""
FINE_SHIFTS: Final = 1.5 * np.arange(-8.0, 9.0)
"""Shifts in rows about the best coarse lead; chosen: several across the line, over the range of the fit."""


@dataclass(frozen=True, slots=True)
class ScanLag:
    """Delay of the line behind the drive.

    Parameters
    ----------
    lag_s, uncertainty_s : float
        The lag and its standard deviation.
    leads_s, signal : numpy.ndarray
        Mean confocal grey level at each lead, shape (n,).
    row_errors : RowErrors, optional
        Of the scan by this result.
    ramp : LearnedRamp, optional
        Correction, if the lag alone left rows off the slit.
    """

    lag_s: float
    uncertainty_s: float
    leads_s: Floats
    signal: Floats
    row_errors: RowErrors | None = None
    ramp: LearnedRamp | None = None


def measure_lag(signal_at: Callable[[float, float], float], line_period_s: float) -> ScanLag:
    """Measure the scan lag with coarse leads over the range of galvos, and fine shifts about the best.

    Parameters
    ----------
    signal_at : callable
        Scans with a lead in seconds and a shift in rows, and returns the mean confocal grey level.
    line_period_s : float
        Seconds from one row to the next.

    Returns
    -------
    ScanLag

    Raises
    ------
    MeasurementError
        If the signal has no maximum within the leads.
    """
    return fit_lag(*take_leads(signal_at, line_period_s), line_period_s)


def take_leads(
    signal_at: Callable[[float, float], float],
    line_period_s: float,
    progress: ProgressWrapper = iter,
) -> tuple[Floats, Floats]:
    """Return the leads in seconds and the signal at each, shape (n,): the last ``len(FINE_SHIFTS)`` are fine shifts.

    Parameters are those of :func:`measure_lag`; `progress` wraps the numbers of the leads. A shift by a row acts on the
    signal as a lead by a line period.
    """
    leads = np.arange(0.0, MAX_LAG_S, _COARSE_STEP_ROWS * line_period_s).tolist()
    coarse, best = len(leads), 0.0
    signal: list[float] = []
    for number in progress(range(coarse + len(FINE_SHIFTS))):
        if number < coarse:
            signal.append(signal_at(leads[number], 0.0))
            continue
        if number == coarse:
            best = leads[int(np.argmax(signal))]
            leads += (best + FINE_SHIFTS * line_period_s).tolist()
        signal.append(signal_at(best, float(FINE_SHIFTS[number - coarse])))
    return np.array(leads), np.array(signal)


def fit_lag(leads_s: Floats, signal: Floats, line_period_s: float) -> ScanLag:
    """Fit the lead at which the signal is largest.

    Parameters
    ----------
    leads_s : numpy.ndarray
        Leads that were tried, shape (n,).
    signal : numpy.ndarray
        Mean confocal grey level at each, shape (n,).
    line_period_s : float
        Seconds from one row to the next.

    Returns
    -------
    ScanLag
        The maximum of a Gaussian on a pedestal, fitted to the leads near the best one.

    Raises
    ------
    MeasurementError
        If the signal has no maximum within the leads.

    Examples
    --------
    >>> leads = np.linspace(0, 400e-6, 41)
    >>> found = fit_lag(leads, 20 + 60 * np.exp(-0.5 * ((leads - 215e-6) / 40e-6) ** 2), 7.648e-6)
    >>> round(1e6 * found.lag_s, 1)
    215.0
    """
    rows = leads_s / line_period_s
    best = rows[int(np.argmax(signal))]
    near = np.abs(rows - best) <= _FIT_RANGE_ROWS
    x, y = rows[near], signal[near]
    span = float(y.max() - y.min())
    if len(x) < _MIN_POINTS or span <= 0 or not x.min() < best < x.max():
        raise MeasurementError(
            f"the signal has no maximum at leads of {1e6 * leads_s.min():.0f} to {1e6 * leads_s.max():.0f} us",
            "put the probe onto something that fluoresces evenly, and check the galvo map",
        )
    bounds = (x.min(), 1.0, 0, -np.inf), (x.max(), 60.0, np.inf, np.inf)
    fit = least_squares(lambda guess: _gaussian(x, *guess) - y, (best, 5.0, span, float(y.min())), bounds=bounds)
    found, uncertainty = fit.x, _first_uncertainty(fit.jac, fit.fun)
    if not (fit.success and uncertainty < 0.5 * _FIT_RANGE_ROWS) or found[2] < 0.05 * abs(y.max()):
        raise MeasurementError(
            f"the signal hardly depends on the lead ({100 * span / max(abs(float(y.max())), 1e-9):.1f} %)",
            "put the probe onto something that fluoresces evenly, and raise the light",
        )
    return ScanLag(float(found[0]) * line_period_s, uncertainty * line_period_s, leads_s, signal)


def _first_uncertainty(jacobian: Floats, residuals: Floats) -> float:
    """One standard deviation of the first parameter, from what leaving out each point would change.

    Light that flickers is noisier where there is more of it, and no line is quite a Gaussian: residuals alike in size
    everywhere would state too little. For few points the spread itself is uncertain: Student's t is wider.
    """
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    leverage = np.einsum("ij,jk,ik->i", jacobian, inverse, jacobian)
    changes = (jacobian @ inverse[:, 0]) * residuals / np.maximum(1 - leverage, 1e-3)
    return float(np.linalg.norm(changes)) * small_sample_factor(len(jacobian) - jacobian.shape[1])


def _gaussian(x: Floats, middle: float, sigma: float, height: float, floor: float) -> Floats:
    result: Floats = floor + height * np.exp(-0.5 * ((x - middle) / sigma) ** 2)
    return result
