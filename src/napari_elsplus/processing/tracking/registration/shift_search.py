"""Search over every shift between two discs: the most likely ones, by masked correlation and a heavy-tailed prior."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.processing.tracking.front_end.grid import lit_pixels
from napari_elsplus.processing.tracking.registration.masked_correlation import CoarseImage, MaskedCorrelation

if TYPE_CHECKING:
    from typing import Any, TypeVar

    from numpy.typing import NDArray

    Distance = TypeVar("Distance", float, NDArray[np.floating[Any]])

    from napari_elsplus.processing.tracking.motion.rolling_shutter import Warp

CANDIDATES: Final = 6
LEAST_OVERLAP: Final = 0.15
"""Part of the disc that two frames must share."""
_HIGH_PASS_CELLS: Final = 4.0
_NATS_PER_CELL: Final = 0.05
"""Weight of a cell of quarter resolution: its part of an independent value, over two."""
_MAX_CORRELATION: Final = 0.999


class ShiftSearch:
    """Finds the few most likely shifts; what depends on the disc alone is kept.

    Parameters
    ----------
    first, last : numpy.ndarray
        (n,) int32: lit columns of each row of the coarse images.
    scale : float
        Pixels of full resolution per coarse one.
    """

    def __init__(self, first: NDArray[np.int32], last: NDArray[np.int32], scale: float) -> None:
        self._correlation = MaskedCorrelation(
            lit_pixels(first, last).astype(np.float32), LEAST_OVERLAP, _HIGH_PASS_CELLS
        )
        self._shifts = (self._correlation.lags * scale).astype(np.float32)

    def prepare(self, image: NDArray[np.float32]) -> CoarseImage:
        """Return what the search needs of a coarse image (n, n)."""
        return self._correlation.prepare(self._correlation.high_passed(image))

    def peaks(self, earlier: CoarseImage, later: CoarseImage, expected: Warp, reach_px: float) -> NDArray[np.float32]:
        """Return the most likely shifts (b, d), in pixels of full resolution, best first.

        Parameters
        ----------
        earlier, later : CoarseImage
            Both frames, prepared.
        expected : Warp
            Centre of a heavy-tailed prior.
        reach_px : float
            Scale of that prior in pixels of full resolution.
        """
        alike = np.clip(self._correlation.coefficients(earlier, later), 0.0, _MAX_CORRELATION)
        before = prior(self._shifts[:, None] - expected.b, self._shifts - expected.d, reach_px)
        score = before - _NATS_PER_CELL * self._correlation.overlap * np.log(1 - alike * alike)
        np.copyto(score, -np.inf, where=alike == 0)
        around = cv2.dilate(cv2.copyMakeBorder(score, 1, 1, 1, 1, cv2.BORDER_WRAP), None)[1:-1, 1:-1]
        highest = np.flatnonzero((score == around) & (alike > 0))
        best = highest[np.argsort(-score.ravel()[highest])[:CANDIDATES]]
        return self._shifts[np.stack(np.unravel_index(best, score.shape), axis=1)]


def prior(rows: Distance, cols: Distance, reach_px: float) -> Distance:
    """Return the log-probability of a shift that misses what was expected by so much, nats; hands jerk: heavy tails.

    Parameters
    ----------
    rows, cols : float or numpy.ndarray
        Distance of the shift from the predicted one, pixels.
    reach_px : float
        Scale of the prior, pixels.
    """
    log_probability: Distance = -1.5 * np.log(1 + (rows * rows + cols * cols) / (reach_px * reach_px))
    return log_probability
