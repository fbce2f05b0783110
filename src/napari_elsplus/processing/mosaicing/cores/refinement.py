"""Place and brightness of a frame, and gains of the cores, refined on the image that all frames gave.

The values of a frame's cores are compared with the image as the cores see it: by Gauss-Newton steps for the shift and
the brightness of the frame, and by regression over all frames for each core.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

_STEPS: Final = 4
"""Gauss-Newton steps; measured: the last one is below a hundredth of a cell."""
_GAIN_PRIOR_FRAMES: Final = 2.0
"""Frames to which the prior of a core's gain, the one it has, is equivalent; chosen."""
_GAIN_LIMITS: Final = (0.5, 2.0)
"""Smallest and largest correction of a core's gain; chosen, as of the exposure of frames."""


class Placement(NamedTuple):
    """Place and brightness of a frame relative to the image.

    Parameters
    ----------
    row, col : float
        Shift of the frame's cores, cells.
    exposure : float
        Brightness of the frame over that of the image.
    """

    row: float = 0.0
    col: float = 0.0
    exposure: float = 1.0


def refine_placement(
    expected: NDArray[np.float32], places: NDArray[np.float64], values: NDArray[np.float32],
    weights: NDArray[np.float32], limit: float,
) -> Placement:  # fmt: skip
    """Return where a frame fits the image best, near the place that it has.

    Parameters
    ----------
    expected : numpy.ndarray
        (rows, cols) float32 part of the image as cores see it; NaN where there is none.
    places : numpy.ndarray
        (m, 2) float64 places of the cores on that part, cells.
    values, weights : numpy.ndarray
        (m,) float32 values of the cores and their weights.
    limit : float
        Largest shift, cells; a frame that would move farther stays.
    """
    found = Placement()
    for _ in range(_STEPS):
        normal, right = np.zeros((3, 3)), np.zeros(3)
        _accumulate(
            expected, np.add(places, (found.row, found.col)), values, weights, np.float32(found.exposure), normal, right
        )
        if normal[2, 2] <= 0:
            return Placement()
        step = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(3), right)
        found = Placement(found.row + float(step[0]), found.col + float(step[1]), found.exposure + float(step[2]))
    kept = np.hypot(found.row, found.col) < limit and 0.5 < found.exposure < 2
    return found if kept else Placement()


class CoreGains:
    """Regression of each core's values on what the image has at its places.

    Parameters
    ----------
    count : int
        Number of cores.
    """

    def __init__(self, count: int) -> None:
        self._product, self._square = np.zeros((2, count))

    def add(
        self, expected: NDArray[np.float32], places: NDArray[np.float64], values: NDArray[np.float32], exposure: float
    ) -> None:  # fmt: skip
        """Add a frame; arguments as of :func:`refine_placement`."""
        _regress(expected, places, values, np.float32(exposure), self._product, self._square)

    def corrections(self, frames: int) -> NDArray[np.float32]:
        """Return the factor for each core's gain (m,) float32, from a number of frames."""
        prior = _GAIN_PRIOR_FRAMES * self._square.sum() / max(np.count_nonzero(self._square), 1) / max(frames, 1)
        gains = (self._square + prior) / np.maximum(self._product + prior, 1e-30)
        return np.asarray(np.clip(gains, *_GAIN_LIMITS), np.float32)


@kernel
def _interpolate(image: NDArray[np.float32], row: float, col: float) -> tuple[float, float, float]:
    """Return an image's bilinear value at a place and its slopes along rows and columns; NaN beyond the image."""
    rows, cols = image.shape
    r, c = int(np.floor(row)), int(np.floor(col))
    if r < 0 or c < 0 or r + 1 >= rows or c + 1 >= cols:
        return np.nan, np.nan, np.nan
    down, across = row - r, col - c
    a, b, d, e = image[r, c], image[r, c + 1], image[r + 1, c], image[r + 1, c + 1]
    downward = d - a + across * (a - b - d + e)
    return a + across * (b - a) + down * downward, downward, b - a + down * (a - b - d + e)


@kernel
def _accumulate(
    expected: NDArray[np.float32],
    places: NDArray[np.float64],
    values: NDArray[np.float32],
    weights: NDArray[np.float32],
    exposure: np.float32,
    normal: NDArray[np.float64],
    right: NDArray[np.float64],
) -> None:
    """Add the normal equations of shift and exposure."""
    slope = np.zeros(3)
    for k in range(len(values)):
        level, downward, sideways = _interpolate(expected, places[k, 0], places[k, 1])
        missed = values[k] - exposure * level
        if missed != missed:  # NaN: beyond the image
            continue
        slope[0] = exposure * downward
        slope[1] = exposure * sideways
        slope[2] = level
        for i in range(3):
            right[i] += weights[k] * slope[i] * missed
            for j in range(3):
                normal[i, j] += weights[k] * slope[i] * slope[j]


@kernel
def _regress(
    expected: NDArray[np.float32],
    places: NDArray[np.float64],
    values: NDArray[np.float32],
    exposure: np.float32,
    product: NDArray[np.float64],
    square: NDArray[np.float64],
) -> None:
    """Add the products of values and expected ones, and the squares of these, for each core."""
    for k in range(len(values)):
        level = exposure * _interpolate(expected, places[k, 0], places[k, 1])[0]
        if level != level or values[k] != values[k]:
            continue
        product[k] += level * values[k]
        square[k] += level * level
