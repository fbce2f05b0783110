"""Every shift between two discs at once: zero-mean masked correlation by Fourier transform.

References
----------
Padfield, IEEE Trans. Image Process. 21, 2706 (2012), doi:10.1109/TIP.2011.2181402.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

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
        self._scale = scale
        self._mask = lit_pixels(first, last).astype(np.float32)
        self._size = cv2.getOptimalDFTSize(2 * side)
        self._mask_spectrum = fft.rfft2(self._mask, (self._size, self._size))
        self._overlap = self._correlate(self._mask_spectrum, self._mask_spectrum)
        self._local_weight = np.maximum(cv2.GaussianBlur(self._mask, (0, 0), _HIGH_PASS_CELLS), 1e-3)

    def spectra(self, image: NDArray[np.float32]) -> NDArray[np.complex64]:
        """Spectra of a coarse image (n, n), high-passed within the disc, and of its square."""
        inside = image * self._mask
        inside -= self._mask * cv2.GaussianBlur(inside, (0, 0), _HIGH_PASS_CELLS) / self._local_weight
        both: NDArray[np.complex64] = fft.rfft2(np.stack([inside, inside * inside]), (self._size, self._size))
        return both

    def peaks(
        self, earlier: NDArray[np.complex64], later: NDArray[np.complex64], expected: Warp, reach_px: float
    ) -> NDArray[np.float64]:
        """Return the most likely shifts (b, d), in pixels of full resolution, best first.

        Parameters
        ----------
        earlier, later : numpy.ndarray
            Spectra of both frames.
        expected : Warp
            Centre of a heavy-tailed prior.
        reach_px : float
            Scale of that prior in pixels of full resolution.
        """
        (t, tt), (i, ii), m = earlier, later, self._mask_spectrum
        n = np.maximum(self._overlap, 1.0)
        st, si = self._correlate(t, m), self._correlate(m, i)
        var_t = self._correlate(tt, m) - st * st / n
        var_i = self._correlate(m, ii) - si * si / n
        both = self._correlate(t, i) - st * si / n
        enough = (self._overlap > LEAST_OVERLAP * self._overlap[0, 0]) & (var_t > 0) & (var_i > 0)
        ncc = np.where(enough, both / np.sqrt(np.where(enough, var_t * var_i, 1.0)), 0.0)
        shifts = fft.fftfreq(self._size, 1 / self._size) * self._scale
        score = support(ncc, n) + prior(shifts[:, None] - expected.b, shifts - expected.d, reach_px)
        score[~enough] = -np.inf
        neighbours = cv2.dilate(np.pad(score, 1, mode="wrap"), np.ones((3, 3), np.uint8))[1:-1, 1:-1]
        peaks = np.argwhere((score >= neighbours) & np.isfinite(score) & (ncc > 0))
        order = np.argsort(-score[tuple(peaks.T)])[:CANDIDATES]
        best: NDArray[np.float64] = shifts[peaks[order]]
        return best

    def _correlate(self, template: NDArray[np.complex64], image: NDArray[np.complex64]) -> NDArray[np.float32]:
        result: NDArray[np.float32] = fft.irfft2(np.conj(template) * image, (self._size, self._size))
        return result


def support(ncc: NDArray[np.float64], cells: NDArray[np.float64]) -> NDArray[np.float64]:
    """Log-likelihood of a shift, from its correlation over so many cells of quarter resolution.

    Parameters
    ----------
    ncc : numpy.ndarray
        Correlation at each shift.
    cells : numpy.ndarray
        Pixels of the overlap there.
    """
    result: NDArray[np.float64] = -0.05 * cells * np.log1p(-(np.clip(ncc, 0, 0.999) ** 2))
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
