"""Model selection for rotation by the Bayesian information criterion, over many registrations together.

A slow rotation is significant in no single registration but in their sum, which grows faster than its uncertainty.

References
----------
Schwarz, Ann. Stat. 6, 461 (1978), doi:10.1214/aos/1176344136.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import lean_kernel, resolved_once
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


def selected_model(found: Sequence[Remainder]) -> MotionModel:
    """Return the model that the weighted mean of score tests, `found` in their order, selects at its largest.

    A probe may rotate to and fro.
    """
    if not found:
        return MotionModel.TRANSLATION
    turns, sigmas, values = np.array([(one.step[-1], one.sigma, one.values) for one in found]).T.copy()
    return MotionModel.RIGID if shows_rotation(turns, sigmas, values, 0) else MotionModel.TRANSLATION


@lean_kernel
def shows_rotation(
    turns: NDArray[np.float64], sigmas: NDArray[np.float64], values: NDArray[np.float64], first: int
) -> bool:
    """Return True if score tests, from one of them on, select a rotation.

    Parameters
    ----------
    turns, sigmas, values : numpy.ndarray
        (m,) float64: rotation by each score test, its standard deviation, and the independent values compared.
    first : int
        Of the tests from which a rotation is sought. By as much as those before scatter, these may as well: deforming
        tissue turns to and fro.
    """
    needed = 0.0
    for k in range(first, len(values)):
        needed += values[k]
    found = largest_mean(turns[first:], sigmas[first:], turns[:first], sigmas[:first])
    return bool(found > _MARGIN * np.log(needed))


@lean_kernel
def rotates(tests: NDArray[np.float64], first: int, end: int) -> bool:
    """Return True if some score tests show a rotation: the newest of them a sudden one, or all.

    Parameters
    ----------
    tests : numpy.ndarray
        (3, m) float64: what :func:`shows_rotation` takes.
    first, end : int
        The first of them that counts, and the one after the last.
    """
    turns, sigmas, values = tests[0, first:end], tests[1, first:end], tests[2, first:end]
    sudden = max(0, end - first - _SUDDEN)
    return shows_rotation(turns, sigmas, values, sudden) or shows_rotation(turns, sigmas, values, 0)


@lean_kernel
def scatter(steps: NDArray[np.float64], sigmas: NDArray[np.float64]) -> float:
    """Return the variance of the weighted mean of registrations, from how they scatter, over the stated one.

    Parameters
    ----------
    steps, sigmas : numpy.ndarray
        (m,) estimate of each registration, and its standard deviation.
    """
    total, weighted, squares, products, before = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(steps)):
        weight = 1 / (sigmas[k] * sigmas[k])
        total += weight
        weighted += weight * steps[k]
    for k in range(len(steps)):
        about = (steps[k] - weighted / total) / (sigmas[k] * sigmas[k])
        squares += about * about
        products += about * before
        before = about
    at_first = _PRIOR_LINKS * total / len(steps)
    found = (squares + _SCATTER * at_first) / (total + at_first)
    alike = min(max(products / (total * found), 0.0), _MOST_ALIKE)
    return float(found * (1 + alike) / (1 - alike))


@lean_kernel
def largest_mean(
    steps: NDArray[np.float64],
    sigmas: NDArray[np.float64],
    steps_before: NDArray[np.float64],
    sigmas_before: NDArray[np.float64],
) -> float:
    """Return the largest square of the weighted mean of the first registrations, over its variance.

    Weights are inverse variances, so that the few frames with much in view count.

    Parameters
    ----------
    steps, sigmas : numpy.ndarray
        (m,) estimate of each registration, and its standard deviation.
    steps_before, sigmas_before : numpy.ndarray
        (n,) of registrations before these, by whose scatter these may err as well.
    """
    usual = scatter(steps, sigmas)
    if len(steps_before) > 0:
        usual = max(usual, scatter(steps_before, sigmas_before))
    largest, total, weighted = 0.0, 0.0, 0.0
    for k in range(len(steps)):
        weight = 1 / (sigmas[k] * sigmas[k])
        total += weight
        weighted += weight * steps[k]
        largest = max(largest, weighted * weighted / total)
    return float(largest / usual)


_rotates = resolved_once(rotates)


class ModelSelection:
    """Sequential selection of the motion model from the score tests of registrations.

    Parameters
    ----------
    model : MotionModel
        From the beginning.

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

    def __init__(self, model: MotionModel = MotionModel.TRANSLATION) -> None:
        self.model = model
        self._found = np.zeros((3, 2 * _REMEMBERED))
        self._stored = 0

    def weigh(self, found: Remainder, *, keep: bool = True) -> MotionModel:
        """Test a registration together with those before; return the model selected. It is stored if it is to be kept.

        Parameters
        ----------
        found : Remainder
            Score test of a registration.
        keep : bool
            Add its evidence to that of the earlier ones.
        """
        tests, stored = self._found, self._stored
        tests[0, stored], tests[1, stored], tests[2, stored] = found.step[-1], found.sigma, found.values
        if _rotates(tests, max(0, stored + 1 - _REMEMBERED), stored + 1):
            self.model = MotionModel.RIGID
        if keep:
            self._stored = stored + 1
            if self._stored == len(self._found[0]):
                self._found[:, :_REMEMBERED] = self._found[:, _REMEMBERED:]
                self._stored = _REMEMBERED
        return self.model
