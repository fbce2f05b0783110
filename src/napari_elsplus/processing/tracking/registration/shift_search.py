"""Every shift between two discs at once: zero-mean masked correlation by Fourier transform.

References
----------
Padfield, IEEE Trans. Image Process. 21, 2706 (2012), doi:10.1109/TIP.2011.2181402.
"""

from __future__ import annotations

from math import log, log1p
from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np

from napari_elsplus.processing.compiled import compilable, lean_kernel
from napari_elsplus.processing.tracking.front_end.grid import lit_pixels

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


class CoarseImage(NamedTuple):
    """What the search needs of a frame, computed once for all frames that it is registered with.

    Parameters
    ----------
    spectrum : numpy.ndarray
        (size, size) float32 spectrum of the coarse image, high-passed within the disc, packed as OpenCV does.
    scale : numpy.ndarray
        (size, size) float32: over its overlap with a disc at each shift, the reciprocal root of the sum of squared
        deviations from the mean; 0 where the overlap is too small, or even.
    mean : numpy.ndarray
        (size, size) float32: the mean there, times the root of the number of pixels, times `scale`.
    """

    spectrum: NDArray[np.float32]
    scale: NDArray[np.float32]
    mean: NDArray[np.float32]


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
        side = len(first)
        self._mask = lit_pixels(first, last).astype(np.float32)
        self._size = cv2.getOptimalDFTSize(2 * side)
        self._mask_spectrum = self._spectrum(self._mask)
        self._overlap = self._correlate(self._mask_spectrum, self._mask_spectrum)
        self._overlaps = self._overlap > LEAST_OVERLAP * self._overlap[0, 0]
        self._root_cells: NDArray[np.float32] = np.sqrt(np.maximum(self._overlap, 1.0))
        self._shifts = np.fft.fftfreq(self._size, 1 / self._size) * scale
        self._score = np.zeros_like(self._overlap)
        self._peaks = np.zeros((CANDIDATES, 3))
        self._local_weight = np.maximum(cv2.GaussianBlur(self._mask, (0, 0), _HIGH_PASS_CELLS), 1e-3)

    def prepare(self, image: NDArray[np.float32]) -> CoarseImage:
        """Return what the search needs of a coarse image (n, n)."""
        inside = image * self._mask
        inside -= self._mask * cv2.GaussianBlur(inside, (0, 0), _HIGH_PASS_CELLS) / self._local_weight
        spectrum = self._spectrum(inside)
        sums = self._correlate(self._mask_spectrum, spectrum) / self._root_cells
        squares = self._correlate(self._mask_spectrum, self._spectrum(inside * inside))
        squares -= sums * sums
        squares[~self._overlaps | (squares <= 0)] = np.inf
        scale = np.reciprocal(np.sqrt(squares), dtype=np.float32)
        return CoarseImage(spectrum, scale, sums * scale)

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
        correlation = self._correlate(earlier.spectrum, later.spectrum)
        score_shifts(
            correlation, *earlier[1:], *later[1:], self._overlap, self._shifts, expected.b, expected.d, reach_px,
            self._score,
        )  # fmt: skip
        found = highest_peaks(self._score, self._peaks)
        return self._shifts[self._peaks[:found, 1:].astype(np.intp)]

    def _spectrum(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        padded = np.zeros((self._size, self._size), np.float32)
        padded[: len(image), : len(image)] = image
        return np.asarray(cv2.dft(padded, dst=padded, nonzeroRows=len(image)), np.float32)

    def _correlate(self, template: NDArray[np.float32], image: NDArray[np.float32]) -> NDArray[np.float32]:
        product = cv2.mulSpectrums(image, template, 0, conjB=True)
        return np.asarray(cv2.idft(product, dst=product, flags=cv2.DFT_REAL_OUTPUT | cv2.DFT_SCALE), np.float32)


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
