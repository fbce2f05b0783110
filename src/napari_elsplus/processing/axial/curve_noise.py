"""Noise on a smooth curve without a model of it: from neighbouring points, and from points measured more than once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

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
NEAR: Final = 2.5
"""Ratio of shares of the signal up to which points have noise of a kind; chosen: several points of a scan, and no more
than a decade of signal."""
_MIN_FREEDOM: Final = 3
"""Smallest number of frames beyond the first at such points; chosen: fewer do not show their own scatter."""


class DepthMeans(NamedTuple):
    """Mean signal at each depth, in increasing order, from the frames that were recorded there.

    The variance of a mean is that of a frame of weight 1 over the weight.

    Parameters
    ----------
    depth, mean : numpy.ndarray
        (depths,) each depth once, and the weighted mean of the signals there.
    frames, weight : numpy.ndarray
        (depths,) number of the frames, and sum of their weights.
    square : numpy.ndarray
        (depths,) weighted sum of the squares of their signals about the mean.
    """

    depth: Curve
    mean: Curve
    frames: Curve
    weight: Curve
    square: Curve

    def beyond(self, contact: int) -> DepthMeans:
        """Return those from contact on.

        Parameters
        ----------
        contact : int
            Index of the depth of contact.
        """
        return DepthMeans(*(values[contact:] for values in self))


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


def means_at_depths(depth: Curve, signal: Curve, weight: Curve) -> DepthMeans:
    """Return the means, and the scatter, of the frames recorded at each different depth.

    Parameters
    ----------
    depth, signal, weight : numpy.ndarray
        (T,) of each frame, in any order.

    Examples
    --------
    >>> means = means_at_depths(np.array([0.0, 5.0, 0.0]), np.array([3.0, 1.0, 5.0]), np.ones(3))
    >>> means.mean.tolist(), means.square.tolist()
    ([4.0, 1.0], [2.0, 0.0])
    """
    unique, place, count = np.unique(depth, return_inverse=True, return_counts=True)
    total = np.bincount(place, weight)
    mean = np.bincount(place, weight * signal) / total
    square = np.bincount(place, weight * np.square(signal - mean[place]))
    return DepthMeans(*(np.asarray(values, np.float64) for values in (unique, mean, count, total, square)))


def pooled_variance(points: DepthMeans, contact: float, level: float) -> float:
    """Return the variance of a frame of weight 1 at a level, over its squared share; NaN of too few frames near it.

    Variances are taken for proportional to the squared signal, as is that of the power. Of few
    frames, it is that of Student's t.

    Parameters
    ----------
    points : DepthMeans
        Of the frames at each depth.
    contact : float
        Signal in contact.
    level : float
        Share of it.
    """
    share = points.mean / contact
    near = (share > level / NEAR) & (share < level * NEAR)
    freedom = round(float((points.frames[near] - 1).sum()))
    if freedom < _MIN_FREEDOM:
        return float("nan")
    square = float((points.square[near] / np.square(share[near])).sum())
    return small_sample_factor(freedom) ** 2 * square / freedom
