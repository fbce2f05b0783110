"""When rotation and scale are modelled: the Bayesian information criterion, asked of many links together.

A slow turn shows in no single link but in their sum, which grows faster than its uncertainty.

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
"""How many times the criterion's penalty must be saved: it is asked again and again in a long recording."""
_MARGIN_OF_SCALE: Final = 6.0
"""The same for scale, which a probe in contact has no reason to change."""
_REMEMBERED: Final = 64
_LAST: Final = (2, _REMEMBERED)
"""Links that are weighed together: few tell a sudden turn, many a slow one."""
_SCATTER: Final = 2.0
_PRIOR_LINKS: Final = 4
"""Variance of links about their mean, in units of what they say, and how many links that is worth at first."""
_MOST_ALIKE: Final = 0.95
_FEWEST_STEADY: Final = 16
"""Links that tell how they scatter."""


def asked_for(found: Sequence[Remainder]) -> MotionModel:
    """Return what the sum of links asks for, at its largest: a probe may turn to and fro.

    How much a sum may be off is learnt from how the links scatter about their mean, and from how alike the errors of
    successive ones are: where little is in view, the same few things mislead many links in a row.

    Parameters
    ----------
    found : Remainder
        Score test of a registration.

    Examples
    --------
    >>> step = np.zeros((3, 6)) + np.array([0, 0, 0, 0, 2e-4, 0])
    >>> asked_for([Remainder(step, np.array([3e-4, 3e-4]), 1500.0)] * 100).name
    'RIGID'
    >>> asked_for([Remainder(0 * step, np.array([3e-4, 3e-4]), 1500.0)] * 100).name
    'TRANSLATION'
    """
    if not found:
        return MotionModel.TRANSLATION
    steps = np.array([_answers(one) for one in found])
    return _rung(steps, np.array([one.sigma for one in found]), sum(one.values for one in found))


def _answers(one: Remainder) -> tuple[float, float, float]:
    """Rotation and scale if both are asked for, and rotation alone."""
    return (
        float(one.step[MotionModel.SIMILARITY, 4]),
        float(one.step[MotionModel.SIMILARITY, 5]),
        float(one.step[MotionModel.RIGID, 4]),
    )


def _rung(steps: NDArray[np.float64], sigmas: NDArray[np.float64], values: float) -> MotionModel:
    needed = _MARGIN * log(values)
    turned, grown = told(steps, sigmas)
    if grown > _MARGIN_OF_SCALE * needed:
        return MotionModel.SIMILARITY
    return MotionModel.RIGID if turned > needed else MotionModel.TRANSLATION


@lean_kernel
def told(steps: NDArray[np.float64], sigmas: NDArray[np.float64]) -> tuple[float, float]:
    """How much links tell of a turn, and of a change of scale.

    Parameters
    ----------
    steps : numpy.ndarray
        (m, 3): rotation and scale that each link asks for, and rotation where scale is not asked for.
    sigmas : numpy.ndarray
        (m, 2): how well it says it knows rotation and scale.
    """
    turned = max(largest_sum(steps[:, 0], sigmas[:, 0]), steady_turn(steps[:, 2], sigmas[:, 0]))
    return turned, largest_sum(steps[:, 1], sigmas[:, 1])


@lean_kernel
def steady_turn(steps: NDArray[np.float64], sigmas: NDArray[np.float64]) -> float:
    """Largest square of the mean of the first links, over its variance, each weighted by what it knows.

    The few links with much in view then tell a slow turn among many that tell nothing. Fewer than sixteen tell nothing
    of how they scatter, and get zero.

    Parameters
    ----------
    steps, sigmas : numpy.ndarray
        (m,) rotation that each link asks for, and how well it says it knows.
    """
    largest, said, weights = 0.0, 0.0, 0.0
    # sums over the links so far of products of what they know, and of what they say and know: w w, w w s, w w s s, and
    # the same of each link with the one before
    own, own_said, own_square, pair, pair_said, pair_square = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    weight_before, step_before = 0.0, 0.0
    for k in range(len(steps)):
        step, weight = steps[k], 1 / (sigmas[k] * sigmas[k])
        said += weight * step
        weights += weight
        own += weight * weight
        own_said += weight * weight * step
        own_square += weight * weight * step * step
        both = weight * weight_before
        pair += both
        pair_said += both * (step + step_before)
        pair_square += both * step * step_before
        weight_before, step_before = weight, step
        if k + 1 < _FEWEST_STEADY:
            continue
        mean = said / weights
        square = own_square - 2 * mean * own_said + mean * mean * own
        neighbours = pair_square - mean * pair_said + mean * mean * pair
        alike = min(max(neighbours / square, 0.0), _MOST_ALIKE) if square > 0 else 0.0
        square = max(square, weights)  # no better than the links themselves say
        largest = max(largest, said * said / (square * (1 + alike) / (1 - alike)))
    return largest


@lean_kernel
def largest_sum(steps: NDArray[np.float64], sigmas: NDArray[np.float64]) -> float:
    """Largest square of the sum of the first links, over its variance.

    Parameters
    ----------
    steps, sigmas : numpy.ndarray
        (m,) what each link says, and how well it says it knows.
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
    scatter = (square + _SCATTER * _PRIOR_LINKS) / (links + _PRIOR_LINKS)
    alike = min(max(neighbours / (links * scatter), 0.0), _MOST_ALIKE)
    scatter *= (1 + alike) / (1 - alike)
    total, variance, largest = 0.0, 0.0, 0.0
    for k in range(links):
        total += steps[k]
        variance += sigmas[k] * sigmas[k] * scatter
        largest = max(largest, total * total / variance)
    return largest


class ModelSelection:
    """Gathers from link to link what rotation and scale would explain, and climbs when the evidence asks for it.

    Attributes
    ----------
    rung : MotionModel
        What is to be modelled from now on.

    Examples
    --------
    >>> climb = ModelSelection()
    >>> nothing = np.zeros((3, 6))
    >>> climb.weigh(Remainder(nothing, np.array([3e-4, 3e-4]), 1500.0)).name
    'TRANSLATION'
    >>> turned = nothing + np.array([0, 0, 0, 0, 0.01, 0])
    >>> [climb.weigh(Remainder(turned, np.array([3e-4, 3e-4]), 1500.0)).name for _ in range(2)][-1]
    'RIGID'
    """

    def __init__(self) -> None:
        self.rung = MotionModel.TRANSLATION
        self._steps, self._sigmas = np.empty((_REMEMBERED, 3)), np.empty((_REMEMBERED, 2))
        self._values = np.empty(_REMEMBERED)
        self._links = 0

    def weigh(self, found: Remainder, *, keep: bool = True) -> MotionModel:
        """Weigh a link with those before; return the rung that is asked for. It is remembered if it is to be kept.

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
        self._steps[n], self._sigmas[n], self._values[n] = _answers(found), found.sigma, found.values
        for last in _LAST:
            these = np.s_[max(0, n + 1 - last) : n + 1]
            asked = _rung(self._steps[these], self._sigmas[these], float(self._values[these].sum()))
            self.rung = max(self.rung, asked)
        self._links += keep
        return self.rung
