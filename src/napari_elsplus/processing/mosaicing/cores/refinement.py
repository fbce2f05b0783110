"""Place and brightness of a frame, and gains of the cores, refined on the image that all frames gave.

The values of a frame's cores are compared with the image as the cores see it: by Gauss-Newton steps for the shift and
the brightness of the frame, and by regression over all frames for each core.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

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
        level, downward, sideways = _interpolated(expected, np.add(places, (found.row, found.col)))
        missed = values - found.exposure * level
        seen = np.isfinite(missed)
        if not seen.any():
            return Placement()
        slopes = np.stack([found.exposure * downward, found.exposure * sideways, level])[:, seen]
        normal = np.einsum("im,m,jm->ij", slopes, weights[seen], slopes)
        right = np.einsum("im,m->i", slopes, weights[seen] * missed[seen])
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
        level = exposure * _interpolated(expected, places)[0]
        seen = np.isfinite(level) & np.isfinite(values)
        self._product[seen] += level[seen] * values[seen]
        self._square[seen] += np.square(level[seen])

    def corrections(self, frames: int) -> NDArray[np.float32]:
        """Return the factor for each core's gain (m,) float32, from a number of frames."""
        prior = _GAIN_PRIOR_FRAMES * self._square.sum() / max(np.count_nonzero(self._square), 1) / max(frames, 1)
        gains = (self._square + prior) / np.maximum(self._product + prior, 1e-30)
        return np.asarray(np.clip(gains, *_GAIN_LIMITS), np.float32)


def _interpolated(image: NDArray[np.float32], places: Floats) -> tuple[Floats, Floats, Floats]:
    """Return bilinear values of an image at places (m, 2), NaN beyond it, and slopes along rows and columns."""
    pixel = np.floor(places).astype(np.intp)
    beyond = ((pixel < 0) | (pixel + 1 >= image.shape)).any(axis=1)
    pixel[beyond] = 0
    (row, col), (down, across) = pixel.T, (places - pixel).T
    a, b, d, e = image[row, col], image[row, col + 1], image[row + 1, col], image[row + 1, col + 1]
    downward, sideways = d - a + across * (a - b - d + e), b - a + down * (a - b - d + e)
    level = a + across * (b - a) + down * downward
    return np.where(beyond, np.nan, level), downward, sideways
