"""Model selection for rotation and scale by the Bayesian information criterion, over many registrations together.

A slow rotation is significant in no single registration but in their sum, which grows faster than its uncertainty.

References
----------
Schwarz, Ann. Stat. 6, 461 (1978), doi:10.1214/aos/1176344136.
"""

from __future__ import annotations

from math import log
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import lean_kernel
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel, Remainder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_MARGIN: Final = 2.0
"""How many times the criterion's penalty must be saved: it is tested again and again in a long recording."""
_MARGIN_OF_SCALE: Final = 6.0
"""The same for scale, which a probe in contact has no reason to change."""
_REMEMBERED: Final = 64
_SUDDEN: Final = 6
"""Registrations in which a sudden rotation shows; a slow one shows in all that are remembered. Chosen: in two the
deformation of tissue passes for one, in eight unrelated errors do."""
_SCATTER: Final = 2.0
_PRIOR_LINKS: Final = 4
"""Variance of links about their mean, in units of what they say, and how many links that is worth at first."""
_MOST_ALIKE: Final = 0.95
_FEWEST_STEADY: Final = 16
"""Registrations from which their scatter is estimated."""


def selected_model(found: Sequence[Remainder]) -> MotionModel:
    """Return the model that the sum of score tests selects, at its largest: a probe may rotate to and fro.

    The variance of a sum is estimated from the scatter of registrations about their mean, and from the correlation of
    successive errors: where little is in view, the same few structures mislead many registrations in a row.

    Parameters
    ----------
    found : Remainder
        Score test of a registration.

    Examples
    --------
    >>> step = np.zeros((3, 6)) + np.array([0, 0, 0, 0, 2e-4, 0])
    >>> selected_model([Remainder(step, np.array([3e-4, 3e-4]), 1500.0)] * 100).name
    'RIGID'
    >>> selected_model([Remainder(0 * step, np.array([3e-4, 3e-4]), 1500.0)] * 100).name
    'TRANSLATION'
    """
    if not found:
        return MotionModel.TRANSLATION
    steps = np.array([_steps_of(one) for one in found])
    sigmas = np.array([one.sigma for one in found])
    return _selected(score_statistics(steps, sigmas, steps[:0], sigmas[:0]), sum(one.values for one in found))


def _steps_of(one: Remainder) -> tuple[float, float, float]:
    """Return rotation and scale if both are modelled, and rotation alone."""
    return (
        float(one.step[MotionModel.SIMILARITY, 4]),
        float(one.step[MotionModel.SIMILARITY, 5]),
        float(one.step[MotionModel.RIGID, 4]),
    )


def _selected(statistics: tuple[float, float], values: float) -> MotionModel:
    needed = _MARGIN * log(values)
    turned, grown = statistics
    if grown > _MARGIN_OF_SCALE * needed:
        return MotionModel.SIMILARITY
    return MotionModel.RIGID if turned > needed else MotionModel.TRANSLATION


@lean_kernel
def score_statistics(
    steps: NDArray[np.float64],
    sigmas: NDArray[np.float64],
    steps_before: NDArray[np.float64],
    sigmas_before: NDArray[np.float64],
) -> tuple[float, float]:
    """Return the test statistics of rotation and of scale.

    Parameters
    ----------
    steps : numpy.ndarray
        (m, 3): rotation and scale by each score test, and rotation where scale is not modelled.
    sigmas : numpy.ndarray
        (m, 2): standard deviations of rotation and scale.
    steps_before, sigmas_before : numpy.ndarray
        (n, 3) and (n, 2) of registrations before these: by as much as they scatter, these may as well. Deforming tissue
        turns and grows to and fro.
    """
    turned = largest_sum(steps[:, 0], sigmas[:, 0], steps_before[:, 0], sigmas_before[:, 0])
    grown = largest_sum(steps[:, 1], sigmas[:, 1], steps_before[:, 1], sigmas_before[:, 1])
    return max(turned, steady_turn(steps[:, 2], sigmas[:, 0])), grown


@lean_kernel
def steady_turn(steps: NDArray[np.float64], sigmas: NDArray[np.float64]) -> float:
    """Return the largest square of the weighted mean of the first registrations, over its variance.

    Weights are inverse variances, so that the few frames with much in view count. Zero below sixteen, from which the
    scatter cannot be estimated.

    Parameters
    ----------
    steps, sigmas : numpy.ndarray
        (m,) rotation by each score test, and its standard deviation.
    """
    largest, weighted, weights = 0.0, 0.0, 0.0
    # sums so far of products of weights, and of weights and rotations: w w, w w s, w w s s, and
    # the same of each link with the one before
    own, own_sum, own_square, pair, pair_sum, pair_square = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    weight_before, step_before = 0.0, 0.0
    for k in range(len(steps)):
        step, weight = steps[k], 1 / (sigmas[k] * sigmas[k])
        weighted += weight * step
        weights += weight
        own += weight * weight
        own_sum += weight * weight * step
        own_square += weight * weight * step * step
        both = weight * weight_before
        pair += both
        pair_sum += both * (step + step_before)
        pair_square += both * step * step_before
        weight_before, step_before = weight, step
        if k + 1 < _FEWEST_STEADY:
            continue
        mean = weighted / weights
        square = own_square - 2 * mean * own_sum + mean * mean * own
        neighbours = pair_square - mean * pair_sum + mean * mean * pair
        alike = min(max(neighbours / square, 0.0), _MOST_ALIKE) if square > 0 else 0.0
        square = max(square, weights)  # no better than stated
        largest = max(largest, weighted * weighted / (square * (1 + alike) / (1 - alike)))
    return largest


@lean_kernel
def scatter(steps: NDArray[np.float64], sigmas: NDArray[np.float64]) -> float:
    """Return the variance of registrations about their mean over the stated one, as that of a sum of them counts.

    Parameters
    ----------
    steps, sigmas : numpy.ndarray
        (m,) estimate of each registration, and its standard deviation.
    """
    links, mean = len(steps), 0.0
    for k in range(links):
        mean += steps[k] / sigmas[k] / links
    square, neighbours, before = 0.0, 0.0, 0.0
    for k in range(links):
        about = steps[k] / sigmas[k] - mean
        square += about * about
        neighbours += about * before
        before = about
    found = (square + _SCATTER * _PRIOR_LINKS) / (links + _PRIOR_LINKS)
    alike = min(max(neighbours / (links * found), 0.0), _MOST_ALIKE)
    return found * (1 + alike) / (1 - alike)


@lean_kernel
def largest_sum(
    steps: NDArray[np.float64],
    sigmas: NDArray[np.float64],
    steps_before: NDArray[np.float64],
    sigmas_before: NDArray[np.float64],
) -> float:
    """Return the largest square of the sum of the first registrations, over its variance.

    Parameters
    ----------
    steps, sigmas : numpy.ndarray
        (m,) estimate of each registration, and its standard deviation.
    steps_before, sigmas_before : numpy.ndarray
        (n,) of registrations before these, by whose scatter these may err as well.
    """
    total, variance, largest = 0.0, 0.0, 0.0
    usual = scatter(steps, sigmas)
    if len(steps_before):
        usual = max(usual, scatter(steps_before, sigmas_before))
    for k in range(len(steps)):
        total += steps[k]
        variance += sigmas[k] * sigmas[k] * usual
        largest = max(largest, total * total / variance)
    return largest


class ModelSelection:
    """Sequential selection of the motion model from the score tests of registrations.

    Attributes
    ----------
    model : MotionModel
        Model of the motion from now on.

    Examples
    --------
    >>> selection = ModelSelection()
    >>> nothing = np.zeros((3, 6))
    >>> selection.weigh(Remainder(nothing, np.array([3e-4, 3e-4]), 1500.0)).name
    'TRANSLATION'
    >>> turned = nothing + np.array([0, 0, 0, 0, 0.01, 0])
    >>> [selection.weigh(Remainder(turned, np.array([3e-4, 3e-4]), 1500.0)).name for _ in range(3)]
    ['TRANSLATION', 'TRANSLATION', 'RIGID']
    """

    def __init__(self) -> None:
        self.model = MotionModel.TRANSLATION
        self._steps, self._sigmas = np.empty((_REMEMBERED, 3)), np.empty((_REMEMBERED, 2))
        self._values = np.empty(_REMEMBERED)
        self._links = 0

    def weigh(self, found: Remainder, *, keep: bool = True) -> MotionModel:
        """Test a registration together with those before; return the model selected. It is stored if it is to be kept.

        Parameters
        ----------
        found : Remainder
            Score test of a registration.
        keep : bool
            Add its evidence to that of the earlier ones.
        """
        if self._links == _REMEMBERED:
            for kept in (self._steps, self._sigmas, self._values):
                kept[:-1] = kept[1:]
            self._links -= 1
        n = self._links
        self._steps[n], self._sigmas[n], self._values[n] = _steps_of(found), found.sigma, found.values
        for first in (max(0, n + 1 - _SUDDEN), 0):
            statistics = score_statistics(
                self._steps[first : n + 1], self._sigmas[first : n + 1], self._steps[:first], self._sigmas[:first]
            )
            self.model = max(self.model, _selected(statistics, float(self._values[first : n + 1].sum())))
        self._links += keep
        return self.model
