"""Model selection for rotation by the Bayesian information criterion, over many registrations together.

A slow rotation is significant in no single registration but in their sum, which grows faster than its uncertainty.

References
----------
Schwarz, Ann. Stat. 6, 461 (1978), doi:10.1214/aos/1176344136.
"""

from __future__ import annotations

from math import log
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import kernel
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel, Remainder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_MARGIN: Final = 2.0
"""How many times the criterion's penalty must be saved: it is tested again and again in a long recording."""
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


def selected_model(found: Sequence[Remainder], before: Sequence[Remainder] = ()) -> MotionModel:
    """Return the model that the sum of score tests selects, at its largest: a probe may rotate to and fro.

    Parameters
    ----------
    found : sequence of Remainder
        Score tests of registrations in their order.
    before : sequence of Remainder
        Of registrations before these: by as much as they scatter, these may as well. Deforming tissue turns to and fro.
    """
    if not found:
        return MotionModel.TRANSLATION
    turns, sigmas = np.array([(one.step[-1], one.sigma) for one in found]).T.copy()
    turns_before, sigmas_before = np.array([(one.step[-1], one.sigma) for one in before]).reshape(-1, 2).T.copy()
    statistic = max(largest_sum(turns, sigmas, turns_before, sigmas_before), steady_turn(turns, sigmas))
    needed = _MARGIN * log(sum(one.values for one in found))
    return MotionModel.RIGID if statistic > needed else MotionModel.TRANSLATION


@kernel
def steady_turn(steps: NDArray[np.float64], sigmas: NDArray[np.float64]) -> float:
    """Return the largest square of the weighted mean of the first registrations, over its variance.

    Weights are inverse variances, so that the few frames with much in view count. Zero below sixteen, from which the
    scatter cannot be estimated.

    Parameters
    ----------
    steps, sigmas : numpy.ndarray
        (m,) rotation by each score test, and its standard deviation.
    """
    if len(steps) < _FEWEST_STEADY:
        return 0.0
    weights = 1 / (sigmas * sigmas)
    weighted, total = np.cumsum(weights * steps), np.cumsum(weights)
    largest = 0.0
    for count in range(_FEWEST_STEADY, len(steps) + 1):
        about = weights[:count] * (steps[:count] - weighted[count - 1] / total[count - 1])
        square = max((about * about).sum(), total[count - 1])  # no better than stated
        alike = min(max((about[1:] * about[:-1]).sum() / square, 0.0), _MOST_ALIKE)
        largest = max(largest, weighted[count - 1] ** 2 / (square * (1 + alike) / (1 - alike)))
    return largest


@kernel
def scatter(steps: NDArray[np.float64], sigmas: NDArray[np.float64]) -> float:
    """Return the variance of registrations about their mean over the stated one, as that of a sum of them counts.

    Parameters
    ----------
    steps, sigmas : numpy.ndarray
        (m,) estimate of each registration, and its standard deviation.
    """
    links = len(steps)
    about = steps / sigmas
    about -= about.mean()
    found = ((about * about).sum() + _SCATTER * _PRIOR_LINKS) / (links + _PRIOR_LINKS)
    alike = min(max((about[1:] * about[:-1]).sum() / (links * found), 0.0), _MOST_ALIKE)
    return float(found * (1 + alike) / (1 - alike))


@kernel
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
    usual = scatter(steps, sigmas)
    if len(steps_before):
        usual = max(usual, scatter(steps_before, sigmas_before))
    return float((np.cumsum(steps) ** 2 / np.cumsum(sigmas * sigmas)).max() / usual)


class ModelSelection:
    """Sequential selection of the motion model from the score tests of registrations.

    Attributes
    ----------
    model : MotionModel
        Model of the motion from now on.

    Examples
    --------
    >>> selection = ModelSelection()
    >>> selection.weigh(Remainder(np.zeros(5), 3e-4, 1500.0)).name
    'TRANSLATION'
    >>> turned = Remainder(np.array([0, 0, 0, 0, 0.01]), 3e-4, 1500.0)
    >>> [selection.weigh(turned).name for _ in range(3)]
    ['TRANSLATION', 'TRANSLATION', 'RIGID']
    """

    def __init__(self) -> None:
        self.model = MotionModel.TRANSLATION
        self._found: list[Remainder] = []

    def weigh(self, found: Remainder, *, keep: bool = True) -> MotionModel:
        """Test a registration together with those before; return the model selected. It is stored if it is to be kept.

        Parameters
        ----------
        found : Remainder
            Score test of a registration.
        keep : bool
            Add its evidence to that of the earlier ones.
        """
        every = [*self._found[1 - _REMEMBERED :], found]
        for first in (max(0, len(every) - _SUDDEN), 0):
            self.model = max(self.model, selected_model(every[first:], every[:first]))
        if keep:
            self._found = every
        return self.model
