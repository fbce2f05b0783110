"""Distances at which a noisy curve that falls with depth reaches a level, and their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.optimize import isotonic_regression

from napari_elsplus.processing.analysis.uncertainty import small_sample_factor
from napari_elsplus.processing.axial.curve_noise import NEAR, DepthMeans, noise_of_curve, pooled_variance

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Curve = NDArray[np.float64]

FITTED: Final = 0.35
"""Depths that are fitted about a distance, to either side of it as a share of it; measured: distances of the paper's
two states, at offsets of 12 to 77 um and in the scan's steps of 2 to 10 um, are then off by 0.05 % at most."""
_DEGREE: Final = 3
"""Of the polynomial; derived: in the middle of its points a cubic has the variance of a parabola."""
MIN_FITTED: Final = _DEGREE + 3
"""Smallest number of such depths; derived: two of them show what the cubic leaves over."""
_ITERATIONS: Final = 3
"""Of the fit; chosen: the second changes the distance by less than a hundredth of its uncertainty."""


@dataclass(frozen=True, slots=True)
class DropOff:
    """Distance from contact at which a curve falls to a level; NaN where the scan does not reach it.

    Parameters
    ----------
    um, uncertainty_um : float
        Distance and its standard deviation, micrometres.
    random_um : float
        Part of the latter that frames vary by, and that more frames reduce.
    """

    um: float
    uncertainty_um: float
    random_um: float = 0.0


class _Crossing(NamedTuple):
    """Depth at which a level is reached, relative slope there (1/um), and relative variance of the signal there."""

    at_um: float
    relative_slope: float
    variance: float


class FallingCurve:
    """Curve that decreases from its first point, in contact.

    Parameters
    ----------
    points : DepthMeans
        Mean signal and scatter at each depth, from contact on.
    zero_dn : float
        Standard deviation of the signal's zero.
    correlated_dn : numpy.ndarray
        (depths,) fully correlated error of all depths.
    """

    def __init__(self, points: DepthMeans, zero_dn: float, correlated_dn: Curve) -> None:
        self._points, self._zero_dn, self._correlated_dn = points, zero_dn, correlated_dn
        fitted = isotonic_regression(points.mean, increasing=False)
        first, last = fitted.blocks[:-1], fitted.blocks[1:]
        self._monotonic: Curve = fitted.x[first]
        self._places: Curve = np.array([points.depth[a:b].mean() for a, b in zip(first, last, strict=True)])
        self._places[0] = points.depth[0]
        self.contact = float(self._monotonic[0])
        self._contact_weight = float(points.weight[: last[0]].sum())
        self.noise, self._relative = noise_of_curve(points.depth, points.mean)

    def drop(self, level: float) -> DropOff:
        """Return the distance at which the curve falls to a level.

        Parameters
        ----------
        level : float
            Share of the signal in contact.
        """
        share = self._monotonic / self.contact
        below = int(np.argmax(share < level))
        if share[below] >= level:
            return DropOff(float("nan"), float("nan"))
        between = self._interpolated(share, below, level)
        crossing = self._fitted(between.at_um, level) or between
        correlated = np.interp(crossing.at_um, self._points.depth, self._correlated_dn) - level * self._correlated_dn[0]
        per_um = level * self.contact * abs(crossing.relative_slope)
        random_um = float(np.sqrt(crossing.variance + self._variance(1.0, self._contact_weight))) * (
            level * self.contact / per_um
        )
        systematic_um = float(np.hypot((1 - level) * self._zero_dn, correlated)) / per_um
        distance_um = float(crossing.at_um - self._points.depth[0])
        return DropOff(distance_um, float(np.hypot(random_um, systematic_um)), random_um)

    def _interpolated(self, share: Curve, below: int, level: float) -> _Crossing:
        """Return where the line through the points before and after a level reaches it."""
        step, first = share[below] - share[below - 1], self._places[below - 1]
        slope, part = step / (self._places[below] - first), (level - share[below - 1]) / step
        variance = (part**2 + (1 - part) ** 2) * self._variance(level, self._weight)
        return _Crossing(float(first + (level - share[below - 1]) / slope), float(slope / level), variance)

    def _fitted(self, about_um: float, level: float) -> _Crossing | None:
        """Return where an exponential of a cubic through the points about a depth reaches a level.

        None where they are too few, or it does not fall through the level there. The variance is that of a frame by
        what the fit leaves over and by the scatter of repeated frames, pooled: noise that repeated frames have in
        common is in the former alone.
        """
        reach_um = FITTED * (about_um - self._points.depth[0])
        near = np.abs(self._points.depth - about_um) <= reach_um
        if np.count_nonzero(near) < MIN_FITTED:
            return None
        depth, mean, frames, weight, square = (values[near] for values in self._points)
        place, share, square = (depth - about_um) / reach_um, mean / self.contact, square / self.contact**2
        terms = np.vander(place, _DEGREE + 1)
        curvature = np.linalg.inv(terms.T @ (weight[:, None] * terms))
        log_fit = np.full(len(place), np.log(level))
        for _ in range(_ITERATIONS):
            target = log_fit + share / np.exp(log_fit) - 1
            factors = curvature @ (terms.T @ (weight * target))
            log_fit = np.clip(terms @ factors, np.log(level / NEAR**2), np.log(level * NEAR**2))
        fall = np.poly1d(factors) - np.log(level)
        inside = [float(root.real) for root in fall.roots if root.imag == 0 and abs(root.real) < 1]
        if len(inside) != 1 or not (slope := float(fall.deriv()(inside[0]))) < 0:
            return None
        fitted = np.exp(log_fit)
        left = float((weight * np.square(share / fitted - 1)).sum() + (square / np.square(fitted)).sum())
        freedom = round(float(frames.sum())) - len(factors)
        at = np.vander(inside, _DEGREE + 1)[0]
        variance = small_sample_factor(freedom) ** 2 * left / freedom * float(at @ curvature @ at)
        return _Crossing(about_um + inside[0] * reach_um, slope / reach_um, variance)

    @property
    def _weight(self) -> float:
        return float(self._points.weight.mean())

    def _variance(self, level: float, weight: float) -> float:
        """Return the relative variance of a mean of some weight at a level.

        Scatter about a smooth curve and that of repeated frames are independent estimates, of which the mean is taken,
        the latter weighted by the frames beyond the first at each depth: its degrees of freedom.
        """
        along_curve = ((self.noise / (level * self.contact)) ** 2 + self._relative**2) * self._weight
        repeated = pooled_variance(self._points, self.contact, level) / self.contact**2
        if np.isnan(repeated):
            return along_curve / weight
        repeats = float(self._points.frames.mean()) - 1
        return (along_curve + repeats * repeated) / (1 + repeats) / weight
