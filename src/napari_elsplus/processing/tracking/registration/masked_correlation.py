"""Zero-mean normalised correlation of two images under a mask, at every shift at once, by Fourier transform.

References
----------
Padfield, IEEE Trans. Image Process. 21, 2706 (2012), doi:10.1109/TIP.2011.2181402.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


class CoarseImage(NamedTuple):
    """What a correlation needs of an image, computed once for all images that it is compared with.

    Parameters
    ----------
    spectrum : numpy.ndarray
        (size, size) float32 spectrum of the image, packed as OpenCV does.
    scale : numpy.ndarray
        (size, size) float32: over its overlap with the mask at each shift, the reciprocal root of the sum of squared
        deviations from the mean; 0 where the overlap is too small, or even.
    mean : numpy.ndarray
        (size, size) float32: the mean there, times the root of the number of pixels, times `scale`.
    """

    spectrum: NDArray[np.float32]
    scale: NDArray[np.float32]
    mean: NDArray[np.float32]


class MaskedCorrelation:
    """Correlates images under one mask; what depends on the mask alone is kept.

    Parameters
    ----------
    mask : numpy.ndarray
        (n, n) float32, 1 where images are compared, 0 elsewhere.
    min_overlap : float
        Smallest overlap that is searched, as a fraction of the mask.
    high_pass_px : float
        Standard deviation of the Gaussian of :meth:`high_passed`, pixels.

    Attributes
    ----------
    overlap : numpy.ndarray
        (size, size) pixels of the overlap at each shift.
    searched : numpy.ndarray
        (size, size) bool: it is large enough.
    lags : numpy.ndarray
        (size,) shift at each index, pixels.
    """

    def __init__(self, mask: NDArray[np.float32], min_overlap: float, high_pass_px: float) -> None:
        self._mask, self._high_pass_px = mask, high_pass_px
        self._weight = np.maximum(cv2.GaussianBlur(mask, (0, 0), high_pass_px), np.float32(1e-3))
        self._size = cv2.getOptimalDFTSize(2 * len(mask))
        self.mask_spectrum = self.spectrum(mask)
        self.overlap = np.maximum(self.correlate(self.mask_spectrum, self.mask_spectrum), np.float32(1e-3))
        self.searched = self.overlap > min_overlap * self.overlap[0, 0]
        self.lags = np.fft.fftfreq(self._size, 1 / self._size)
        self._root_cells: NDArray[np.float32] = np.sqrt(np.maximum(self.overlap, 1.0))

    def high_passed(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return an image (n, n) within the mask, less its mean about each pixel, weighted by a Gaussian."""
        inside = image * self._mask
        inside -= self._mask * cv2.GaussianBlur(inside, (0, 0), self._high_pass_px) / self._weight
        return inside

    def prepare(self, inside: NDArray[np.float32]) -> CoarseImage:
        """Return what :meth:`coefficients` needs of an image (n, n) that is zero outside of the mask."""
        spectrum = self.spectrum(inside)
        sums = self.correlate(self.mask_spectrum, spectrum) / self._root_cells
        squares = self.correlate(self.mask_spectrum, self.spectrum(inside * inside))
        squares -= sums * sums
        np.copyto(squares, np.inf, where=~self.searched | (squares <= 0))
        scale = np.reciprocal(np.sqrt(squares), dtype=np.float32)
        return CoarseImage(spectrum, scale, sums * scale)

    def coefficients(self, earlier: CoarseImage, later: CoarseImage) -> NDArray[np.float32]:
        """Return the correlation coefficient (size, size) at each shift; 0 where the overlap is too small, or even.

        Parameters
        ----------
        earlier, later : CoarseImage
            From :meth:`prepare`.
        """
        product = self.correlate(earlier.spectrum, later.spectrum)
        return product * opposite(earlier.scale) * later.scale - opposite(earlier.mean) * later.mean

    def spectrum(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the spectrum (size, size) of an image (n, n), packed as OpenCV does."""
        padded = np.zeros((self._size, self._size), np.float32)
        padded[: len(image), : len(image)] = image
        return np.asarray(cv2.dft(padded, dst=padded), np.float32)

    def correlate(self, template: NDArray[np.float32], image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return sums (size, size) of the products of two images at each shift.

        Parameters
        ----------
        template, image : numpy.ndarray
            (size, size) float32 spectra of both: the image is shifted against the template.
        """
        product = cv2.mulSpectrums(image, template, 0, conjB=True)
        return np.asarray(cv2.idft(product, dst=product, flags=cv2.DFT_REAL_OUTPUT | cv2.DFT_SCALE), np.float32)


def opposite(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return values at the opposite shifts: the earlier image is shifted by these against the later one."""
    return np.roll(values[::-1, ::-1], 1, axis=(0, 1))
