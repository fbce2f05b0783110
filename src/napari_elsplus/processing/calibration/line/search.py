"""Search for the brightest straight streak in one view: an initial estimate of the laser line, to about a row.

A Hough transform for nearly level lines: brightness is compressed, so that every part of the line counts and no hot
spot dominates, then summed along each slope.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.analysis.uncertainty import robust_sigma
from napari_elsplus.processing.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

MIN_VIEW: Final = (16, 48)
"""Rows and columns; chosen: a line with its background, and three columns for each block."""
MAX_SLOPE: Final = 0.07
"""Rows per column; chosen: 4 degrees, twice what alignment by eye leaves."""
_BLOCKS: Final = 16
"""Of columns; chosen: over one of them a line of that slope stays within a few rows."""
_REACH: Final = 12
"""Rows to either side for the width; chosen: twice the widest streak that is expected."""
_THINNED: Final = 3
"""Rows from one to the next of which medians are taken; chosen: hundreds are left, a line covers a tenth of them."""
_REDUCED: Final = (np.uint8, np.uint16, np.float32)
"""Types of pixels that OpenCV averages without a converted copy."""
_NEIGHBOURS: Final = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)
"""Structuring element of the eight neighbours of a pixel, without itself."""


class Streak(NamedTuple):
    """Row and rows per column at a column, the standard deviation across, in rows, and rows per squared column."""

    row: float
    column: float
    slope: float
    width_rows: float
    bend: float = 0.0


def without_hot_pixels(image: Image) -> Image:
    """Replace pixels that are far brighter than all their neighbours; cores, which are wider, are kept.

    Parameters
    ----------
    image : numpy.ndarray
        (rows, cols) float32.

    Returns
    -------
    numpy.ndarray
        The image itself if it has none.
    """
    around = cv2.dilate(image, _NEIGHBOURS)
    floor = float(np.median(image[::7, ::7]))
    hot = image - floor > 4 * np.maximum(around - floor, 2.0) + 8.0
    return np.where(hot, cv2.medianBlur(image, 3), image) if hot.any() else image


def brightest_streak(view: NDArray[np.generic], background: Image | None = None) -> Streak:
    """Find the straight, nearly level streak with the most light.

    Parameters
    ----------
    view : numpy.ndarray
        One view (rows, cols), any real dtype.
    background : numpy.ndarray, optional
        Mean frame of the dark tube for the same pixels.

    Raises
    ------
    MeasurementError
        If the view is too small or uniform.
    """
    rows, cols = view.shape
    if rows < MIN_VIEW[0] or cols < MIN_VIEW[1]:
        raise MeasurementError(f"no laser line: the view has {rows} x {cols} pixels", "a line needs at least 16 x 48")
    edges = np.linspace(0, cols, _BLOCKS + 1).astype(int)
    profiles = _block_means(view, edges)
    if background is not None:
        profiles -= _block_means(background, edges)
    profiles -= np.median(profiles[::_THINNED], axis=0)
    noise = float(robust_sigma(profiles[::_THINNED])) + 1e-3 * float(np.abs(profiles).max())
    if noise == 0:
        raise MeasurementError(f"no laser line: all pixels are {float(view[0, 0]):g}", "is the laser on?")
    evidence = np.log1p(np.clip(_smooth(profiles) / noise, 0, None))
    middles = (edges[:-1] + edges[1:] - 1) / 2 - (cols - 1) / 2
    count = int(MAX_SLOPE * cols / 2.5)
    slopes = np.linspace(-MAX_SLOPE, MAX_SLOPE, 2 * count + 1)
    shifts = np.rint(slopes[:, None] * middles).astype(np.int64)
    sheared = np.zeros((len(slopes), rows))
    _add_along(np.ascontiguousarray(_smooth(evidence).T), shifts, sheared)
    best, row = np.unravel_index(int(np.argmax(sheared)), sheared.shape)
    return Streak(float(row), (cols - 1) / 2, float(slopes[best]), _width(profiles, int(row), shifts[best]))


def _block_means(view: NDArray[np.generic], edges: NDArray[np.intp]) -> Floats:
    """Return the mean of each block of columns in each row, (rows, blocks)."""
    image = view if view.dtype in _REDUCED else np.asarray(view, np.float32)
    blocks = zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
    means = [cv2.reduce(image[:, first:stop], 1, cv2.REDUCE_AVG, dtype=cv2.CV_32F) for first, stop in blocks]
    return np.concatenate(means, axis=1, dtype=np.float64)


def _smooth(profiles: Floats) -> Floats:
    """Return profiles (rows, blocks) smoothed by a Gaussian of one row."""
    return np.asarray(cv2.GaussianBlur(profiles, (1, 9), sigmaX=1.0, sigmaY=1.0, borderType=cv2.BORDER_REFLECT))


def _width(profiles: Floats, row: int, shifts: NDArray[np.int64]) -> float:
    """Return the standard deviation of a Gaussian as wide as the streak at half height."""
    around = np.arange(-_REACH, _REACH + 1)[:, None] + row + shifts
    profile = profiles[np.clip(around, 0, len(profiles) - 1), np.arange(len(shifts))].sum(axis=1)
    profile -= profile.min()
    lit = np.flatnonzero(profile > 0.5 * profile[_REACH - 2 : _REACH + 3].max())
    return float(np.clip(np.count_nonzero(np.abs(lit - _REACH) <= 6) / 2.355, 0.8, 5.0))


@kernel
def _add_along(evidence: NDArray[np.float64], shifts: NDArray[np.int64], total: NDArray[np.float64]) -> None:
    """Sum blocks (blocks, rows), each shifted, for every slope: total (slopes, rows)."""
    slopes, rows = total.shape
    for s in range(slopes):
        for b in range(evidence.shape[0]):
            shift = shifts[s, b]
            for r in range(max(0, -shift), min(rows, rows - shift)):
                total[s, r] += evidence[b, r + shift]
