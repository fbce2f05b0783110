"""Where the laser line is in one view of the bundle.

The paper takes profiles perpendicular to the line, removes the background by a threshold and fits a Gaussian (System
Calibration, step i). Here all columns are fitted together, with the line's tilt, so that the honeycomb of the cores
averages out and its rest is part of the stated uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
from scipy import ndimage

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.uncertainty import clustered_influence

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

CLUSTERS: Final = 32
STEEPEST_TILT: Final = 0.07
VISIBLE_SIGMAS: Final = 7.0
_NEIGHBOURS: Final = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)


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
    columns : tuple of int
        First lit column and the one after the last.
    influence : numpy.ndarray
        Shape (clusters, 2): what each run of columns contributes to the error of row and slope.
    """

    row: float
    column: float
    slope: float
    width_rows: float
    amplitude: float
    columns: tuple[int, int]
    influence: Floats

    @property
    def tilt_deg(self) -> float:
        """Tilt against the camera's rows; positive where the line falls to the right."""
        return float(np.degrees(np.arctan(self.slope)))

    @property
    def tilt_uncertainty_deg(self) -> float:
        """One standard deviation of the tilt."""
        return float(np.degrees(np.linalg.norm(self.influence[:, 1])))

    def row_at(self, column: float) -> float:
        """Row of the line at a column."""
        return self.row + self.slope * (column - self.column)

    def influence_at(self, column: float) -> Floats:
        """Return what each run of columns contributes to the error of :meth:`row_at`."""
        total: Floats = self.influence[:, 0] + (column - self.column) * self.influence[:, 1]
        return total

    def uncertainty_rows(self, column: float | None = None) -> float:
        """One standard deviation of the line's row at a column."""
        return float(np.linalg.norm(self.influence_at(self.column if column is None else column)))


def locate_line(view: NDArray[np.generic], background: Image | None = None) -> Line:
    """Find the laser line in one view: threshold, Gaussian, tilt, uncertainty.

    Parameters
    ----------
    view : numpy.ndarray
        One view of the bundle (rows, cols), any real dtype, with a single standing line along the rows.
    background : numpy.ndarray, optional
        Mean frame of the dark tube for the same pixels.

    Returns
    -------
    Line
        The brightest line; fainter reflections of it are ignored.

    Raises
    ------
    MeasurementError
        If no line stands out of the noise, or what does is too wide for one.

    Notes
    -----
    The profile is smoothed with its own width before the Gaussian is fitted. That costs little precision and keeps
    the rows of cores, which are about as far apart as the line is wide, from pulling the fit.

    Examples
    --------
    >>> rows = np.arange(80)[:, None] - 31.25 + 0 * np.arange(120)
    >>> line = locate_line(100 * np.exp(-(rows**2) / 8))
    >>> round(line.row, 3)
    31.25
    """
    image = np.asarray(view, np.float32) if background is None else np.subtract(view, background, dtype=np.float32)
    image = without_hot_pixels(image)
    row, slope, width = _coarse_line(image)
    line = _fit(image, row, image.shape[1] / 2 - 0.5, slope, width)
    return _fit(image, line.row, line.column, line.slope, line.width_rows)


def without_hot_pixels(image: Image) -> Image:
    """Replace pixels that outshine all their neighbours by far; cores, which spread, are left alone."""
    around = cv2.dilate(image, _NEIGHBOURS)
    floor = float(np.median(image[::7, ::7]))
    hot = image - floor > 4 * np.maximum(around - floor, 2.0) + 8.0
    return np.where(hot, cv2.medianBlur(image, 3), image) if hot.any() else image


def _coarse_line(image: Image) -> tuple[float, float, float]:
    """Row at the middle column, slope, and width, from the brightest straight streak."""
    rows, cols = image.shape
    edges = np.linspace(0, cols, CLUSTERS + 1).astype(int)
    if cols < CLUSTERS or rows < 16:
        raise MeasurementError(f"the view has {rows} x {cols} pixels", "a line needs at least 16 x 32")
    profiles = np.add.reduceat(image, edges[:-1], axis=1, dtype=np.float64) / np.diff(edges)
    profiles -= np.median(profiles, axis=0)
    noise = 1.4826 * np.median(np.abs(profiles)) + 1e-3 * float(np.abs(profiles).max())
    if noise == 0:
        raise MeasurementError(f"no laser line: all pixels are {float(image.flat[0]):g}", "is the laser on?")
    evidence = np.log1p(np.clip(ndimage.gaussian_filter1d(profiles, 1.0, axis=0) / noise, 0, None))
    middles = (edges[:-1] + edges[1:] - 1) / 2 - (cols - 1) / 2
    slopes = np.arange(-STEEPEST_TILT, STEEPEST_TILT + 1e-9, max(1.5 / cols, 0.002))
    sheared = np.zeros((len(slopes), rows))
    for score, slope in zip(sheared, slopes, strict=True):
        for block, shift in enumerate(np.rint(slope * middles).astype(int)):
            score[max(-shift, 0) : rows - max(shift, 0)] += evidence[max(shift, 0) : rows + min(shift, 0), block]
    best, row = np.unravel_index(np.argmax(ndimage.gaussian_filter1d(sheared, 1.0, axis=1)), sheared.shape)
    reach = 12
    profile = np.zeros(2 * reach + 1)
    for block, shift in enumerate(np.rint(slopes[best] * middles).astype(int)):
        window = np.clip(np.arange(row + shift - reach, row + shift + reach + 1), 0, rows - 1)
        profile += profiles[window, block]
    profile -= profile.min()
    lit = np.flatnonzero(profile > 0.5 * profile[reach - 2 : reach + 3].max())
    near = lit[np.abs(lit - reach) <= 6]
    width = float(np.clip(len(near) / 2.355, 0.8, 5.0))
    return float(row), float(slopes[best]), width


def _lit_columns(brightness: Floats) -> tuple[int, int]:
    """Longest run of columns in which the line shines, at half its usual brightness."""
    smooth = ndimage.uniform_filter1d(brightness, max(3, len(brightness) // CLUSTERS), mode="nearest")
    lit = smooth > 0.5 * np.percentile(smooth, 85)
    starts = np.flatnonzero(np.diff(np.r_[0, lit.astype(np.int8), 0]) == 1)
    stops = np.flatnonzero(np.diff(np.r_[0, lit.astype(np.int8), 0]) == -1)
    if not len(starts):
        return 0, 0
    longest = int(np.argmax(stops - starts))
    return int(starts[longest]), int(stops[longest])


def _fit(image: Image, row: float, column: float, slope: float, width: float) -> Line:
    """Gauss-Newton fit of one tilted Gaussian line to the pixels around it."""
    rows, cols = image.shape
    reach = int(np.ceil(4.5 * width)) + 2
    margin = int(np.ceil(3 * width))
    where = row + slope * (np.arange(cols) - column)
    base = np.rint(where).astype(int)
    offsets = np.arange(-reach - margin, reach + margin + 1)
    index = base + offsets[:, None]
    patch = image[np.clip(index, 0, rows - 1), np.arange(cols)].astype(np.float64)
    patch = ndimage.gaussian_filter1d(patch, width, axis=0, mode="nearest", truncate=3.0)[margin:-margin]
    inside = ((index >= 0) & (index < rows))[margin:-margin]
    u = base + np.arange(-reach, reach + 1)[:, None] - where
    shape = np.exp(-(u**2) / (4 * width**2))
    floor = np.median(patch, axis=0)
    brightness = ((patch - floor) * shape).sum(axis=0)
    first, stop = _lit_columns(brightness)
    inset = min(int(np.ceil(2 * width)) + 2, (stop - first) // 8)
    use = np.zeros(cols, bool)
    use[first + inset : stop - inset] = True
    use &= inside.mean(axis=0) > 0.6
    if use.sum() < CLUSTERS:
        raise MeasurementError(
            f"no laser line: what is brightest spans {int(use.sum())} columns",
            "is the laser on and the line on the bundle?",
        )
    middle = (first + stop - 1) / 2
    x = np.broadcast_to(np.arange(cols) - middle, u.shape)[:, use][inside[:, use]]
    u = u[:, use][inside[:, use]]
    data = patch[:, use][inside[:, use]]
    level = np.percentile(data, 25)
    parameters = np.array([float(np.percentile(data, 95) - level), float(level), np.log(1.414 * width), 0.0, 0.0, 0.0])
    for _ in range(12):
        model, jacobian = _model(parameters, u, x)
        step = np.linalg.lstsq(jacobian.T @ jacobian, jacobian.T @ (data - model), rcond=None)[0]
        step[2] = np.clip(step[2], -0.4, 0.4)
        step[3] = np.clip(step[3], -width, width)
        parameters += step
        if np.abs(step[2:4]).max() < 1e-5:
            break
    model, jacobian = _model(parameters, u, x)
    clusters = np.clip(((x + middle - first) * CLUSTERS / (stop - first)).astype(np.intp), 0, CLUSTERS - 1)
    influence = clustered_influence(jacobian, data - model, clusters, CLUSTERS)
    amplitude, _, log_width, shift, turn, _ = (float(value) for value in parameters)
    fitted = np.sqrt(max(np.exp(2 * log_width) - width**2, 0.1))
    _must_be_a_line(amplitude, float(np.linalg.norm(influence[:, 0])), fitted, shift, reach, rows)
    return Line(
        row=row + slope * (middle - column) + shift,
        column=middle,
        slope=slope + turn,
        width_rows=float(fitted),
        amplitude=amplitude * float(np.exp(log_width) / fitted),
        columns=(first, stop),
        influence=influence[:, 3:5],
    )


def _model(parameters: Floats, u: Floats, x: Floats) -> tuple[Floats, Floats]:
    amplitude, level, log_width, shift, turn, tilt = parameters
    z = (u - shift - turn * x) / np.exp(log_width)
    bell = np.exp(-0.5 * z * z)
    pull = amplitude * bell * z / np.exp(log_width)
    jacobian = np.stack([bell, np.ones_like(bell), amplitude * bell * z * z, pull, pull * x, u], axis=1)
    return amplitude * bell + level + tilt * u, jacobian


def _must_be_a_line(amplitude: float, noise: float, width: float, shift: float, reach: int, rows: int) -> None:
    sigmas = amplitude / max(noise, 1e-12)
    if not sigmas > VISIBLE_SIGMAS:
        raise MeasurementError(
            f"no laser line: the brightest streak stands {sigmas:.1f} standard deviations out of the noise, "
            f"{VISIBLE_SIGMAS:g} are needed",
            "is the laser on and the line on the bundle?",
        )
    if width > rows / 8 or abs(shift) > reach:
        raise MeasurementError(
            f"no laser line: the brightest streak is {2.355 * width:.0f} of {rows} rows wide", "is other light on?"
        )
