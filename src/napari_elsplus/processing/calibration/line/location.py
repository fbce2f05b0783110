"""Location of the laser line in one view of the bundle.

The paper takes profiles perpendicular to the line, removes the background by a threshold and fits a Gaussian (System
Calibration, step i). Here the profiles of all columns are fitted together, with the line's tilt, so that the honeycomb
of the cores averages out and its remainder is part of the stated uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy import ndimage

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.analysis.uncertainty import estimator_influence
from napari_elsplus.processing.calibration.line.bow import fit_bow
from napari_elsplus.processing.calibration.line.search import Streak, brightest_streak, without_hot_pixels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

RUNS: Final = 32
"""Runs of columns of a line: its profiles, and the clusters of its uncertainty; chosen, each wider than a core."""
MIN_SIGMAS: Final = 7.0
"""Height of a line in standard deviations of the noise; chosen: noise alone stays below over thousands of rows."""
MAX_REACH_ROWS: Final = 120
"""To either side, that a fit may use; chosen: above the halo of a line at any magnification."""
TAPER: Final = 1.5
"""Standard deviation of the weights across the line, in those of the smoothed profile; chosen."""
MAX_UNCERTAINTY_ROWS: Final = 1.0
"""Chosen: a slit of three rows that is a row off loses a good part of the light."""
MAX_MISFIT: Final = 0.04
"""Weighted departure of the mean profile from a Gaussian, over its height; chosen: lines stay below 0.008."""
MIN_BRIGHTNESS: Final = 0.25
"""Of a column over the usual one, below which a line ends; chosen: light that varies by half each way along it stays
above."""
MIN_BEND_ROWS: Final = 0.3
"""Root mean square of a bow that is fitted along its own curve; chosen: of a smaller one the vertex is a hundredth of
a row off in the linear estimate, and a straight line's noise stays below."""
LAST_STEP_ROWS, SMALL_STEP_ROWS = 1e-5, 1e-2
"""Largest step that ends a fit, and one from which another starts; chosen: the error is about the step's square."""
RIDGE: Final = 1e-12
"""Of the curvature's trace, added to its diagonal, which is 0 for a line without light; chosen: no step changes."""
_ROW, _SLOPE = 3, 4
"""Indices of row and slope among the fitted parameters."""


@dataclass(frozen=True, slots=True)
class Line:
    """A laser line in one view.

    Parameters
    ----------
    row : float
        Row of the line at ``column``.
    column : float
        Middle of the lit columns.
    slope : float
        Rows per column; the line's tilt.
    width_rows : float
        Standard deviation of its Gaussian.
    amplitude : float
        Grey levels above the background.
    level, ramp : float
        Background of the fit at the line, and its slope in grey levels per row.
    columns : tuple of int
        First lit column and the one after the last.
    profile : numpy.ndarray
        Grey levels across the line, mean of its columns, as fitted; shape (rows,).
    profile_rows : numpy.ndarray
        Their rows, from the line's middle, shape (rows,).
    influence : numpy.ndarray
        Shape (runs, 2): contribution of each run of columns to the error of row and slope.
    bend : float
        Rows per squared column of the parabola that the columns' departures from the straight line fit.
    mean_square_px : float
        Mean square distance of the fitted columns from ``column``, weighted by their light, in squared columns: the
        straight line through a parabola passes it at this distance.
    """

    row: float
    column: float
    slope: float
    width_rows: float
    amplitude: float
    level: float
    ramp: float
    columns: tuple[int, int]
    profile: Floats
    profile_rows: Floats
    influence: Floats
    bend: float = 0.0
    mean_square_px: float = 0.0

    @property
    def length_px(self) -> int:
        """Number of lit columns."""
        return self.columns[1] - self.columns[0]

    @property
    def tilt_deg(self) -> float:
        """Tilt against the camera's rows; positive where the line falls to the right."""
        return float(np.degrees(np.arctan(self.slope)))

    @property
    def tilt_uncertainty_deg(self) -> float:
        """One standard deviation of the tilt."""
        return float(np.degrees(np.linalg.norm(self.influence[:, 1])))

    @property
    def fitted(self) -> Floats:
        """The Gaussian and its background at ``profile_rows``, shape (rows,); good near the line only, as fitted."""
        bell = np.exp(-0.5 * np.square(self.profile_rows / self.width_rows))
        return np.asarray(self.level + self.ramp * self.profile_rows + self.amplitude * bell, np.float64)

    @property
    def bow(self) -> float:
        """The bend, rows per squared column, or 0 where it is negligible, or a fit to no line that has diverged."""
        return self.bend if MIN_BEND_ROWS < abs(self.bend) * self.mean_square_px < MAX_REACH_ROWS else 0.0

    @property
    def streak(self) -> Streak:
        """The line as the start of another fit, its middle on a whole row."""
        middle = round(self.row - self.bow * self.mean_square_px)
        return Streak(middle, self.column, self.slope, self.width_rows, self.bow)

    def row_at(self, column: float) -> float:
        """Return the row of the line at a column."""
        return self.row + self.slope * (column - self.column)

    def bowed_rows(self, column: float, bend: float) -> float:
        """Return the rows by which a line with a bend lies below the straight one at a column.

        Parameters
        ----------
        column : float
            Column of the view.
        bend : float
            Rows per squared column.
        """
        return bend * ((column - self.column) ** 2 - self.mean_square_px)

    def bent_row_at(self, column: float) -> float:
        """Return the row of the line with its own bend at a column."""
        return self.row_at(column) + self.bowed_rows(column, self.bend)

    def influence_at(self, column: float) -> Floats:
        """Return the contribution of each run of columns to the error of the row at a column, shape (runs,)."""
        return np.asarray(self.influence[:, 0] + (column - self.column) * self.influence[:, 1], np.float64)

    def uncertainty_rows(self, column: float | None = None) -> float:
        """Return one standard deviation of the line's row at a column, by default its middle."""
        return float(np.linalg.norm(self.influence_at(self.column if column is None else column)))


def locate_line(view: NDArray[np.generic], background: Image | None = None, near: Line | None = None) -> Line:
    """Locate the laser line in one view: threshold, Gaussian, tilt, uncertainty.

    Parameters
    ----------
    view : numpy.ndarray
        One view of the bundle (rows, cols), any real dtype, with a single standing line along the rows.
    background : numpy.ndarray, optional
        Mean frame of the dark tube for the same pixels.
    near : Line, optional
        Line in the frame before. If it has moved by less than its width, it is not searched.

    Returns
    -------
    Line
        The brightest line; its fainter reflections are ignored.

    Raises
    ------
    MeasurementError
        If no line stands out of the noise, or the brightest streak is too wide for one.

    Notes
    -----
    The profiles are smoothed with the line's own width before the Gaussian is fitted, which keeps the rows of cores,
    about as far apart as the line is wide, from biasing it. A slope of the background is fitted too: near the bundle's
    rim the line's halo is cut on one side. A reflection within three widths merges with the line and moves it, in both
    views alike, so that their offset stays true.

    Examples
    --------
    >>> rows = np.arange(80)[:, None] - 31.25 + 0 * np.arange(120)
    >>> line = locate_line(100 * np.exp(-(rows**2) / 8))
    >>> round(line.row, 3)
    31.25
    """
    line = None if near is None else _still_near(view, background, near)
    if line is None:
        streak = brightest_streak(view, background)
        first, band = _band_around(view, background, streak)
        line = _fit(band, streak._replace(row=streak.row - first), SMALL_STEP_ROWS)
        # Centred on a whole row: interpolation then skews both sides alike.
        line = _fit(band, line.streak)
        if line.bow:
            line = _fit(band, line.streak)
        line = replace(line, row=line.row + first)
    if line.width_rows > len(view) / 8:
        raise MeasurementError(
            f"no laser line: the brightest streak is {2.355 * line.width_rows:.0f} of {len(view)} rows wide",
            "is other light on?",
        )
    return line


def _still_near(view: NDArray[np.generic], background: Image | None, near: Line) -> Line | None:
    """Fit the line near its last position; return None if it has moved by more than its width."""
    first, band = _band_around(view, background, near.streak)
    try:
        line = _fit(band, near.streak._replace(row=near.streak.row - first))
    except MeasurementError:
        return None
    line = replace(line, row=line.row + first)
    return line if abs(line.row_at(near.column) - near.row) < near.width_rows else None


def _band_around(view: NDArray[np.generic], background: Image | None, streak: Streak) -> tuple[int, Image]:
    """Return the first row, and the rows that a fit may need, without background and hot pixels."""
    half = view.shape[1] / 2
    reach = MAX_REACH_ROWS + int(np.ceil(abs(streak.slope) * half + abs(streak.bend) * half**2))
    first = max(int(streak.row) - reach, 0)
    rows = slice(first, int(streak.row) + reach + 1)
    of_tube = np.float32(0) if background is None else background[rows]
    return first, without_hot_pixels(np.subtract(view[rows], of_tube, dtype=np.float32))


def _fit(image: Image, streak: Streak, last_step_rows: float = LAST_STEP_ROWS) -> Line:
    """Fit one tilted Gaussian line, by Gauss-Newton, to the profiles around a streak."""
    width = min(streak.width_rows, MAX_REACH_ROWS / 9)
    reach = int(np.ceil(4.5 * width)) + 2
    patch, inside, spread = _along(image, streak, reach + int(np.ceil(3 * width)))
    first, stop = _lit_columns(_brightness(patch, width))
    inset = min(int(np.ceil(2 * width)) + 2, (stop - first) // 8)
    edges = np.linspace(first + inset, stop - inset, RUNS + 1).astype(int)
    if stop - first - 2 * inset < RUNS or inside[:, first:stop].mean() < 0.6:
        raise MeasurementError(
            f"no laser line: the brightest streak spans {stop - first} columns", "is the laser on, and on the bundle?"
        )
    profiles = np.add.reduceat(patch, edges, axis=1)[:, :-1] / np.diff(edges)
    seen = np.logical_and.reduceat(inside, edges, axis=1)[:, :-1]
    margin = (len(patch) - 1) // 2 - reach
    data = ndimage.gaussian_filter1d(profiles, width, axis=0, mode="nearest", truncate=3.0)[margin:-margin]
    seen = seen[margin:-margin]
    middle = (first + stop - 1) / 2
    u = np.broadcast_to(np.arange(-reach, reach + 1.0)[:, None], data.shape)[seen]
    x = np.broadcast_to((edges[:-1] + edges[1:] - 1) / 2 - middle, data.shape)[seen]
    run = np.broadcast_to(np.arange(RUNS), data.shape)[seen]
    parameters, influence, left, jacobian, taper = _gauss_newton(data[seen], u, x, run, width, last_step_rows)
    bow = fit_bow(left, parameters[0] * jacobian[:, 0], jacobian[:, _ROW], taper, x, run, RUNS)
    amplitude, level, log_width, shift, turn, ramp = (float(value) for value in parameters)
    away = middle - streak.column
    fitted = float(np.sqrt(max(np.exp(2 * log_width) - width**2 - spread, 0.1)))
    misfit = _misfit(left * taper, seen, amplitude)
    # In dim light only a part of the line may be visible: its uncertainty in the middle of the view counts.
    across = influence[:, _ROW] + ((image.shape[1] - 1) / 2 - middle) * influence[:, _SLOPE]
    _must_be_a_line(amplitude, np.linalg.norm([influence[:, 0], across], axis=1), shift, reach, misfit)
    return Line(
        row=streak.row + streak.slope * away + streak.bend * (away**2 + bow.mean_square_px) + shift,
        column=middle,
        slope=streak.slope + 2 * streak.bend * away + turn,
        width_rows=fitted,
        amplitude=amplitude * float(np.exp(log_width)) / fitted,
        level=level + ramp * shift,
        ramp=ramp,
        columns=(first, stop),
        profile=profiles.mean(axis=1),
        profile_rows=np.arange(len(profiles), dtype=np.float64) - (len(profiles) - 1) / 2 - shift,
        influence=influence[:, [_ROW, _SLOPE]],
        bend=streak.bend + bow.bend,
        mean_square_px=bow.mean_square_px,
    )


def _along(image: Image, streak: Streak, reach: int) -> tuple[Floats, NDArray[np.bool_], float]:
    """Return profiles of all columns about the streak, (2 reach + 1, cols), their rows on the view, the added variance.

    Linear interpolation between rows adds that variance to the profile.
    """
    rows, cols = image.shape
    along = np.arange(cols) - streak.column
    where = streak.row + streak.slope * along + streak.bend * along**2
    base = np.floor(where).astype(int)
    part = (where - base).astype(np.float32)
    index = base + np.arange(-reach, reach + 2)[:, None]
    # Columns whose streak lies in the same row are copied together.
    whole = np.empty(index.shape, np.float32)
    for start, stop in pairwise([0, *(np.flatnonzero(np.diff(base)) + 1).tolist(), cols]):
        np.take(image[:, start:stop], index[:, start], axis=0, mode="clip", out=whole[:, start:stop])
    inside = (index >= 0) & (index < rows)
    profiles = ((1 - part) * whole[:-1] + part * whole[1:]).astype(np.float64)
    return profiles, inside[:-1] & inside[1:], float(np.mean(part * (1 - part)))


def _brightness(patch: Floats, width: float) -> Floats:
    """Return the light of the line in each column, above the column's own background."""
    u = np.arange(len(patch)) - (len(patch) - 1) / 2
    bell = np.exp(-(u**2) / (2 * width**2))
    return np.asarray((bell - bell.mean()) @ patch, np.float64)


def _lit_columns(brightness: Floats) -> tuple[int, int]:
    """Return the first column in which the line has half its usual brightness, and the one after the last.

    Of several such runs, the longest is taken with those between which the line does not fade; a few columns are none.
    """
    smooth = ndimage.uniform_filter1d(brightness, max(3, len(brightness) // RUNS), mode="nearest")
    usual = np.sort(smooth)[17 * len(smooth) // 20]
    lit, count = ndimage.label(smooth > MIN_BRIGHTNESS * usual)
    longest = np.argmax(np.bincount(lit)[1:]) + 1 if count else 0
    runs = ndimage.binary_opening(smooth > 0.5 * usual, np.ones(max(1, len(smooth) // RUNS)))
    bright = np.flatnonzero((lit == longest) & runs)
    return (int(bright[0]), int(bright[-1]) + 1) if count and len(bright) else (0, 0)


def _gauss_newton(
    data: Floats, u: Floats, x: Floats, run: NDArray[np.intp], width: float, last_step_rows: float
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Fit amplitude, level, log width, row, slope and the level's slope.

    Return them and the runs' influences; the data less the model, its derivatives, and the weights.
    """
    ordered = np.sort(data)  # faster than np.percentile
    level, top = float(ordered[len(data) // 4]), float(ordered[19 * len(data) // 20])
    parameters = np.array((top - level, level, np.log(np.sqrt(2) * width), 0.0, 0.0, 0.0))
    for _ in range(12):
        model, jacobian, taper = _model(parameters, u, x)
        weighted = jacobian * taper[:, None]
        curvature = weighted.T @ jacobian
        if not (ridge := RIDGE * np.trace(curvature)) > np.finfo(float).tiny:  # nearly no column has weight
            raise MeasurementError("no laser line: the fit diverged from the brightest streak", "is the laser on?")
        curvature.flat[:: len(curvature) + 1] += ridge
        step = np.linalg.solve(curvature, weighted.T @ (data - model))
        step[2] = np.clip(step[2], -0.4, 0.4)
        step[_ROW] = np.clip(step[_ROW], -width, width)
        parameters += step
        if np.abs(step[2 : _ROW + 1]).max() < last_step_rows:
            break
    model, jacobian, taper = _model(parameters, u, x)
    weighted = jacobian * taper[:, None]
    left = data - model
    influence = estimator_influence(weighted * left[:, None], weighted.T @ jacobian, run, RUNS)
    return parameters, influence, left, jacobian, taper


def _model(parameters: Floats, u: Floats, x: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the model, its derivatives, and weights that decrease away from the line.

    With equal weights the halo, which is no straight slope, would bias a line that is not in the middle of a row.
    """
    amplitude, level, log_width, shift, turn, ramp = parameters
    z = (u - shift - turn * x) / np.exp(log_width)
    bell = np.exp(-0.5 * z * z)
    per_row = amplitude * bell * z / np.exp(log_width)
    jacobian = np.stack([bell, np.ones_like(bell), amplitude * bell * z * z, per_row, per_row * x, u], axis=1)
    taper = np.exp(-0.5 * (z / TAPER) ** 2)
    return amplitude * bell + level + ramp * u, jacobian, taper


def _misfit(weighted: Floats, seen: NDArray[np.bool_], amplitude: float) -> float:
    """Return the largest departure of the mean profile from the fit, weighted as in the fit, over the amplitude."""
    residual = np.zeros(seen.shape)
    residual[seen] = weighted
    count = np.count_nonzero(seen, axis=1)
    profile = residual.sum(axis=1)[count > 0] / count[count > 0]
    return float(np.abs(profile).max() / max(abs(amplitude), 1e-12))


def _must_be_a_line(amplitude: float, spread: Floats, shift: float, reach: int, misfit: float) -> None:
    noise, spread_rows = spread
    sigmas = amplitude / max(noise, 1e-12)
    if not sigmas > MIN_SIGMAS:
        raise MeasurementError(
            f"no laser line: the brightest streak stands {sigmas:.1f} standard deviations out of the noise, "
            f"{MIN_SIGMAS:g} are needed",
            "is the laser on, and on the bundle?",
        )
    if abs(shift) > reach:
        raise MeasurementError(f"no laser line: the fit diverged by {shift:.0f} rows", "is the laser on?")
    if spread_rows > MAX_UNCERTAINTY_ROWS:
        raise MeasurementError(
            f"no laser line: the brightest streak is so dim that its uncertainty is {spread_rows:.1f} rows",
            "give more light, or more frames",
        )
    if misfit > MAX_MISFIT:
        raise MeasurementError(
            f"no laser line: the brightest streak departs from a Gaussian by {100 * misfit:.0f} % of its height",
            "is other light on?",
        )
