"""Normalised correlation of two high-passed images under a mask, at every shift at once, by Fourier transform.

Of raw frames it finds the most likely shifts, which are then registered (``shift_search``); of finished images it gives
the odds of one, and of thumbnails it finds those that show the same place.

References
----------
Padfield, IEEE Trans. Image Process. 21, 2706 (2012), doi:10.1109/TIP.2011.2181402.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_CORRELATION: Final = 0.999
"""Largest correlation that is counted; chosen, against the logarithm of zero."""


class CoarseImage(NamedTuple):
    """What a correlation needs of an image, computed once for all images that it is compared with.

    Parameters
    ----------
    spectrum : numpy.ndarray
        (size, size) float32 spectrum of the image, packed as OpenCV does.
    scale : numpy.ndarray
        (size, size) float32: over its overlap with the mask at each shift, the reciprocal root of the sum of squares;
        0 where the overlap is too small, or empty.
    """

    spectrum: NDArray[np.float32]
    scale: NDArray[np.float32]

    @property
    def as_template(self) -> CoarseImage:
        """The same by the shift of other images against this one."""
        return self._replace(scale=opposite(self.scale))


class MaskedCorrelation:
    """Correlates images under one mask; what depends on the mask alone is kept.

    Parameters
    ----------
    mask : numpy.ndarray
        (n, n) float32, 1 where images are compared, 0 elsewhere.
    min_overlap : float
        Smallest overlap that is searched, as a fraction of the mask.
    reach : int, optional
        Largest shift that leaves such an overlap, pixels; that of images side by side by default.

    Attributes
    ----------
    overlap : numpy.ndarray
        (size, size) pixels of the overlap at each shift.
    searched : numpy.ndarray
        (size, size) bool: it is large enough.
    lags : numpy.ndarray
        (size,) shift at each index, pixels.
    """

    def __init__(self, mask: NDArray[np.float32], min_overlap: float = 0.0, reach: int | None = None) -> None:
        self._mask = mask
        self._size = cv2.getOptimalDFTSize(len(mask) + (len(mask) if reach is None else reach))
        self.mask_spectrum = self.spectrum(mask)
        self.overlap = np.maximum(self.correlate(self.mask_spectrum, self.mask_spectrum), np.float32(1e-3))
        self.searched = self.overlap > min_overlap * self.overlap[0, 0]
        self.lags = np.fft.fftfreq(self._size, 1 / self._size)

    def prepare(self, image: NDArray[np.float32]) -> CoarseImage:
        """Return what :meth:`coefficients` needs of an image (n, n) without what is smooth in it."""
        inside = image * self._mask
        squares = self.correlate(self.mask_spectrum, self.spectrum(inside * inside))
        np.copyto(squares, np.inf, where=~self.searched | (squares <= 0))
        return CoarseImage(self.spectrum(inside), np.reciprocal(np.sqrt(squares), dtype=np.float32))

    def coefficients(self, template: CoarseImage, image: CoarseImage) -> NDArray[np.float32]:
        """Return the correlation coefficient (size, size) at each shift; 0 where the overlap is too small, or empty.

        Parameters
        ----------
        template, image : CoarseImage
            From :attr:`CoarseImage.as_template` and :meth:`prepare`: the image is shifted against the template.
        """
        product = self.correlate(template.spectrum, image.spectrum)
        return product * template.scale * image.scale

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


def high_passed(image: NDArray[np.float32], mask: NDArray[np.float32], px: float) -> NDArray[np.float32]:
    """Return an image within a mask, less its mean about each pixel, weighted by a Gaussian.

    Parameters
    ----------
    image, mask : numpy.ndarray
        (n, n) float32; the mask is 0 or 1.
    px : float
        Standard deviation of the Gaussian, pixels.
    """
    inside, share = image * mask, np.maximum(cv2.GaussianBlur(mask, (0, 0), px), np.float32(1e-3))
    result: NDArray[np.float32] = inside - mask * cv2.GaussianBlur(inside, (0, 0), px) / share
    return result


def opposite(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return values at the opposite shifts: the earlier image is shifted by these against the later one."""
    return np.roll(values[::-1, ::-1], 1, axis=(0, 1))
