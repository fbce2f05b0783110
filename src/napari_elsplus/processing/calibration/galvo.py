"""The galvo map: the voltage that puts the laser line onto a row of the camera.

The paper sweeps at least 400 voltages, takes the brightest pixel of each profile and fits a straight line (System
Calibration, step ii). Rows are found to a fraction of a pixel here, frames without a visible line are left out, a
robust fit rejects outliers, and the residuals of a straight line measure how curved the galvo is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.processing.analysis.uncertainty import clustered_influence, robust_sigma
from napari_elsplus.processing.calibration.line.drawn_by_light import Drawn, drawn_by_light
from napari_elsplus.processing.calibration.line.location import Line, locate_line
from napari_elsplus.processing.calibration.line.sweep_influence import (
    MIN_SWEEP_V,
    RUNS,
    different_voltages,
    influence_of_lines,
    place_in_sweep,
    polynomial_terms,
    runs_of,
)
from napari_elsplus.processing.calibration.line.sweep_jump import require_steady

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.bundle.laser_gain import SweptLight

    Floats = NDArray[np.float64]

PAPER_VOLTAGES: Final = 400
"""Least number of voltages in the paper's sweep."""
MAX_LOST_FRAMES: Final = 3
"""Steps by which lines may lie beside the others where frames were lost; chosen: farther ones are other outliers."""
MIN_LINES: Final = 5
"""Different voltages of lines; chosen: fewer leave too little over to tell scatter from a curve."""
MIN_CHORD: Final = 0.8
"""Of the longest line; measured, on 320 random rigs: nearer to the rim the halo is cut on one side, which moves lines
outwards, those with most of it by 0.02 rows at 0.7 and by 0.01 at 0.75."""
MIN_BEND_SIGMAS: Final = 3.0
"""Standard deviations below which the line counts as straight, and the sweep as symmetrical about its middle; chosen:
one in 400 exceeds them by chance."""
MAX_VOLTS: Final = 20.0
"""Chosen: twice what the drivers of galvos take, by which millivolts are told."""
OUTLIER_SIGMAS: Final = 5.0
"""Robust standard deviations; chosen: a line of a good sweep exceeds them once in a million."""
PRIOR_LINES: Final = 4
"""Number of lines as which each line's own uncertainty is weighted against the residuals; chosen."""


@dataclass(frozen=True, slots=True)
class GalvoMap:
    """Volts that put the line onto a row: a straight line and its residuals.

    Parameters
    ----------
    volts_per_row, volts_at_row_zero : float
        ``volts = volts_at_row_zero + volts_per_row * row``.
    volts_per_row_uncertainty, volts_at_row_zero_uncertainty : float
        One standard deviation of each.
    middle_uncertainty_rows : float
        One standard deviation of the line's row at the middle of the swept voltages.
    r_squared : float
        Share of the rows' variance that the straight line explains.
    rms_rows : float
        Scatter of the rows about the straight line.
    curvature_rows : float
        Largest departure of the fitted cubic from the line over the swept rows.
    curved : bool
        True if that departure is significant and more than a tenth of a row.
    tilt_deg : float
        Median tilt of the line.
    bow_rows, bow_uncertainty_rows : float
        Rows by which the line's ends at the bundle's rim lie below its middle, and one standard deviation.
    column : float
        Column of the confocal view at which rows are taken.
    lines, dark, outliers : int
        Frames fitted; without a visible line or with it cut short by the bundle's rim; rejected by the robust fit.
    volts, rows, used : numpy.ndarray
        Voltage and row of every frame with a line, shape (frames,), and True where it was fitted.
    light : SweptLight, optional
        Light of the lines in both views; None where it was not collected.
    """

    volts_per_row: float
    volts_at_row_zero: float
    volts_per_row_uncertainty: float
    volts_at_row_zero_uncertainty: float
    middle_uncertainty_rows: float
    r_squared: float
    rms_rows: float
    curvature_rows: float
    curved: bool
    tilt_deg: float
    bow_rows: float
    bow_uncertainty_rows: float
    column: float
    lines: int
    dark: int
    outliers: int
    volts: Floats
    rows: Floats
    used: NDArray[np.bool_]
    light: SweptLight | None = None

    def row(self, volts: float | Floats) -> float | Floats:
        """Return the row on which the line stands at a voltage in volts."""
        return (volts - self.volts_at_row_zero) / self.volts_per_row

    def at_column(self, column: float) -> GalvoMap:
        """Return the map with rows taken at another column of the tilted line."""
        lower = float(np.tan(np.radians(self.tilt_deg))) * (column - self.column)
        at_zero = self.volts_at_row_zero - self.volts_per_row * lower
        return replace(self, volts_at_row_zero=at_zero, column=column, rows=self.rows + lower)

    def park_v(self, first_row: float, last_row: float) -> float:
        """Return the voltage nearest to zero that puts the line neither onto the first or last row nor between them."""
        ends = [self.volts_at_row_zero + self.volts_per_row * row for row in (first_row, last_row)]
        return 0.0 if not min(ends) < 0 < max(ends) else min(ends, key=abs)


def visible_line(view: NDArray[np.generic], background: NDArray[np.float32] | None = None) -> Line | None:
    """Locate the line in a frame of a sweep; None where none is visible.

    Parameters
    ----------
    view : numpy.ndarray
        The confocal view (rows, cols).
    background : numpy.ndarray, optional
        Mean frame of the dark tube for the same pixels.
    """
    try:
        return locate_line(view, background)
    except MeasurementError:
        return None


def fit_galvo(
    volts: NDArray[np.floating],
    lines: list[Line | None],
    column: float | None = None,
    diameter_px: float | None = None,
    max_chord_px: float = inf,
) -> GalvoMap:
    """Fit volts to the rows of the lines of a sweep.

    Parameters
    ----------
    volts : numpy.ndarray
        A voltage per frame, in any order, shape (frames,).
    lines : list
        A line or None per frame.
    column : float, optional
        Column at which rows are taken: that of the confocal centre. The middle of the longest lines if not given.
    diameter_px : float, optional
        Of the bundle's confocal view, at whose rim the bow is stated; the longest line's length if not given.
    max_chord_px : float
        Columns beyond which a streak is no line on the bundle.

    Raises
    ------
    InputError
        If the numbers of voltages and frames differ, or a voltage is not finite.
    MeasurementError
        If too few frames or voltages show a line, or the line does not move with the voltage, or jumps.
    """
    volts = np.asarray(volts, np.float64)
    if volts.ndim != 1 or len(volts) != len(lines):
        raise InputError(f"{volts.size} voltages for {len(lines)} frames", "give one voltage per frame")
    if not np.isfinite(volts).all():
        raise InputError(f"voltage {int(np.argmin(np.isfinite(volts)))} is not finite", "correct the list of volts")
    if (largest := float(np.abs(volts).max(initial=0.0))) > MAX_VOLTS:
        raise InputError(f"a voltage of the sweep is {largest:g} V", f"give volts, at most {MAX_VOLTS:g}")
    seen = [(k, line) for k, line in enumerate(lines) if line is not None and line.length_px <= max_chord_px]
    longest = max((line.length_px for _, line in seen), default=0)
    whole, cut = (
        [(k, line) for k, line in seen if (line.length_px >= MIN_CHORD * longest) == kept] for kept in (True, False)
    )
    if len(whole) < MIN_LINES:
        raise MeasurementError(
            f"a line is visible in {len(whole)} of {len(lines)} frames, {MIN_LINES} are needed",
            "is the laser on, and does the sweep cross the bundle?",
        )
    column = float(np.median([line.column for _, line in whole])) if column is None else column
    v = volts[frames := np.array([k for k, _ in whole])]
    if np.ptp(v) < MIN_SWEEP_V:
        raise InputError(f"the voltages of frames with a line span {np.ptp(v):g} V", "sweep a range of voltages")
    if (different := different_voltages(v)) < MIN_LINES:
        raise MeasurementError(
            f"the {len(whole)} frames with a line have {different} different voltages, {MIN_LINES} are needed",
            "sweep more voltages",
        )
    bow = _common_bow(v, [line for _, line in whole], column, (diameter_px or longest) / 2)
    rows = np.array([line.row_at(column) for _, line in whole]) + bow.rows * bow.share
    from scipy.stats import theilslopes  # 1 s to import, so only where a sweep is fitted

    used, before = np.ones(len(v), bool), None
    while before is None or (used.sum() < before.sum() and used.any()):  # each pass sees past more of the outliers
        slope = float(theilslopes(rows[used], v[used]).slope)
        away = rows - slope * v
        away -= np.median(away[used])
        scatter = max(float(robust_sigma(away[used])), 0.02)
        before, used = used, np.abs(away) < OUTLIER_SIGMAS * scatter
    travel, fewest = abs(slope) * float(np.ptp(v[used])), max(MIN_LINES, 0.6 * len(v))
    if used.sum() < fewest or travel < max(5.0, 20 * scatter):
        raise MeasurementError(
            f"the line moves {travel:.1f} rows, {scatter:.2g} off a line in {used.sum()} of {len(v)} frames",
            "do the voltages belong to these frames, and does the galvo move?",
        )
    near = used | (np.abs(away) < MAX_LOST_FRAMES * abs(slope) * np.median(np.abs(np.diff(v))))
    require_steady(rows[near], polynomial_terms(place_in_sweep(v))[near], frames[near])
    cut_v = np.array([volts[k] for k, _ in cut], np.float64)
    drawn = drawn_by_light(v, rows, [line for _, line in whole], used, cut_v, [line for _, line in cut])
    tilt_deg = float(np.median([line.tilt_deg for _, line in whole]))
    each_rows = float(np.sqrt(np.mean([line.uncertainty_rows(column) ** 2 for _, line in whole])))
    return _fit(v, rows - drawn.rows, used, tilt_deg, bow, drawn, column, len(lines) - len(whole), each_rows)


class _Bow(NamedTuple):
    """Bow of the line: rows at the rim, one standard deviation, and what it adds to each line's row over that."""

    rows: float
    uncertainty_rows: float
    share: Floats


def _common_bow(volts: Floats, lines: list[Line], column: float, radius_px: float) -> _Bow:
    """Return the bow that all lines of a sweep share; 0 if it is not significant."""
    bends = np.array([line.bend for line in lines]) * radius_px**2
    away = bends - np.median(bends)
    kept = np.abs(away) <= OUTLIER_SIGMAS * robust_sigma(away) + 1e-9
    weights = np.array([line.mean_square_px**2 for line in lines])[kept] + 1e-12
    rows = float(np.average(bends[kept], weights=weights))
    # A lens bends the line upwards on one side of its axis and downwards on the other, which is no scatter.
    root = np.sqrt(weights / weights.mean())[:, None]
    terms = root * polynomial_terms(place_in_sweep(volts[kept]))
    scaled = root[:, 0] * bends[kept]
    left_over = np.asarray(scaled - terms @ np.linalg.lstsq(terms, scaled, rcond=None)[0], np.float64)
    uncertainty = float(np.sqrt(influence_of_lines(root, left_over, terms, runs_of(volts[kept])).covariance[0, 0]))
    share = np.array([line.bowed_rows(column, 1 / radius_px**2) for line in lines])
    return _Bow(rows if abs(rows) > MIN_BEND_SIGMAS * uncertainty else 0.0, uncertainty, share)


def _fit(
    volts: Floats,
    rows: Floats,
    used: NDArray[np.bool_],
    tilt_deg: float,
    bow: _Bow,
    drawn: Drawn,
    column: float,
    dark: int,
    each_rows: float,
) -> GalvoMap:
    v, y = volts[used], rows[used]
    middle, half = (v.max() + v.min()) / 2, np.ptp(v) / 2
    x, runs = place_in_sweep(v), runs_of(v)
    jacobian = np.asarray(np.stack([np.ones_like(x), x], axis=1), np.float64)
    level, per_half = np.linalg.lstsq(jacobian, y, rcond=None)[0]
    residuals = np.asarray(y - jacobian @ (level, per_half), np.float64)
    volts_per_row = half / per_half
    # volts at row zero = middle - half * level / per_half, and its derivatives
    to_zero = np.array([-half / per_half, half * level / per_half**2])
    # A curve of the galvo or of the lens is no scatter; what it moves the middle by is added below.
    curve = _curvature(x, y, runs)
    # Cores of other light draw single lines, too, so that their errors and that of the light are not independent.
    of_lines = influence_of_lines(jacobian, curve.left_over, curve.terms, runs).less(drawn.light, drawn.per_coefficient)
    # The residuals of a few lines may be small by chance: the lines' own uncertainties, if larger, count as some more.
    free = len(v) - curve.terms.shape[1]
    left_over = float(np.square(curve.left_over).sum()) / free
    alone = max(each_rows**2, left_over) * np.linalg.inv(jacobian.T @ jacobian)
    covariance = (of_lines.covariance * free + alone * PRIOR_LINES) / (free + PRIOR_LINES)
    by_bow = bow.uncertainty_rows * np.linalg.lstsq(jacobian, bow.share[used], rcond=None)[0]

    def sigma(by: Floats) -> float:
        return float(np.sqrt(by @ covariance @ by + np.square(by @ by_bow)))

    return GalvoMap(
        volts_per_row=float(volts_per_row),
        volts_at_row_zero=float(middle - half * level / per_half),
        volts_per_row_uncertainty=sigma(np.array([0.0, volts_per_row / per_half])),
        volts_at_row_zero_uncertainty=sigma(to_zero),
        middle_uncertainty_rows=float(np.hypot(sigma(np.array([1.0, 0.0])), curve.middle_rows)),
        r_squared=float(1 - np.square(residuals).sum() / np.square(y - y.mean()).sum()),
        rms_rows=float(np.sqrt(np.mean(np.square(residuals)))),
        curvature_rows=float(np.abs(curve.rows).max()),
        curved=curve.significant,
        tilt_deg=tilt_deg,
        bow_rows=bow.rows,
        bow_uncertainty_rows=bow.uncertainty_rows,
        column=column,
        lines=len(v),
        dark=dark,
        outliers=int((~used).sum()),
        volts=volts,
        rows=rows,
        used=used,
    )


class _Curve(NamedTuple):
    """A cubic: its terms, its departure from the straight line, there and at the middle, and what it leaves over."""

    terms: Floats
    rows: Floats
    left_over: Floats
    middle_rows: float
    significant: bool


def _curvature(x: Floats, y: Floats, runs: NDArray[np.intp]) -> _Curve:
    """Fit a cubic, or less to few lines, to the rows `y` of lines at places `x` of the sweep, from -1 to 1."""
    terms = polynomial_terms(x)
    coefficients = np.linalg.lstsq(terms, y, rcond=None)[0]
    bend = np.asarray(terms[:, 2:] @ coefficients[2:], np.float64)
    left_over = np.asarray(y - terms @ coefficients, np.float64)
    sigmas = np.linalg.norm(clustered_influence(terms, left_over, runs, RUNS)[:, 2:], axis=0)
    significance = np.abs(coefficients[2:]) / np.maximum(sigmas, 1e-12)
    even = significance[:1] > MIN_BEND_SIGMAS  # the second polynomial, -1/2 in the middle
    middle_rows = float(np.abs(coefficients[2:3][even]).sum()) / 2
    curved = bool(np.abs(bend).max() > 0.1 and significance.max(initial=0.0) > 5)
    return _Curve(terms, bend, left_over, middle_rows, curved)
