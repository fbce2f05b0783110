"""Uneven motion within two registered frames: what a change of the acceleration adds to the rolling shutter's warp.

The warp is exact while the acceleration is steady. If it changes by J pixels per squared frame period from one frame
to the other, rows y pixels from the middle are shifted by J (y / R)^2 / 2 besides, R rows being one frame period. Two
further columns of the normal equations estimate J under its prior; the warp is then that of the middle rows.
"""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import lean_kernel
from napari_elsplus.processing.tracking.front_end.sampling import bilinear, neighbours, row_shift
from napari_elsplus.processing.tracking.motion.rolling_shutter import Warp
from napari_elsplus.processing.tracking.registration.lucas_kanade import Iteration, add_row, tone_between
from napari_elsplus.processing.tracking.registration.odds import prior_terms, write_prior

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.sampling import FramePair
    from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior

    Array = NDArray[np.float64]

EXACT_PX: Final = 0.1
"""Change of a shift by uneven motion, pixels, up to which the warp of even motion is kept; chosen: it was found at full
resolution, the change at half of it."""
_STEPS: Final = Iteration(1, 6, 0.02, False, 4)
"""How frames are registered at half resolution."""
_POWERS: Final = 3
_UNKNOWNS: Final = 2 * _POWERS + 2
"""Coefficients of a row's shift by its distance from the middle: b, a and J of rows, d, s and J of columns; and with
gain and offset."""


def align_unevenly(
    pair: FramePair, motion: MotionPrior, warp: Warp, jerk_sigma: float, correlated_px: float
) -> tuple[Warp, Array] | None:
    """Refine a warp from frames at half resolution, J estimated besides; None where they do not constrain it.

    Parameters
    ----------
    pair : FramePair
        Frames at half resolution.
    motion : MotionPrior
        Of the motion between them.
    warp : Warp
        That they were registered by, pixels of full resolution.
    jerk_sigma : float
        Standard deviation of the prior of J in each axis, pixels of full resolution per squared frame period.
    correlated_px : float
        Pixels at half resolution that share one noise value.

    Returns
    -------
    warp : Warp
        Of the middle rows, pixels of full resolution.
    information : numpy.ndarray
        (4, 4) inverse covariance of a, b, s, d, whatever J is.
    """
    of_warp, of_jerk = np.array([1, 0, 1 + _POWERS, _POWERS]), np.array([2, 2 + _POWERS])
    in_halves, stiffness = np.array([1.0, 0.5, 1.0, 0.5]), np.empty((4, 4))
    start, expected = np.array(warp) * in_halves, np.array(motion.warp) * in_halves
    write_prior(2.0, motion.terms, prior_terms(np.array(warp), np.array(motion.warp), motion.terms)[0], stiffness)
    prior, normal = np.zeros((_UNKNOWNS, _UNKNOWNS)), np.empty((_UNKNOWNS, _UNKNOWNS))
    prior[np.ix_(of_warp, of_warp)] = stiffness
    prior[of_jerk, of_jerk] = 4 / jerk_sigma**2
    values, mean, right, scratch = np.zeros(_UNKNOWNS), np.zeros(_UNKNOWNS), np.empty(_UNKNOWNS), np.empty(4)
    values[of_warp], mean[of_warp] = start, expected
    values[-2:] = mean[-2:] = tone_between(pair, start, _STEPS.tone_step)
    square = 2 / motion.line_periods_per_frame**2
    for _ in range(_STEPS.steps):
        noise = correlated_px * _equations(pair, values, square, normal, right, scratch)
        if not noise > 0:
            return None
        try:
            step = np.linalg.solve(normal / noise + prior, right / noise + prior @ (values - mean))
        except np.linalg.LinAlgError:
            return None
        if not abs(step[of_warp]).max() < len(pair.template) / 4:
            return None
        step[-2:] *= -1  # residuals grow with the shift and lessen with gain and offset
        values -= step
        if hypot(step[0], step[_POWERS]) < _STEPS.tolerance_px:
            break
    covariance = np.linalg.inv(normal / noise + prior)[np.ix_(of_warp, of_warp)] / np.outer(in_halves, in_halves)
    return Warp(*(values[of_warp] / in_halves).tolist()), np.linalg.inv(covariance)


@lean_kernel
def _equations(pair: FramePair, values: Array, square: float, normal: Array, right: Array, warp: Array) -> float:
    """Fill the normal equations of b, a, J, d, s, J, gain and offset; return the variance of the noise.

    Parameters
    ----------
    pair : FramePair
        Frames.
    values : numpy.ndarray
        (8,) of these, in pixels of the frames.
    square : float
        Shift of a row by J = 1 over the square of its distance from the middle.
    normal, right : numpy.ndarray
        (8, 8) and (8,), filled.
    warp : numpy.ndarray
        (4,) scratch.
    """
    normal[:] = 0.0
    right[:] = 0.0
    tone, steep, noise = values[6:], 0.0, 0.0
    for row in range(1, len(pair.template) - 1):
        y = row - pair.middle
        bend = square * y * y
        warp[0], warp[1] = values[1], values[0] + bend * values[2]
        warp[2], warp[3] = values[4], values[3] + bend * values[5]
        above, down, whole, across, begin, end = row_shift(pair, row, warp)
        if end <= begin:
            continue
        corners = neighbours(pair.image, above, begin + whole, end - begin)
        _, _, _, gradients, weighted = add_row(
            pair.template, row, (begin, end), corners, bilinear(down, across), tone, (1.0, y, bend), normal, right
        )
        steep += gradients
        noise += weighted
    for i in range(2 * _POWERS):
        right[i] *= tone[0]
        for k in range(_UNKNOWNS):
            normal[i, k] *= tone[0] ** 2 if k < 2 * _POWERS else tone[0]
    for i in range(_UNKNOWNS):
        for k in range(i):
            normal[i, k] = normal[k, i]
    return noise / steep if steep > 0 else 0.0
