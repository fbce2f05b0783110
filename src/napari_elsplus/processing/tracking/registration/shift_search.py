"""Search of the shift between two frames among all of them, from which registration begins.

At a quarter of the resolution a peak may be lower than it is, the more so the finer a periodic structure is. Where
others are like the highest one, half resolution gives all that may be the highest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.processing.tracking.front_end.grid import lit_pixels
from napari_elsplus.processing.tracking.registration.masked_correlation import MAX_CORRELATION, MaskedCorrelation
from napari_elsplus.processing.tracking.registration.pyramid import LEVELS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior
    from napari_elsplus.processing.tracking.motion.rolling_shutter import Warp
    from napari_elsplus.processing.tracking.registration.masked_correlation import CoarseImage

    Images = tuple[NDArray[np.float32], ...]

_NATS_PER_PX: Final = 0.05 / 16
"""Weight of a pixel of full resolution: its part of an independent value, over two."""
MAX_PEAKS: Final = 64
"""Largest number of like peaks that are registered: those of a grid of 25 um; chosen, it bounds the cost. Where there
are more at both resolutions, no shift is accepted: the true one may not be among those that are compared."""
LIKE: Final = 0.3
"""Part of the highest peak, nats, from which another one may be as high at full resolution; chosen: without periodic
structure others have a tenth."""
_HIDDEN: Final = 0.1
"""Part of a peak's nats that the nearest of the shifts searched has at least; derived: half a step of 4 px beside it in
both directions, a sine of 13 px has a third of its correlation."""
LIKE_AT_HALF: Final = 0.6
"""The same at half resolution."""
_NEIGHBOURS: Final = np.ones((3, 3), np.uint8)


class EveryShift:
    """Finds where registration of two frames is to begin.

    Parameters
    ----------
    grid : Grid
        Of the frames.
    """

    def __init__(self, grid: Grid) -> None:
        self._grid, self._quarter = grid, ShiftSearch(grid, LEVELS - 1)
        self._half: ShiftSearch | None = None

    def of_frame(self, levels: Images) -> CoarseImage:
        """Return what the search needs of a frame's `levels`, half and quarter high-passed."""
        return self._quarter.prepare(levels[LEVELS - 1])

    def starts(
        self, earlier: CoarseImage, later: CoarseImage, levels: tuple[Images, Images], motion: MotionPrior
    ) -> list[Warp]:
        """Return the expected warp at the most likely shift; then at others that may be as likely, few or none.

        Parameters
        ----------
        earlier, later : CoarseImage
            Both frames, from :meth:`of_frame`.
        levels : tuple
            The levels of both.
        motion : MotionPrior
            Prior of the motion between them.
        """
        shifts = self._quarter.peaks(earlier, later, motion, LIKE)
        if len(shifts) > 1:
            self._half = half = self._half or ShiftSearch(self._grid, 1)
            shifts += half.peaks(half.prepare(levels[0][1]), half.prepare(levels[1][1]), motion, LIKE_AT_HALF)
        return [motion.at(*shift) for shift in shifts]


class ShiftSearch(MaskedCorrelation):
    """Finds the most likely shift between two discs by their correlation and the motion prior.

    Parameters
    ----------
    grid : Grid
        Of the frames.
    level : int
        Of their pyramids, at which they are compared.
    """

    def __init__(self, grid: Grid, level: int) -> None:
        super().__init__(lit_pixels(*grid.binned(2**level).spans()).astype(np.float32))
        self._shifts = (self.lags * 2**level).astype(np.float32)
        self._nats_per_cell = _NATS_PER_PX * 4**level

    def peaks(
        self, earlier: CoarseImage, later: CoarseImage, motion: MotionPrior, share: float
    ) -> list[tuple[float, float]]:
        """Return the most likely shift (b, d), and those whose peaks are like it, in pixels of full resolution.

        Parameters
        ----------
        earlier, later : CoarseImage
            Both frames, prepared.
        motion : MotionPrior
            Prior of the motion between them.
        share : float
            Part of the highest peak, nats, from which another one is like it.
        """
        alike = self.coefficients(earlier.as_template, later)
        prior = motion.log_density(self._shifts[:, None], self._shifts)
        score = prior + self._nats(alike, self.overlap)
        best = int(np.argmax(score))
        highest_near = cv2.dilate(cv2.copyMakeBorder(score, 1, 1, 1, 1, cv2.BORDER_WRAP), _NEIGHBOURS)[1:-1, 1:-1]
        high = score > _HIDDEN * share * max(score.flat[best], 0)
        cells = np.append(best, np.flatnonzero((score >= highest_near) & high))
        rows, cols = np.unravel_index(cells, score.shape)
        middle = alike[rows, cols]
        between = middle.copy()
        for row, col in ((1, 0), (0, 1)):  # between the shifts that were searched, by parabolas
            left, right = alike[rows - row, cols - col], alike[(rows + row) % len(score), (cols + col) % len(score)]
            bend = np.maximum(2 * middle - left - right, np.float32(1e-6))
            between += np.where((middle >= left) & (middle >= right), (right - left) ** 2 / (8 * bend), 0)
        nats = prior[rows, cols] + self._nats(between, self.overlap[rows, cols])
        like = np.flatnonzero((nats > share * nats[0]) & (cells != best))
        found = [0, *like[np.argsort(-nats[like])][:MAX_PEAKS].tolist()]
        return list(zip(self._shifts[rows[found]].tolist(), self._shifts[cols[found]].tolist(), strict=True))

    def _nats(self, alike: NDArray[np.float32], overlap: NDArray[np.float32]) -> NDArray[np.float32]:
        nats: NDArray[np.float32] = -self._nats_per_cell * overlap * np.log(1 - np.clip(alike, 0, MAX_CORRELATION) ** 2)
        return nats
