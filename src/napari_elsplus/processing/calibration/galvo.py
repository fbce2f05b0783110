"""Volts to rows: the map that puts the laser line onto the camera's slit.

The paper sweeps at least 400 voltages, takes the brightest pixel of each profile and fits a straight line (System
Calibration, step ii). Rows are found to a fraction of a pixel here, frames without a visible line are left out, a
robust fit throws out what is far from the line, and what is left of the residuals says how curved the galvo is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy import stats

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.processing.analysis.uncertainty import clustered_influence, overlapping_influence
from napari_elsplus.processing.calibration.line import Line, locate_line

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

PAPER_VOLTAGES: Final = 400
FEWEST_LINES: Final = 5
SHORTEST_CHORD: Final = 0.7
"""Of the longest line; nearer to the rim the line's halo is cut on one side and pulls the fit."""
MOST_VOLTS, LEAST_VOLTS = 1e3, 1e-6
"""What no galvo is driven with, and a sweep of less than which is none."""
OUTLIER_SIGMAS: Final = 5.0
RUNS: Final = 20
LINES_OF_TRUST: Final = 4
"""How many lines each line's own uncertainty is worth, against what the lines leave over."""
_NEIGHBOURS: Final = 4
"""Runs of voltages that are taken together: rows of cores pull the line to and fro over many voltages."""


@dataclass(frozen=True, slots=True)
class GalvoMap:
    """Volts that put the line onto a row, as a straight line with what it leaves over.

    Parameters
    ----------
    volts_per_row, volts_at_row_zero : float
        ``volts = volts_at_row_zero + volts_per_row * row``.
    volts_per_row_uncertainty, volts_at_row_zero_uncertainty : float
        One standard deviation of each.
    r_squared : float
        Share of the rows' variance that the line explains.
    rms_rows : float
        Scatter of the rows about the line.
    curvature_rows : float
        Largest departure of the fitted cubic from the line over the swept rows.
    curved : bool
        Whether that departure is more than chance and more than a tenth of a row.
    tilt_deg : float
        Median tilt of the line.
    column : float
        Column of the left view at which rows are taken.
    lines, dark, outliers : int
        Frames fitted; without a visible line or with it cut short by the bundle's rim; thrown out by the robust fit.
    volts, rows, used : numpy.ndarray
        Voltage and row of every frame that showed a line, shape (frames,), and whether it entered the fit.
    """

    volts_per_row: float
    volts_at_row_zero: float
    volts_per_row_uncertainty: float
    volts_at_row_zero_uncertainty: float
    r_squared: float
    rms_rows: float
    curvature_rows: float
    curved: bool
    tilt_deg: float
    column: float
    lines: int
    dark: int
    outliers: int
    volts: Floats
    rows: Floats
    used: NDArray[np.bool_]

    def row(self, volts: float) -> float:
        """Row on which the line stands at a voltage."""
        return (volts - self.volts_at_row_zero) / self.volts_per_row

    def at_column(self, column: float) -> GalvoMap:
        """Return the map with its rows taken at another column of the tilted line."""
        lower = float(np.tan(np.radians(self.tilt_deg))) * (column - self.column)
        at_zero = self.volts_at_row_zero - self.volts_per_row * lower
        return replace(self, volts_at_row_zero=at_zero, column=column, rows=self.rows + lower)

    def park_v(self, first_row: float, last_row: float) -> float:
        """Voltage nearest to zero that stands the line on neither row nor between them."""
        ends = [self.volts_at_row_zero + self.volts_per_row * row for row in (first_row, last_row)]
        return 0.0 if not min(ends) < 0 < max(ends) else min(ends, key=abs)


def lines_in_sweep(
    views: Iterable[NDArray[np.generic]], background: NDArray[np.float32] | None = None
) -> list[Line | None]:
    """Find the line in each frame of a sweep; None where none is visible.

    Parameters
    ----------
    views : iterable of numpy.ndarray
        The confocal view (rows, cols) of each frame.
    background : numpy.ndarray, optional
        Mean frame of the dark tube for the same pixels.
    """
    return [_visible(view, background) for view in views]


def _visible(view: NDArray[np.generic], background: NDArray[np.float32] | None) -> Line | None:
    try:
        return locate_line(view, background)
    except MeasurementError:
        return None


def fit_galvo(volts: NDArray[np.floating], lines: list[Line | None], column: float | None = None) -> GalvoMap:
    """Fit volts to the rows of the lines of a sweep.

    Parameters
    ----------
    volts : numpy.ndarray
        A voltage per frame, in any order, shape (frames,).
    lines : list
        A line or None per frame.
    column : float, optional
        Column at which rows are taken: that of the confocal centre. The middle of the longest lines if not given.

    Returns
    -------
    GalvoMap

    Raises
    ------
    InputError
        If there are not as many voltages as frames, or one is not finite.
    MeasurementError
        If too few frames show a line, or the line does not move with the voltage.
    """
    volts = np.asarray(volts, np.float64)
    if volts.ndim != 1 or len(volts) != len(lines):
        raise InputError(f"{volts.size} voltages for {len(lines)} frames", "give one voltage per frame")
    if not np.isfinite(volts).all():
        raise InputError(f"voltage {int(np.argmin(np.isfinite(volts)))} is not finite", "mend the list of volts")
    largest = float(np.abs(volts).max(initial=0.0))
    if largest > MOST_VOLTS:
        raise InputError(f"a voltage of the sweep is {largest:g} V", f"give volts, at most {MOST_VOLTS:g}")
    seen = [(v, line) for v, line in zip(volts, lines, strict=True) if line is not None]
    longest = max((line.columns[1] - line.columns[0] for _, line in seen), default=0)
    whole = [(v, line) for v, line in seen if line.columns[1] - line.columns[0] >= SHORTEST_CHORD * longest]
    if len(whole) < FEWEST_LINES:
        raise MeasurementError(
            f"a line is visible in {len(whole)} of {len(lines)} frames, {FEWEST_LINES} are needed",
            "is the laser on, and does the sweep cross the bundle?",
        )
    if column is None:
        column = float(np.median([line.column for _, line in whole]))
    v = np.array([voltage for voltage, _ in whole])
    rows = np.array([line.row_at(column) for _, line in whole])
    if np.ptp(v) < LEAST_VOLTS:
        raise InputError(f"all voltages are {v[0]:g}, to {np.ptp(v):g} V", "sweep a range of voltages")
    slope = float(stats.theilslopes(rows, v).slope)
    away = rows - slope * v
    away -= np.median(away)
    scatter = max(1.4826 * float(np.median(np.abs(away))), 0.02)
    used = np.abs(away) < OUTLIER_SIGMAS * scatter
    travel = abs(slope) * float(np.ptp(v[used]))
    if used.mean() < 0.6 or travel < max(5.0, 20 * scatter):
        raise MeasurementError(
            f"the line moves {travel:.1f} rows over the sweep, {100 * (1 - used.mean()):.0f} % of it out of step",
            "do the voltages belong to these frames, and does the galvo move?",
        )
    tilt_deg = float(np.median([line.tilt_deg for _, line in whole]))
    each_rows = float(np.sqrt(np.mean([line.uncertainty_rows(column) ** 2 for _, line in whole])))
    return _fit(v, rows, used, tilt_deg, column, len(lines) - len(whole), each_rows)


def _fit(
    volts: Floats, rows: Floats, used: NDArray[np.bool_], tilt_deg: float, column: float, dark: int, each_rows: float
) -> GalvoMap:
    v, y = volts[used], rows[used]
    middle, half = (v.max() + v.min()) / 2, np.ptp(v) / 2
    x = np.asarray((v - middle) / half, np.float64)
    jacobian = np.asarray(np.stack([np.ones_like(x), x], axis=1), np.float64)
    level, per_half = np.linalg.lstsq(jacobian, y, rcond=None)[0]
    left = np.asarray(y - jacobian @ (level, per_half), np.float64)
    runs = np.argsort(np.argsort(v)) * RUNS // len(v)
    influence = overlapping_influence(jacobian, left, runs, RUNS, _NEIGHBOURS)
    volts_per_row = half / per_half
    # volts at row zero = middle - half * level / per_half, and its derivatives
    to_zero = np.array([-half / per_half, half * level / per_half**2])
    # What a few lines leave over may be small by chance: their own uncertainties count as if they were some lines more.
    alone = each_rows**2 * np.linalg.inv(jacobian.T @ jacobian)
    covariance = (influence.T @ influence * (len(v) - 2) + alone * LINES_OF_TRUST) / (len(v) - 2 + LINES_OF_TRUST)
    curvature, curved = _curvature(x, y, runs)
    return GalvoMap(
        volts_per_row=float(volts_per_row),
        volts_at_row_zero=float(middle - half * level / per_half),
        volts_per_row_uncertainty=float(np.sqrt(covariance[1, 1]) * abs(volts_per_row / per_half)),
        volts_at_row_zero_uncertainty=float(np.sqrt(to_zero @ covariance @ to_zero)),
        r_squared=float(1 - np.square(left).sum() / np.square(y - y.mean()).sum()),
        rms_rows=float(np.sqrt(np.mean(np.square(left)))),
        curvature_rows=curvature,
        curved=curved,
        tilt_deg=tilt_deg,
        column=column,
        lines=len(v),
        dark=dark,
        outliers=int((~used).sum()),
        volts=volts,
        rows=rows,
        used=used,
    )


def _curvature(x: Floats, y: Floats, runs: NDArray[np.intp]) -> tuple[float, bool]:
    """Largest departure of a cubic from the straight line, and whether it is more than chance."""
    cubic = np.asarray(np.polynomial.legendre.legvander(x, 3), np.float64)
    coefficients = np.linalg.lstsq(cubic, y, rcond=None)[0]
    bend = cubic[:, 2:] @ coefficients[2:]
    influence = clustered_influence(cubic, y - cubic @ coefficients, runs, RUNS)
    sigmas = np.abs(coefficients[2:]) / np.maximum(np.linalg.norm(influence[:, 2:], axis=0), 1e-12)
    departure = float(np.abs(bend).max())
    return departure, bool(departure > 0.1 and sigmas.max() > 5)
