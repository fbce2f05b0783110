"""Hot pixels and dead columns of the camera, found in the background and replaced in raw frames by their neighbours.

Their dark current is subtracted with the background, but its noise is not, and a saturated one shows nothing at all,
nor does a dead column.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, TypeVar

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

Pixel = TypeVar("Pixel", bound=np.generic)

EXCESS: Final = 24.0
"""Excess of a hot pixel over the brightest of its eight neighbours, in the median excess of a local maximum; derived:
of noise, which decays faster than exponentially, one pixel in 2^24 exceeds it."""
PATTERN: Final = 4.0
"""Excess of a hot pixel, in the range of the pixels around it; derived: that of a core centred on a pixel is at most 3,
where cores are two pixels apart."""
MIN_EXCESS: Final = 3.0
"""Least excess, grey levels; chosen: the noise of less dark current is below that of the camera."""
SAMPLED: Final = 8
"""Step of the rows from which that median is estimated; chosen: thousands of pixels are left."""
MAX_SHARE: Final = 0.01
"""Of the pixels that may be hot, and of the columns that may be dead; chosen: a background of which more stand out has
structure of another kind."""
DEAD_PERCENT: Final = 90.0
"""Percentage of a dead column that is darker, or brighter, than what is around it; chosen: rows of a lattice of cores
change sides along a column."""
MEDIAN_PX: Final = 5
"""Side of the square whose median a dead column is compared with; derived: of two columns side by side it is that of
the others."""


class HotPixels:
    """Hot pixels and dead columns of one camera region.

    Parameters
    ----------
    background : numpy.ndarray or None
        (rows, cols) mean frame of the dark tube, grey levels.

    Attributes
    ----------
    rows, cols : numpy.ndarray
        Positions of the hot pixels in the frame.
    dead_columns : numpy.ndarray
        Columns that differ along their length from those around in the dark.
    """

    def __init__(self, background: NDArray[np.float32] | None) -> None:
        none = np.zeros(0, np.intp)
        self.rows, self.cols = (none, none) if background is None else _stand_out(background)
        self.dead_columns = none if background is None else _dead_columns(background)
        alive = np.delete(np.arange(0 if background is None else background.shape[1]), self.dead_columns)
        after = np.searchsorted(alive, self.dead_columns)
        self._beside = [alive[np.clip(at, 0, len(alive) - 1)] if len(alive) else none for at in (after - 1, after)]
        self._neighbours = np.delete(_square(1), 4, axis=1)

    def __len__(self) -> int:
        """Return the number of hot pixels."""
        return len(self.rows)

    def mended(self, raw: NDArray[Pixel]) -> NDArray[Pixel]:
        """Return a copy of a raw frame with hot pixels and dead columns replaced; without any, the frame itself.

        Parameters
        ----------
        raw : numpy.ndarray
            (rows, cols) grey levels.
        """
        if not len(self) and not len(self.dead_columns):
            return raw
        mended = np.array(raw)
        around = _around(raw, self.rows, self.cols, self._neighbours)
        mended[self.rows, self.cols] = np.median(around, axis=0).astype(raw.dtype)
        mended[:, self.dead_columns] = np.mean([mended[:, beside] for beside in self._beside], axis=0)
        return mended


def _stand_out(background: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of the pixels of a background that stand out of their neighbours."""
    frame, ring = np.asarray(background, np.float32), np.ones((3, 3), np.uint8)
    ring[1, 1] = 0
    excess = cv2.dilate(frame, ring)
    np.subtract(frame, excess, out=excess)
    some, place = excess[::SAMPLED], np.flatnonzero(excess > MIN_EXCESS)
    height = excess.ravel()[place]
    if len(place):
        kept = height > EXCESS * float(np.median(some[some > 0]))
        place, height = place[kept], height[kept]
    rows, cols = np.divmod(place, frame.shape[1])
    lowest = _around(frame, rows, cols, _square(2)).min(axis=0)
    hot = height > PATTERN * (frame[rows, cols] - height - lowest)
    hot &= np.count_nonzero(hot) <= MAX_SHARE * frame.size
    return rows[hot], cols[hot]


def _dead_columns(background: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the columns of a background that differ along their length from those around; none at its sides."""
    some = np.asarray(background[::SAMPLED], np.float32)
    least, most = np.percentile(some - cv2.medianBlur(some, MEDIAN_PX), (100 - DEAD_PERCENT, DEAD_PERCENT), axis=0)
    dead: NDArray[np.intp] = np.flatnonzero((most < -MIN_EXCESS) | (least > MIN_EXCESS))
    return dead if len(dead) <= MAX_SHARE * len(most) else dead[:0]


def _square(reach: int) -> NDArray[np.intp]:
    """Return the rows and columns of the pixels around one, up to a distance of `reach`, (2, n)."""
    return np.indices((2 * reach + 1, 2 * reach + 1)).reshape(2, -1) - reach


def _around(
    frame: NDArray[Any], rows: NDArray[np.intp], cols: NDArray[np.intp], offsets: NDArray[np.intp]
) -> NDArray[Any]:
    """Return the pixels at offsets (2, n) from each of some, the frame's edge repeated beyond it, (n, some)."""
    row, col = (
        np.clip(at + by[:, None], 0, size - 1) for at, by, size in zip((rows, cols), offsets, frame.shape, strict=True)
    )
    around: NDArray[Any] = frame[row, col]
    return around
