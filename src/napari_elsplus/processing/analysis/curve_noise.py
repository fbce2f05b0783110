"""Noise on a smooth curve without a model of it: from neighbouring points, and from points measured more than once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.analysis.uncertainty import robust_sigma, small_sample_factor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Curve = NDArray[np.float64]

MIN_POINTS: Final = 3
"""Smallest number of points; derived: the noise is estimated from a point and its two neighbours."""
_BRIGHT: Final = 0.2
"""Of the signal in contact, above which points show the noise that is proportional to the signal; chosen."""
_MIN_BRIGHT: Final = 5
"""Smallest number of such points; chosen: the median of fewer is no standard deviation."""
_NEAR: Final = 2.5
"""Ratio of shares of the signal up to which points have noise of a kind; chosen: several points of a scan, and no more
than a decade of signal."""
_MIN_NEAR: Final = 3
"""Smallest number of such points; chosen: fewer do not show their own scatter."""


def noise_of_curve(depth: Curve, signal: Curve) -> tuple[float, float]:
    """Estimate the noise on a smooth curve from each point's departure from the line through its neighbours.

    Parameters
    ----------
    depth, signal : numpy.ndarray
        (depths,) abscissa in increasing order, and signal.

    Returns
    -------
    tuple of float
        Standard deviation that all points have, in their unit, and that in excess of it, relative to the signal, of the
        bright points: power that differs from frame to frame.
    """
    if len(depth) < MIN_POINTS:
        return 0.0, 0.0
    ahead = (depth[1:-1] - depth[:-2]) / (depth[2:] - depth[:-2])
    departure = signal[1:-1] - (1 - ahead) * signal[:-2] - ahead * signal[2:]
    departure /= np.sqrt(1 + ahead**2 + (1 - ahead) ** 2)
    noise = float(robust_sigma(departure - np.median(departure)))
    bright = signal[1:-1] > _BRIGHT * signal.max()
    if np.count_nonzero(bright) < _MIN_BRIGHT:
        return noise, 0.0
    level = signal[1:-1][bright]
    # The curvature of the curve itself cancels in differences; of departures that share points, these vary 10/3 times.
    steps = np.diff(departure[bright] / level)
    excess = float(robust_sigma(steps - np.median(steps))) ** 2 / (10 / 3) - float(np.median(np.square(noise / level)))
    return noise, float(np.sqrt(max(excess, 0.0)))


def variance_of_means(depth: Curve, signal: Curve) -> Curve:
    """Return the variance of the mean signal at each different depth, by the scatter of the frames recorded there.

    Parameters
    ----------
    depth, signal : numpy.ndarray
        (T,) of each frame, in any order.

    Returns
    -------
    numpy.ndarray
        (depths,) in increasing order of depth; NaN of a depth that was recorded once.

    Examples
    --------
    >>> variance_of_means(np.array([0.0, 5.0, 0.0]), np.array([3.0, 1.0, 5.0])).tolist()
    [1.0, nan]
    """
    _, place, count = np.unique(depth, return_inverse=True, return_counts=True)
    mean = np.bincount(place, signal) / count
    square = np.bincount(place, np.square(signal - mean[place]))
    return np.where(count > 1, square / np.maximum(count * (count - 1), 1), np.nan)


def relative_variance(share: Curve, variance: Curve, level: float, repeats: float) -> float:
    """Return the variance at a level by points near it, over its squared share of the signal; NaN of too few points.

    Variances are taken for proportional to the signal: between noise that all points have and that of the power.

    Parameters
    ----------
    share, variance : numpy.ndarray
        (depths,) signal over that in contact, and its variance, NaN where unknown.
    level : float
        Share of the signal in contact.
    repeats : float
        Frames beyond the first at each depth: of few, the variance is that of Student's t.
    """
    near = np.isfinite(variance) & (share > level / _NEAR) & (share < level * _NEAR)
    if np.count_nonzero(near) < _MIN_NEAR:
        return float("nan")
    factor = small_sample_factor(round(repeats * np.count_nonzero(near)))
    return factor**2 * float(np.mean(variance[near] / np.square(share[near])))
