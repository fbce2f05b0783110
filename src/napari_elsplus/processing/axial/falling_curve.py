"""Distances at which a noisy curve that falls with depth reaches a level, and their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression

from napari_elsplus.processing.analysis.uncertainty import small_sample_factor
from napari_elsplus.processing.axial.curve_noise import NEAR, DepthMeans, noise_of_curve, pooled_variance

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Curve = NDArray[np.float64]

FITTED: Final = 0.35
"""Depths that are fitted about a distance, to either side of it as a share of it; measured: distances of the paper's
two states, at offsets of 12 to 77 um and in the scan's steps of 2 to 10 um, are then off by 0.05 % at most."""
_DEGREE: Final = 3
"""Of the polynomial; derived: in the middle of its points a cubic has the variance of a parabola."""
MIN_FITTED: Final = _DEGREE + 3
"""Smallest number of such depths; derived: two of them show what the cubic leaves over."""
_INTERPOLATION_ERROR: Final = 1 / 3
"""Standard deviation of an interpolated distance, part of the difference of straight lines through the shares and
through their logarithms; measured: on eleven curves, the paper's two states among them, in steps of 5 to 50 um, errors
are at most 0.6 of it, and half of them less than 0.06."""
_FIRST_FALL: Final = 0.8
"""Share of the signal in contact down to which its first decrease is measured; chosen: noise of 1 % changes it by a
twentieth, and the curve hardly bends."""
_RISE_SIGMAS: Final = 5.0
"""Standard deviations by which a signal rises again; chosen: noise does so in none of thousands of depths."""
_MIN_RISE: Final = 0.05
"""Share of the signal in contact by which it rises again; chosen: half of the lower level."""
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
    sampling_um : float
        Part of it by interpolation between depths too far apart for a fit, which more depths reduce.
    depths : int
        Depths near the distance, of which a fit needs `MIN_FITTED`.
    slopes : float
        Slope of the curve beyond contact over that at the distance, relative to the signal there: by it a displacement
        of contact counts, as the signal that the level is a share of is then too small as well.
    """

    um: float
    uncertainty_um: float
    random_um: float = 0.0
    sampling_um: float = 0.0
    depths: int = 0
    slopes: float = 0.0

    def with_systematic(self, um: float) -> DropOff:
        """Return the distance with a further uncertainty, one standard deviation in micrometres (`um`)."""
        return replace(self, uncertainty_um=float(np.hypot(self.uncertainty_um, um)))

    @property
    def per_contact(self) -> float:
        """Change of the distance with a displacement of contact of either sign, root mean square."""
        return float(np.hypot(1.0, self.slopes))

    @property
    def per_gap(self) -> float:
        """Change of the distance with a gap at the contact that was recorded, root mean square.

        The curve may be level in the gap, which is not recorded, or as steep as beyond it.
        """
        return float(np.hypot(self.slopes - 1.0, self.slopes / 2))

    @property
    def max_step_um(self) -> float:
        """Step of the depths from which the curve can be fitted about the distance."""
        return 2 * FITTED * self.um / MIN_FITTED


class _Crossing(NamedTuple):
    """Depth at which a level is reached, relative slope (1/um) and relative variance there, error of interpolation."""

    at_um: float
    relative_slope: float
    variance: float
    sampling_um: float = 0.0


class Rise(NamedTuple):
    """Depths from which and up to which a signal rises again beyond contact, as that of a second plane."""

    from_um: float
    to_um: float


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
        self.rise = self._rise()

    def _rise(self) -> Rise | None:
        """Return where the signal rises again beyond contact by more than noise; None if it does not."""
        mean = self._points.mean
        rise = mean - np.minimum.accumulate(mean)
        noise = np.sqrt(2 * (self.noise**2 + np.square(self._relative * mean)))
        risen = np.where((rise > _RISE_SIGMAS * noise) & (rise > _MIN_RISE * self.contact), rise, 0.0)
        if not risen.any():
            return None
        top = int(np.argmax(risen))
        return Rise(float(self._points.depth[np.argmin(mean[:top])]), float(self._points.depth[top]))

    @property
    def first_slope(self) -> float:
        """Mean decrease beyond contact, shares per micrometre, to `_FIRST_FALL` or the last depth; 0 without any."""
        share = self._monotonic / self.contact
        fallen = share < _FIRST_FALL
        below = int(np.argmax(fallen)) if fallen.any() else len(share) - 1
        return float((1 - share[below]) / (self._places[below] - self._places[0])) if below else 0.0

    def depths_at(self, levels: Sequence[float]) -> Curve:
        """Return the depths at which the curve reaches descending shares of the signal in contact.

        Parameters
        ----------
        levels : sequence of float
            From 1 on; those that the scan does not reach are left out.
        """
        share = self._monotonic / self.contact
        reached = [level for level in levels if level >= share[-1]]
        return np.asarray(np.interp(np.negative(reached), -share, self._places), np.float64)

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
        part = (level - share[below - 1]) / (share[below] - share[below - 1])
        about_um = float(self._places[below - 1] + part * (self._places[below] - self._places[below - 1]))
        crossing = self._fitted(about_um, level) or self._interpolated(share, below, level)
        correlated = np.interp(crossing.at_um, self._points.depth, self._correlated_dn) - level * self._correlated_dn[0]
        per_um = level * self.contact * abs(crossing.relative_slope)
        random_um = float(np.sqrt(crossing.variance + self._variance(1.0, self._contact_weight))) * (
            level * self.contact / per_um
        )
        systematic_um = float(np.hypot((1 - level) * self._zero_dn, correlated)) / per_um
        distance_um = float(crossing.at_um - self._points.depth[0])
        uncertainty_um = float(np.linalg.norm([random_um, systematic_um, crossing.sampling_um]))
        depths = int(np.count_nonzero(self._near(about_um)))
        slopes = self.first_slope / abs(crossing.relative_slope)
        return DropOff(distance_um, uncertainty_um, random_um, crossing.sampling_um, depths, slopes)

    def _near(self, about_um: float) -> NDArray[np.bool_]:
        """Return the depths that are fitted about one, (depths,) bool."""
        reach_um = FITTED * (about_um - self._points.depth[0])
        return np.asarray(np.abs(self._points.depth - about_um) <= reach_um)

    def _interpolated(self, share: Curve, below: int, level: float) -> _Crossing:
        """Return where a monotonic cubic through the logarithms of the points reaches a level; a line, if one is 0."""
        (before, after), (first, last) = share[below - 1 : below + 1], self._places[below - 1 : below + 1]
        part = (level - before) / (after - before)
        variance = (part**2 + (1 - part) ** 2) * self._variance(level, self._weight)
        positive = int(np.count_nonzero(share > 0))
        log_after = np.log(after if below < positive else level / NEAR**2)
        log_part = np.log(level / before) / (log_after - np.log(before))
        sampling_um = _INTERPOLATION_ERROR * abs(part - log_part) * (last - first)
        at_um, slope = first + part * (last - first), (after - before) / (last - first) / level
        if below < positive:
            curve = PchipInterpolator(self._places[:positive], np.log(share[:positive] / level))
            crossings = curve.solve(0.0, extrapolate=False)
            if len(crossings) == 1:
                at_um, slope = crossings[0], curve.derivative()(crossings[0])
        return _Crossing(float(at_um), float(slope), variance, float(sampling_um))

    def _fitted(self, about_um: float, level: float) -> _Crossing | None:
        """Return where an exponential of a cubic through the points about a depth reaches a level.

        None where they are too few, or it does not fall through the level there. The variance is that of a frame by
        what the fit leaves over and by the scatter of repeated frames, pooled: noise that repeated frames have in
        common is in the former alone.
        """
        reach_um, near = FITTED * (about_um - self._points.depth[0]), self._near(about_um)
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
