"""Search over every shift between two discs: the most likely ones, by masked correlation and a heavy-tailed prior."""

from __future__ import annotations

from math import log, log1p
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import compilable, lean_kernel
from napari_elsplus.processing.tracking.front_end.grid import lit_pixels
from napari_elsplus.processing.tracking.registration.masked_correlation import CoarseImage, MaskedCorrelation

if TYPE_CHECKING:
    from numpy.typing import NDArray

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
        self._shifts = self._correlation.lags * scale
        self._score = np.zeros_like(self._correlation.overlap)
        self._peaks = np.zeros((CANDIDATES, 3))

    def prepare(self, image: NDArray[np.float32]) -> CoarseImage:
        """Return what the search needs of a coarse image (n, n)."""
        return self._correlation.prepare(self._correlation.high_passed(image))

    def peaks(self, earlier: CoarseImage, later: CoarseImage, expected: Warp, reach_px: float) -> NDArray[np.float64]:
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
        correlation = self._correlation.correlate(earlier.spectrum, later.spectrum)
        score_shifts(
            correlation, *earlier[1:], *later[1:], self._correlation.overlap, self._shifts, expected.b, expected.d,
            reach_px, self._score,
        )  # fmt: skip
        found = highest_peaks(self._score, self._peaks)
        return self._shifts[self._peaks[:found, 1:].astype(np.intp)]


@lean_kernel
def score_shifts(
    correlation: NDArray[np.float32],
    earlier_scale: NDArray[np.float32],
    earlier_mean: NDArray[np.float32],
    later_scale: NDArray[np.float32],
    later_mean: NDArray[np.float32],
    cells: NDArray[np.float32],
    shifts: NDArray[np.float64],
    expected_row: float,
    expected_col: float,
    reach_px: float,
    score: NDArray[np.float32],
) -> None:
    """Fill the log posterior probability of every shift, up to a constant, nats; minus infinity where nothing is alike.

    Parameters
    ----------
    correlation : numpy.ndarray
        (n, n) sums of products of both frames at each shift.
    earlier_scale, earlier_mean, later_scale, later_mean : numpy.ndarray
        (n, n) of each frame's :class:`CoarseImage`.
    cells : numpy.ndarray
        (n, n) pixels of the overlap.
    shifts : numpy.ndarray
        (n,) shift at each index, pixels of full resolution.
    expected_row, expected_col, reach_px : float
        Centre and scale of the prior, pixels of full resolution.
    score : numpy.ndarray
        (n, n) float32, filled.
    """
    size = len(score)
    for i in range(size):
        for j in range(size):
            back, aside = (size - i) % size, (size - j) % size  # the earlier frame is shifted against the later one
            alike = correlation[i, j] * earlier_scale[back, aside] * later_scale[i, j]
            alike -= earlier_mean[back, aside] * later_mean[i, j]
            score[i, j] = -np.inf
            if alike > 0:
                alike = min(alike, _MAX_CORRELATION)
                like = -_NATS_PER_CELL * cells[i, j] * log(1 - alike * alike)
                score[i, j] = like + prior(shifts[i] - expected_row, shifts[j] - expected_col, reach_px)


@lean_kernel
def highest_peaks(score: NDArray[np.float32], peaks: NDArray[np.float64]) -> int:
    """Fill the highest local maxima of a periodic image, best first, and return how many there are.

    Parameters
    ----------
    score : numpy.ndarray
        (n, n) float32.
    peaks : numpy.ndarray
        (m, 3) float64, filled: height, row and column.
    """
    size, found = len(score), 0
    for i in range(size):
        for j in range(size):
            height = score[i, j]
            if height == -np.inf or (found == len(peaks) and height <= peaks[found - 1, 0]):
                continue
            highest = height
            for m in range(i - 1, i + 2):
                for n in range(j - 1, j + 2):
                    highest = max(highest, score[m % size, n % size])
            if highest > height:
                continue
            found = min(found + 1, len(peaks))
            at = found - 1
            while at > 0 and peaks[at - 1, 0] < height:
                for k in range(3):
                    peaks[at, k] = peaks[at - 1, k]
                at -= 1
            peaks[at, 0], peaks[at, 1], peaks[at, 2] = height, i, j
    return found


@compilable
def prior(rows: float, cols: float, reach_px: float) -> float:
    """Return the log-probability of a shift that misses what was expected by so much, nats; hands jerk: heavy tails.

    Parameters
    ----------
    rows, cols : float
        Distance of the shift from the predicted one, pixels.
    reach_px : float
        Scale of the prior, pixels.
    """
    return -1.5 * log1p((rows * rows + cols * cols) / (reach_px * reach_px))
