"""Every shift between two discs at once: zero-mean masked correlation by Fourier transform.

References
----------
Padfield, IEEE Trans. Image Process. 21, 2706 (2012), doi:10.1109/TIP.2011.2181402.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np
from scipy import fft

from napari_elsplus.processing.tracking.front_end.grid import lit_pixels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.rolling_shutter import Warp

CANDIDATES: Final = 6
LEAST_OVERLAP: Final = 0.15
"""Part of the disc that two frames must share."""
_HIGH_PASS_CELLS: Final = 4.0
_NEIGHBOURS: Final = np.ones((3, 3), np.uint8)


class CoarseImage(NamedTuple):
    """What the search needs of a frame, computed once for all frames that it is registered with.

    Parameters
    ----------
    spectrum : numpy.ndarray
        (size, size / 2 + 1) complex64 spectrum of the coarse image, high-passed within the disc.
    scale : numpy.ndarray
        (size, size) float32: over its overlap with a disc at each shift, the reciprocal root of the sum of squared
        deviations from the mean; 0 where the overlap is too small, or even.
    mean : numpy.ndarray
        (size, size) float32: the mean there, times the root of the number of pixels, times `scale`.
    """

    spectrum: NDArray[np.complex64]
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
        self._mask_spectrum = fft.rfft2(self._mask, (self._size, self._size))
        self._overlap = self._correlate(self._mask_spectrum, self._mask_spectrum)
        self._overlaps = self._overlap > LEAST_OVERLAP * self._overlap[0, 0]
        self._root_cells = np.sqrt(np.maximum(self._overlap, 1.0))
        self._shifts = (fft.fftfreq(self._size, 1 / self._size) * scale).astype(np.float32)
        self._local_weight = np.maximum(cv2.GaussianBlur(self._mask, (0, 0), _HIGH_PASS_CELLS), 1e-3)

    def prepare(self, image: NDArray[np.float32]) -> CoarseImage:
        """Return what the search needs of a coarse image (n, n)."""
        inside = image * self._mask
        inside -= self._mask * cv2.GaussianBlur(inside, (0, 0), _HIGH_PASS_CELLS) / self._local_weight
        spectra = fft.rfft2(np.stack([inside, inside * inside]), (self._size, self._size))
        sums, squares = self._correlate(self._mask_spectrum, spectra)
        sums /= self._root_cells
        squares -= sums * sums
        squares[~self._overlaps | (squares <= 0)] = np.inf
        scale = 1 / np.sqrt(squares)
        return CoarseImage(spectra[0], scale, sums * scale)

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
        ncc = self._correlate(earlier.spectrum, later.spectrum) * _reversed(earlier.scale)
        ncc *= later.scale
        ncc -= _reversed(earlier.mean) * later.mean
        score = support(ncc, self._overlap)
        score += prior(self._shifts[:, None] - np.float32(expected.b), self._shifts - np.float32(expected.d), reach_px)
        score[ncc <= 0] = -np.inf
        wrapped = cv2.copyMakeBorder(score, 1, 1, 1, 1, cv2.BORDER_WRAP)
        peaks = np.argwhere((score >= cv2.dilate(wrapped, _NEIGHBOURS)[1:-1, 1:-1]) & (ncc > 0))
        order = np.argsort(-score[tuple(peaks.T)])[:CANDIDATES]
        best: NDArray[np.float64] = self._shifts[peaks[order]].astype(np.float64)
        return best

    def _correlate(self, template: NDArray[np.complex64], image: NDArray[np.complex64]) -> NDArray[np.float32]:
        result: NDArray[np.float32] = fft.irfft2(np.conj(template) * image, (self._size, self._size))
        return result


def _reversed(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return what lies at the opposite shifts: the earlier frame is shifted by these against the later one."""
    return np.roll(image[::-1, ::-1], 1, axis=(0, 1))


def support(ncc: NDArray[np.float32], cells: NDArray[np.float32]) -> NDArray[np.float32]:
    """Log-likelihood of a shift, from its correlation over so many cells of quarter resolution.

    Parameters
    ----------
    ncc : numpy.ndarray
        Correlation at each shift.
    cells : numpy.ndarray
        Pixels of the overlap there.
    """
    like = np.clip(ncc, 0, 0.999)
    result: NDArray[np.float32] = np.float32(-0.05) * cells * np.log(1 - like * like)
    return result


def prior(rows: NDArray[np.float64], cols: NDArray[np.float64], reach_px: float) -> NDArray[np.float64]:
    """Log-probability of a shift that misses what was expected by so much; hands jerk, so its tails are heavy.

    Parameters
    ----------
    rows, cols : numpy.ndarray
        Distance of each shift from the predicted one, pixels.
    reach_px : float
        Scale of the prior, pixels.
    """
    result: NDArray[np.float64] = -1.5 * np.log1p((rows**2 + cols**2) / reach_px**2)
    return result
