"""Log posterior odds of the best shift between two images against all others and against none, in nats of the frame.

For finished images, whose texture may be soft and whose noise is unknown. The likelihood of a shift follows from the
normalised correlation r of the overlap: with n independent values, n / 2 ln(1 / (1 - r^2)) nats above that of
unrelated images. The number n is estimated from the images: the variance of r between unrelated ones is the sum over
all lags of the product of both autocorrelations over the number of pixels (Bartlett 1935,
doi:10.1111/j.2397-2335.1935.tb04253.x), and larger where bright structure of one meets that of the other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np
from scipy.special import logsumexp

from napari_elsplus.processing.tracking.registration import masked_correlation

if TYPE_CHECKING:
    from numpy.typing import NDArray

MIN_ODDS_NATS: Final = 16.0
"""Log posterior odds from which a shift is accepted: one wrong shift in ten million if the noise model held. Unrelated
pairs reach 0 nats in a real video and 3 in synthetic soft tissue; the rest is a margin, set on that video between what
two other methods see (18 and more) and what they do not (``docs/tracking-accuracy.md``)."""
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
    """What the odds need of an image.

    Parameters
    ----------
    image : CoarseImage
        High-passed and smoothed.
    variance : numpy.ndarray
        Spectrum of its local variance.
    variance_sums : numpy.ndarray
        Sum of that over the overlap with the mask at each shift.
    autocorrelation : numpy.ndarray
        Of the image, at each lag.
    """

    image: masked_correlation.CoarseImage
    variance: NDArray[np.float32]
    variance_sums: NDArray[np.float32]
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
        Normalised correlation of the overlap, high-passed.
    """

    row: float
    col: float
    odds: float
    correlation: float


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
        self._variance_px = max(1.0, _VARIANCE_DIAMETERS * diameter)
        self._correlation = both = masked_correlation.MaskedCorrelation(mask, MIN_OVERLAP)
        distance = np.hypot(both.lags[:, None], both.lags)
        self._near_lags = (distance < _LAGS_DIAMETERS * diameter) & both.searched
        prior = -1.5 * np.log1p((distance / (_REACH_DIAMETERS * diameter)) ** 2)
        prior[~both.searched] = -np.inf
        self._prior = prior - logsumexp(prior)

    def spectra(self, image: NDArray[np.float32]) -> SpectraOfImage:
        """Return the spectra of an image (rows, cols), high-passed and smoothed within the mask."""
        mask, both = self._mask, self._correlation
        passed = masked_correlation.high_passed(image, mask, max(1.0, _HIGH_PASS_DIAMETERS * self._diameter))
        inside = cv2.GaussianBlur(passed, (0, 0), _SMOOTHING_CELLS)
        inside = (inside - inside[mask > 0].mean()) * mask
        found = both.prepare(inside)
        smooth, weight = (cv2.GaussianBlur(values, (0, 0), self._variance_px) for values in (inside * inside, mask))
        variance = both.spectrum(smooth / np.maximum(weight, 1e-2) * mask)
        lagged = np.where(self._near_lags, both.correlate(found.spectrum, found.spectrum) / both.overlap, 0.0)
        own = (lagged / max(float(lagged[0, 0]), 1e-12)).astype(np.float32)
        return SpectraOfImage(found, variance, both.correlate(both.mask_spectrum, variance), own)

    def best(self, earlier: SpectraOfImage, later: SpectraOfImage) -> ShiftEstimate:
        """Return the most probable shift between two images.

        Parameters
        ----------
        earlier, later : SpectraOfImage
            From :meth:`spectra`.
        """
        r, lags = self._correlation.coefficients(earlier.image.as_template, later.image), self._correlation.lags
        values = self._independent_values(earlier, later)
        log_odds = -0.5 * values * np.log1p(-(np.clip(r, 0.0, 0.9999) ** 2)) + self._prior
        peak = np.unravel_index(np.argmax(log_odds), log_odds.shape)
        half = len(lags) / 2
        away = np.hypot(*np.ix_(*((lags - lags[k] + half) % len(lags) - half for k in peak)))
        near = away < max(3.0, _PEAK_DIAMETERS * self._diameter)
        others = np.logaddexp(logsumexp(log_odds[~near]), 0.0)  # 0: the images are unrelated
        row, col = (lags[k] + _top(np.take(log_odds, peak[1 - axis], 1 - axis), k) for axis, k in enumerate(peak))
        return ShiftEstimate(float(row), float(col), float(logsumexp(log_odds[near]) - others), float(r[peak]))

    def _independent_values(self, earlier: SpectraOfImage, later: SpectraOfImage) -> NDArray[np.float32]:
        """Return the number of independent values in the overlap at each shift."""
        cells_each = max(1.0, float((earlier.autocorrelation * later.autocorrelation).sum()))
        sums = masked_correlation.opposite(earlier.variance_sums) * later.variance_sums
        met = np.maximum(self._correlation.correlate(earlier.variance, later.variance), 1e-12)
        overlap = self._correlation.overlap
        values: NDArray[np.float32] = np.minimum(np.maximum(sums, 0.0) / met, overlap) / np.float32(cells_each)
        return values


def _top(values: NDArray[np.floating], peak: np.intp) -> float:
    """Return the top of a parabola through a peak of periodic values and its neighbours, in cells from the peak."""
    before, after = values[peak - 1], values[(peak + 1) % len(values)]
    bend = before + after - 2 * values[peak]
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if np.isfinite(bend) and bend < 0 else 0.0
