"""Depth at which the plate is in contact, from the signals alone or as the depths are counted.

LS and ELS+ are both largest in contact. ELS+ may fall faster, jitter of the line hardly touches LS: contact is where
neither excludes it.
"""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.optimize import isotonic_regression

from napari_elsplus.processing.axial.curve_noise import MIN_POINTS, DepthMeans, noise_of_curve

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Curve = NDArray[np.float64]

_NEAR: Final = 0.5
"""Of the largest signal, above which contact is searched; chosen: all of a pressed plate, and enough of the fall."""
_MAX_NOISE: Final = 0.05
"""Relative noise up to which a curve is stated to be level; chosen: a fall by a fifth is then excluded."""
_EXCLUDED_SIGMAS: Final = 4.0
"""Standard deviations by which a depth is excluded; chosen: more than 3, as regression follows the noise."""
_FURTHER: Final = 2**1.5
"""Factor of standard deviations by which twice the distance is excluded; derived: the misfit of a curve that falls
evenly grows as the third power of the distance."""
_FLOOR: Final = 1e-6
"""Least noise and signal, part of the largest; chosen: below any camera's, and above the rounding of sums."""


class Contact(NamedTuple):
    """Depth of contact among those recorded.

    Parameters
    ----------
    place : int
        Of the depth.
    uncertainty_um : float
        Its standard deviation by steps and noise; 0 of the first depth from which on the signals fall.
    level_um : float
        Distance from the first depth over which the signals do not change, as those of a plate that is pressed do not.
    """

    place: int
    uncertainty_um: float
    level_um: float


def find_contact(of_ls: DepthMeans, of_els: DepthMeans) -> Contact:
    """Return the depth of contact of a scan.

    It is depth 0 where the signals do not exclude that: depths are counted from it. Else it is the last depth of a
    signal that is level from the first depth on, of a plate that was pressed; else the middle of the depths at which
    the signals may be largest (unimodal regression).

    Parameters
    ----------
    of_ls, of_els : DepthMeans
        Mean signals at each depth.

    Examples
    --------
    >>> from napari_elsplus.processing.axial.curve_noise import means_at_depths
    >>> depth = np.arange(70.0, 160, 2)
    >>> beyond = np.maximum(depth - 90, 0)  # pressed from 70 to 90 um
    >>> curves = (1 / (1 + beyond / 60), 1 / (1 + (beyond / 30) ** 2))
    >>> contact = find_contact(*(means_at_depths(depth, each, np.ones_like(depth)) for each in curves))
    >>> float(depth[contact.place]), contact.level_um
    (90.0, 20.0)
    """
    depth, last = of_ls.depth, len(of_ls.depth) - 1
    bounds = [_bounds(curve) for curve in (of_ls, of_els)]
    first, end = max(each.first for each in bounds), min(each.end for each in bounds)
    if first > end:
        first, end, _ = bounds[0]
    level_um = 0.0 if first else min(each.level_um for each in bounds)
    zero = int(np.searchsorted(depth, 0.0))
    if first <= zero <= end and zero < last and depth[zero] == 0:
        return Contact(zero, _within_step_um(depth, zero) if zero else level_um, level_um)
    if end == last:
        return Contact(last, 0.0, level_um)
    if first == 0:
        index = int(np.argmin(np.abs(depth - depth[0] - level_um)))
        noise_um = (depth[end] - depth[index]) / sqrt(3) if index else 0.0
    else:
        after = int(np.searchsorted(depth, (depth[first] + depth[end]) / 2))
        index = max((after, max(after - 1, first)), key=lambda k: of_ls.mean[k])
        noise_um = (depth[end] - depth[first]) / sqrt(12)
    return Contact(index, max(_within_step_um(depth, index), float(noise_um)), level_um)


def _within_step_um(depth: Curve, index: int) -> float:
    """Return the standard deviation of contact anywhere within half a step of a depth; 0 of the first depth."""
    return float(depth[index + 1] - depth[index - 1]) / 2 / sqrt(12) if index else 0.0


class _Bounds(NamedTuple):
    """First and last depth at which a curve may be largest, and distance over which it is level from the first on."""

    first: int
    end: int
    level_um: float


def _bounds(curve: DepthMeans) -> _Bounds:
    """Return where a curve may be largest."""
    near = np.flatnonzero(curve.mean > _NEAR * curve.mean.max())
    if len(near) < MIN_POINTS:
        top = int(np.argmax(curve.mean))
        return _Bounds(top, top, 0.0)
    near = np.arange(near[0], near[-1] + 1)
    depth, signal = curve.depth[near], curve.mean[near] / curve.mean.max()
    noise = max(noise_of_curve(depth, np.log(np.maximum(signal, _FLOOR)))[0], _FLOOR)
    misfit = _misfit(signal, curve.weight[near]) / noise
    first, end = np.flatnonzero(misfit <= _EXCLUDED_SIGMAS)[[0, -1]]
    ends_um = []
    for sigmas in (_EXCLUDED_SIGMAS, _FURTHER * _EXCLUDED_SIGMAS):
        before = int(np.flatnonzero(misfit <= sigmas)[-1])
        after = min(before + 1, len(near) - 1)
        ends_um.append(float(np.interp(sigmas, misfit[[before, after]], depth[[before, after]])))
    level_um = max(0.0, 2 * ends_um[0] - ends_um[1] - float(depth[0])) if noise < _MAX_NOISE else 0.0
    return _Bounds(int(near[first]), int(near[end]), level_um)


def _misfit(signal: Curve, weight: Curve) -> Curve:
    """Return by how much a unimodal curve with its maximum at each depth misses a signal more than the best, (depths,).

    Root of the sum of squares, in units of the signal, which equals its noise on average.
    """
    scale = weight / weight.mean()
    squares = np.empty(len(signal))
    for k in range(len(signal)):
        rise, fall = slice(None, k + 1), slice(k, None)
        rising = isotonic_regression(signal[rise], weights=scale[rise]).x
        falling = isotonic_regression(signal[fall], weights=scale[fall], increasing=False).x
        squares[k] = scale[rise] @ np.square(signal[rise] - rising) + scale[fall] @ np.square(signal[fall] - falling)
    return np.asarray(np.sqrt(squares - squares.min()), np.float64)
