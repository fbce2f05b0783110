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
from napari_elsplus.processing.tracking.front_end.sampling import row_shift, sampled, scratch
from napari_elsplus.processing.tracking.motion.rolling_shutter import Warp
from napari_elsplus.processing.tracking.registration import lucas_kanade
from napari_elsplus.processing.tracking.registration.odds import CORRELATED_PX, in_pixels_of, prior_terms, write_prior
from napari_elsplus.processing.tracking.registration.row_sums import GE, MOMENTS, XX, YY

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.sampling import FramePair
    from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior

    Array = NDArray[np.float64]

EXACT_PX: Final = 0.1
"""Change of a shift by uneven motion, pixels, up to which the warp of even motion is kept; chosen: it was found at full
resolution, the change at half of it."""
_STEPS: Final = lucas_kanade.Iteration(1, 6, 0.02, False)
"""How frames are registered at half resolution."""
_UNKNOWNS: Final = lucas_kanade.TONE + 6
"""Gain and offset; then the coefficients of a row's shift by its distance from the middle: a, b and J of rows, s, d and
J of columns."""
_OF_WARP, _OF_JERK = lucas_kanade.TONE + np.array([0, 1, 3, 4]), lucas_kanade.TONE + np.array([2, 5])


def align_unevenly(pair: FramePair, motion: MotionPrior, warp: Warp, jerk_sigma: float) -> tuple[Warp, Array] | None:
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

    Returns
    -------
    warp : Warp
        Of the middle rows, pixels of full resolution.
    information : numpy.ndarray
        (4, 4) inverse covariance of a, b, s, d, whatever J is.
    """
    in_halves, stiffness = np.array([1.0, 0.5, 1.0, 0.5]), np.empty((4, 4))
    start, expected = in_pixels_of(2.0, warp), in_pixels_of(2.0, motion.warp)
    write_prior(2.0, motion.terms, prior_terms(warp, motion.warp, motion.terms)[0], stiffness)
    prior, normal = np.zeros((_UNKNOWNS, _UNKNOWNS)), np.empty((_UNKNOWNS, _UNKNOWNS))
    prior[np.ix_(_OF_WARP, _OF_WARP)] = stiffness
    prior[_OF_JERK, _OF_JERK] = 4 / jerk_sigma**2
    values, mean, right = np.zeros(_UNKNOWNS), np.zeros(_UNKNOWNS), np.empty(_UNKNOWNS)
    values[_OF_WARP], mean[_OF_WARP] = start, expected
    values[0] = mean[0] = 1.0
    square, moments = 2 / motion.line_periods_per_frame**2, np.empty((5, MOMENTS))
    samples = scratch(len(pair.image))
    for _ in range(_STEPS.steps):
        noise = CORRELATED_PX / 4 * _equations(pair, values, square, normal, right, moments, samples)
        if not noise > 0:
            return None
        try:
            step = np.linalg.solve(normal / noise + prior, right / noise + prior @ (values - mean))
        except np.linalg.LinAlgError:
            return None
        if not abs(step[_OF_WARP]).max() < len(pair.template) / 4:
            return None
        step[: lucas_kanade.TONE] *= -1  # residuals grow with the shift and lessen with gain and offset
        values -= step
        if hypot(*step[_OF_WARP[1::2]]) < _STEPS.tolerance_px:
            break
    covariance = np.linalg.inv(normal / noise + prior)[np.ix_(_OF_WARP, _OF_WARP)] / np.outer(in_halves, in_halves)
    return Warp(*(values[_OF_WARP] / in_halves).tolist()), np.linalg.inv(covariance)


@lean_kernel
def _equations(
    pair: FramePair, values: Array, square: float, normal: Array, right: Array, moments: Array,
    samples: NDArray[np.float32],
) -> float:  # fmt: skip
    """Fill the normal equations of gain, offset, a, b, J, s, d and J; return the variance of the noise.

    Parameters
    ----------
    pair : FramePair
        Frames.
    values : numpy.ndarray
        (8,) of these, in pixels of the frames.
    square : float
        Shift of a row by J = 1 over the square of its distance from the middle.
    normal, right, moments : numpy.ndarray
        (8, 8), (8,) and (5, 32), filled.
    samples : numpy.ndarray
        From :func:`~.sampling.scratch`.
    """
    moments[:] = 0.0
    pixels = 0
    a, b, jerk_down, s, d, jerk_aside = values[2], values[3], values[4], values[5], values[6], values[7]
    for row in range(1, len(pair.template) - 1):
        y = row - pair.middle
        bend = square * y * y
        warp = Warp(a, b + bend * jerk_down, s, d + bend * jerk_aside)
        above, down, whole, across, begin, end = row_shift(pair, row, warp)
        if end <= begin:
            continue
        sampled(pair.image, above, down, begin + whole, across, end - begin, samples)
        pixels += end - begin
        powers = (1.0, y, y**2, y**3, y**4)
        lucas_kanade.add_row(pair.template, row, (begin, end), samples, values, powers, None, moments)
    scales = (1.0, 1.0, square)
    lucas_kanade.write_equations(moments, float(pixels), (1, 0, 2), scales, values, None, normal, right)
    lucas_kanade.complete(normal, right, values[0])
    squares = moments[0, YY] + moments[0, XX]
    return moments[0, GE] / squares if squares > 0 else 0.0
