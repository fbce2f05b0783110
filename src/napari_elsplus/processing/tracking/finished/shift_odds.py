"""Log posterior odds of the best shift between two images against all others and against none, in nats of the frame.

For finished images, whose texture may be soft and whose noise is unknown. The likelihood of a shift follows from the
zero-mean normalised correlation r of the overlap: with n independent values, n / 2 ln(1 / (1 - r^2)) nats above that of
unrelated images. The number n is estimated from the images: the variance of r between unrelated ones is the sum over
all lags of the product of both autocorrelations over the number of pixels (Bartlett 1935,
doi:10.1111/j.2397-2335.1935.tb04253.x), and larger where bright structure of one meets that of the other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np
from scipy import fft

if TYPE_CHECKING:
    from numpy.typing import NDArray

MIN_ODDS_NATS: Final = 16.0
"""Log posterior odds from which a shift is accepted: one wrong shift in ten million if the noise model held. Unrelated
pairs reach 0 nats in a real video and 3 in synthetic soft tissue; the rest is a margin, set on that video between what
two other methods see (18 and more) and what they do not (``docs/mosaicing.md``)."""
MIN_OVERLAP: Final = 0.25
"""Smallest overlap that is searched, as a fraction of the mask; chosen: below it n is too small for the odds above."""
_HIGH_PASS_DIAMETERS: Final = 1 / 24
"""Standard deviation of the high-pass in diameters of the mask; chosen, 1/16 leaves fewer independent values."""
_VARIANCE_DIAMETERS: Final = 1 / 32
"""Standard deviation over which the local variance is averaged; chosen, about a correlation length of soft tissue."""
_SMOOTHING_CELLS: Final = 0.7
"""Standard deviation of the low-pass in cells, against aliasing of the noise; chosen."""
_LAGS_DIAMETERS: Final = 0.16
"""Lags up to which autocorrelations are summed; beyond four high-pass lengths they are noise."""
_PEAK_DIAMETERS: Final = 0.04
"""Shifts within this distance of the best one are counted with it: deforming tissue broadens the peak."""
_REACH_DIAMETERS: Final = 0.2
"""Scale of the heavy-tailed prior of the displacement about rest; moves of a hand-held probe are 0.05 to 0.2."""


class SpectraOfImage(NamedTuple):
    """Fourier transforms of a prepared image, of its square and of its local variance, with its autocorrelation."""

    image: NDArray[np.complex64]
    square: NDArray[np.complex64]
    variance: NDArray[np.complex64]
    autocorrelation: NDArray[np.float32]


class ShiftEstimate(NamedTuple):
    """The most probable shift between two images.

    Parameters
    ----------
    row, col : float
        ``later[r + row, c + col]`` shows what ``earlier[r, c]`` shows; cells.
    odds : float
        Log posterior odds against all other shifts and against unrelated images, nats of the whole frame.
    correlation : float
        Zero-mean normalised correlation of the overlap.
    """

    row: float
    col: float
    odds: float
    correlation: float

    @property
    def accepted(self) -> bool:
        """True if the odds reach :data:`MIN_ODDS_NATS`."""
        return self.odds >= MIN_ODDS_NATS


class ShiftOdds:
    """Estimates shifts between images under one mask, over all shifts.

    Parameters
    ----------
    mask : numpy.ndarray
        (rows, cols) float32, 1 where images are compared, 0 elsewhere.
    diameter : float
        Diameter of the field in cells.
    """

    def __init__(self, mask: NDArray[np.float32], diameter: float) -> None:
        self._mask, self._diameter = mask, diameter
        self._size = fft.next_fast_len(2 * max(mask.shape), real=True)
        self._mask_spectrum = self._transform(mask)
        self._overlap = np.maximum(self._correlate(self._mask_spectrum, self._mask_spectrum), 1e-3)
        self._searched = self._overlap > MIN_OVERLAP * mask.sum()
        self._smooth_mask = np.maximum(self._blur(mask, _HIGH_PASS_DIAMETERS), 1e-3)
        self._variance_mask = np.maximum(self._blur(mask, _VARIANCE_DIAMETERS), 1e-2)
        self._lags = fft.fftfreq(self._size, 1 / self._size)
        distance = np.hypot(self._lags[:, None], self._lags)
        self._near_lags = (distance < _LAGS_DIAMETERS * diameter) & self._searched
        prior = -1.5 * np.log1p((distance / (_REACH_DIAMETERS * diameter)) ** 2)
        prior[~self._searched] = -np.inf
        self._prior = prior - _log_sum(prior)

    def spectra(self, image: NDArray[np.float32]) -> SpectraOfImage:
        """Return the spectra of an image (rows, cols), high-passed and smoothed within the mask."""
        mask = self._mask
        inside = (image - self._blur(image * mask, _HIGH_PASS_DIAMETERS) / self._smooth_mask) * mask
        inside = cv2.GaussianBlur(inside, (0, 0), _SMOOTHING_CELLS)
        inside = (inside - inside[mask > 0].mean()) * mask
        spectrum = self._transform(inside)
        variance = self._blur(inside * inside, _VARIANCE_DIAMETERS) / self._variance_mask * mask
        lagged = np.where(self._near_lags, self._correlate(spectrum, spectrum) / self._overlap, 0.0)
        own = (lagged / max(float(lagged[0, 0]), 1e-12)).astype(np.float32)
        return SpectraOfImage(spectrum, self._transform(inside * inside), self._transform(variance), own)

    def best(self, earlier: SpectraOfImage, later: SpectraOfImage) -> ShiftEstimate:
        """Return the most probable shift between two images.

        Parameters
        ----------
        earlier, later : SpectraOfImage
            From :meth:`spectra`.
        """
        mask, count = self._mask_spectrum, self._overlap
        sum_e, sum_l = self._correlate(earlier.image, mask), self._correlate(mask, later.image)
        variance_e = self._correlate(earlier.square, mask) - sum_e**2 / count
        variance_l = self._correlate(mask, later.square) - sum_l**2 / count
        usable = self._searched & (variance_e > 0) & (variance_l > 0)
        product = np.sqrt(np.where(usable, variance_e * variance_l, 1.0))
        r = np.where(usable, (self._correlate(earlier.image, later.image) - sum_e * sum_l / count) / product, 0.0)
        values = self._independent_values(earlier, later)
        log_odds = -0.5 * values * np.log1p(-(np.clip(r, 0.0, 0.9999) ** 2)) + self._prior
        peak = np.unravel_index(np.argmax(log_odds), log_odds.shape)
        away = np.hypot(*np.ix_(*(self._wrapped(self._lags - self._lags[k]) for k in peak)))
        near = away < max(3.0, _PEAK_DIAMETERS * self._diameter)
        others = np.logaddexp(_log_sum(log_odds[~near]), 0.0)  # 0: the images are unrelated
        row, col = (self._lags[k] + self._between(log_odds, peak, axis) for axis, k in enumerate(peak))
        return ShiftEstimate(float(row), float(col), float(_log_sum(log_odds[near]) - others), float(r[peak]))

    def _independent_values(self, earlier: SpectraOfImage, later: SpectraOfImage) -> NDArray[np.float32]:
        """Return the number of independent values in the overlap at each shift."""
        cells_each = max(1.0, float((earlier.autocorrelation * later.autocorrelation).sum()))
        mask = self._mask_spectrum
        sums = self._correlate(earlier.variance, mask) * self._correlate(mask, later.variance)
        met = np.maximum(self._correlate(earlier.variance, later.variance), 1e-12)
        values: NDArray[np.float32] = np.minimum(np.maximum(sums, 0.0) / met, self._overlap) / np.float32(cells_each)
        return values

    def _between(self, values: NDArray[np.floating], peak: tuple[np.intp, ...], axis: int) -> float:
        """Return the top of a parabola through a peak and its neighbours along an axis, in cells from the peak."""
        here = list(peak)
        before, after = (values[tuple((k + s * (a == axis)) % self._size for a, k in enumerate(here))] for s in (-1, 1))
        bend = before + after - 2 * values[peak]
        return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if np.isfinite(bend) and bend < 0 else 0.0

    def _wrapped(self, lags: NDArray[np.float64]) -> NDArray[np.float64]:
        half = self._size / 2
        wrapped: NDArray[np.float64] = (lags + half) % self._size - half
        return wrapped

    def _blur(self, image: NDArray[np.floating], diameters: float) -> NDArray[np.float32]:
        blurred: NDArray[np.float32] = cv2.GaussianBlur(image, (0, 0), max(1.0, diameters * self._diameter))
        return blurred

    def _transform(self, image: NDArray[np.floating]) -> NDArray[np.complex64]:
        spectrum: NDArray[np.complex64] = fft.rfft2(np.asarray(image, np.float32), (self._size, self._size))
        return spectrum

    def _correlate(self, template: NDArray[np.complex64], image: NDArray[np.complex64]) -> NDArray[np.float32]:
        result: NDArray[np.float32] = fft.irfft2(np.conj(template) * image, (self._size, self._size))
        return result


def _log_sum(values: NDArray[np.floating]) -> float:
    """Return the logarithm of a sum of exponentials."""
    top = float(values.max())
    return top + float(np.log(np.exp(values - top).sum())) if np.isfinite(top) else top
