"""Model selection for rotation by the Bayesian information criterion, over many registrations together.

A slow rotation is significant in no single registration but in their sum, which grows faster than its uncertainty. One
that sets in is sought from every registration on, so that those before do not hide it.

References
----------
Schwarz, Ann. Stat. 6, 461 (1978), doi:10.1214/aos/1176344136.
Zhang, Siegmund, Biometrics 63, 22 (2007), doi:10.1111/j.1541-0420.2006.00662.x: the criterion with changes at unknown
places.
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
_ONSET: Final = 2.0
"""How many parameters, with the registrations as values, an unknown beginning or end is worth (Zhang & Siegmund)."""
_SCATTER: Final = 2.0
_PRIOR_LINKS: Final = 4
"""Variance of links about their mean, in units of what they say, and how many links that is worth at first."""
_MOST_ALIKE: Final = 0.95


def selected_model(found: Sequence[Remainder]) -> MotionModel:
    """Return the model that score tests, `found` in their order, select together.

    A probe may rotate for a while.
    """
    if not found:
        return MotionModel.TRANSLATION
    tests = np.array([(one.step[-1], one.sigma, one.values) for one in found]).T.copy()
    return MotionModel.RIGID if largest_saving(tests, True) > _MARGIN else MotionModel.TRANSLATION


@lean_kernel
def largest_saving(tests: NDArray[np.float64], ended: bool) -> float:
    """Return what a rotation saves at most of the sum of squares, in units of the criterion's penalty for it.

    Between its beginning and its end, which are sought, registrations have its weighted mean in common; others turn by
    nothing. By as much as all scatter about that, and from one to the next alike, the mean may err as well. Weights are
    inverse variances, so that the few frames with much in view count.

    Parameters
    ----------
    tests : numpy.ndarray
        (3, m) float64: rotation by each score test, its standard deviation, and the independent values compared.
    ended : bool
        The rotation may have ended before the last of them.
    """
    turns, sigmas, values = tests[0], tests[1], tests[2]
    count, total, squares, products, compared, before = len(turns), 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        score = turns[k] / (sigmas[k] * sigmas[k])
        total += 1 / (sigmas[k] * sigmas[k])
        squares += score * score
        products += score * before
        compared += values[k]
        before = score
    at_first = _PRIOR_LINKS * total / count
    of_rotation, of_onset = np.log(compared), _ONSET * np.log(count)
    largest = 0.0
    for end in range(1 if ended else count, count + 1):
        # sums within, and how squares and products of successive scores depend on the mean that is subtracted there
        weights, scores, square_slope, square_bend, slope, bend = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        weight, weight_after = 0.0, 0.0
        for first in range(end - 1, -1, -1):
            weight_after, weight = weight, 1 / (sigmas[first] * sigmas[first])
            score = weight * turns[first]
            weights += weight
            scores += score
            square_slope += weight * score
            square_bend += weight * weight
            if first > 0:
                slope += weight * turns[first - 1] / (sigmas[first - 1] * sigmas[first - 1])
            if first + 1 < count:
                slope += weight * turns[first + 1] / (sigmas[first + 1] * sigmas[first + 1])
            bend += weight * weight_after
            mean = scores / weights
            scatter = squares - mean * (2 * square_slope - mean * square_bend)
            scatter = (scatter + _SCATTER * at_first) / (total + at_first)
            alike = min(max((products - mean * (slope - mean * bend)) / (total * scatter), 0.0), _MOST_ALIKE)
            penalty = of_rotation
            if first > 0:
                penalty += of_onset
            if end < count:
                penalty += of_onset
            largest = max(largest, scores * mean * (1 - alike) / (scatter * (1 + alike) * penalty))
    return float(largest)


_largest_saving = resolved_once(largest_saving)


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
    >>> selection.weigh(turned).name
    'RIGID'
    """

    def __init__(self, model: MotionModel = MotionModel.TRANSLATION) -> None:
        self.model = model
        self._found = np.zeros((3, _REMEMBERED))
        self._first = _REMEMBERED - 1

    def weigh(self, found: Remainder, *, keep: bool = True) -> MotionModel:
        """Test a registration together with those before; return the model selected. It is stored if it is to be kept.

        Parameters
        ----------
        found : Remainder
            Score test of a registration.
        keep : bool
            Add its evidence to that of the earlier ones.
        """
        tests = self._found
        tests[0, -1], tests[1, -1], tests[2, -1] = found.step[-1], found.sigma, found.values
        if _largest_saving(tests[:, self._first :], False) > _MARGIN:
            self.model = MotionModel.RIGID
        if keep:
            tests[:, :-1] = tests[:, 1:]
            self._first = max(self._first - 1, 0)
        return self.model
