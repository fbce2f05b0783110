"""Registration of two frames to a hundredth of a pixel by inverse-compositional Lucas-Kanade.

The model is the rolling shutter's warp (``motion.rolling_shutter``): rows stretched, columns
sheared. Differences of gain and offset between the frames are projected out.

References
----------
Baker and Matthews, Int. J. Comput. Vis. 56, 221 (2004), doi:10.1023/B:VISI.0000011205.11775.fd.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from napari_elsplus.processing.compiled import lean_kernel
from napari_elsplus.processing.tracking.front_end.sampling import (
    between,
    bilinear,
    finely_sampled,
    neighbours,
    reaches,
    row_shift,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.sampling import FramePair

    Array = NDArray[np.float64]

PARAMETERS = 4
"""a, b, s, d of the warp."""
UNKNOWNS = PARAMETERS + 2
"""These, and the gain and offset between the frames."""
NOISE_GRADIENT = 0.6
"""Mean squared gradient of noise over its variance, 1 / px^2; derived for noise smoothed by 1 4 6 4 1."""
MIN_SHARED = 0.1
"""Part of the squared gradient that frames of noise alone share; chosen: their shifts are then uncertain by pixels."""


class Iteration(NamedTuple):
    """How :func:`align` iterates.

    Parameters
    ----------
    row_step : int
        Every how many rows are used.
    steps : int
        Largest number of Gauss-Newton steps.
    tolerance_px : float
        A step that moves no pixel farther than this is the last.
    finely : bool
        True to sample the image through six by six pixels, else between four.
    tone_step : int
        Every how many rows gain and offset are estimated from to start with; steps refine them.
    """

    row_step: int
    steps: int
    tolerance_px: float
    finely: bool
    tone_step: int


class Workspace(NamedTuple):
    """Scratch of :func:`align` and of what is built on it; one for each thread.

    Parameters
    ----------
    equations : numpy.ndarray
        (7, 6, 6) float64; align uses the first three: normal equations of warp, gain and offset, right sides, a copy.
    samples : numpy.ndarray
        (2, n) float32, as wide as the frames.
    tone : numpy.ndarray
        (3,) float64: gain and offset of the image against the template by regression; and the ratio of their standard
        deviations, which noise does not dilute.
    """

    equations: Array
    samples: NDArray[np.float32]
    tone: Array

    @classmethod
    def of(cls, side: int) -> Workspace:
        """Return one for frames of so many rows and columns, `side`."""
        return cls(np.zeros((7, UNKNOWNS, UNKNOWNS)), np.zeros((2, side), np.float32), np.array([1.0, 0.0, 1.0]))


@lean_kernel
def tone_between(pair: FramePair, warp: Array, row_step: int) -> tuple[float, float]:
    """Estimate gain and offset of an image against a template by regression, from some rows and the nearest pixels.

    1 and 0 where the template is even.

    Parameters
    ----------
    pair : FramePair
        Frames that are compared.
    warp : numpy.ndarray
        (4,) a, b, s, d.
    row_step : int
        Every how many rows are used.
    """
    template, image = pair.template, pair.image
    count, t1, i1, tt, ti = 0.0, 0.0, 0.0, 0.0, 0.0
    for row in range(1, len(template) - 1, row_step):
        above, down, whole, across, begin, end = row_shift(pair, row, warp)
        nearest, aside = above + int(down + 0.5), whole + int(across + 0.5)
        here, there = template[row, begin:end], image[nearest, begin + aside : end + aside]
        for k in range(end - begin):
            t, i = here[k], there[k]
            t1 += t
            i1 += i
            tt += t * t
            ti += t * i
        count += end - begin
    spread = tt * count - t1 * t1
    if not spread > 0:
        return 1.0, 0.0
    gain = (ti * count - t1 * i1) / spread
    return gain, (i1 - gain * t1) / count


@lean_kernel
def accumulate(
    pair: FramePair, warp: Array, row_step: int, finely: bool, work: Workspace
) -> tuple[float, float, float, float, float]:
    """Fill the normal equations of a step, the first of the workspace.

    Returns the number of pixels; the variances of template and image and their covariance, times that number; and the
    mean squared difference between the frames, weighted by the squared gradient: noise counts where structure is.

    Parameters
    ----------
    pair : FramePair
        Frames that are compared.
    warp : numpy.ndarray
        (4,) a, b, s, d.
    row_step, finely
        As of :class:`Iteration`.
    work : Workspace
        With gain and offset of the image against the template.
    """
    template, image, middle = pair.template, pair.image, pair.middle
    normal, right, tone = work.equations[0], work.equations[1, 0], work.tone
    normal[:] = 0.0
    right[:] = 0.0
    sum_i, sum_ii, sum_ti, steep, noise_level = 0.0, 0.0, 0.0, 0.0, 0.0
    for row in range(1, len(template) - 1, row_step):
        above, down, whole, across, begin, end = row_shift(pair, row, warp)
        if end <= begin:
            continue
        size = end - begin
        if finely and reaches(image.shape, above, begin + whole, size):
            corners, weights = finely_sampled(image, above, down, begin + whole, across, size, work.samples)
        else:
            corners, weights = neighbours(image, above, begin + whole, size), bilinear(down, across)
        i1, ii, ti, gradients, weighted = add_row(
            template, row, (begin, end), corners, weights, tone, (row - middle, 1.0), normal, right
        )
        sum_i += i1
        sum_ii += ii
        sum_ti += ti
        steep += gradients
        noise_level += weighted
    for m in range(UNKNOWNS):
        for n in range(m):
            normal[m, n] = normal[n, m]
    sum_tt, sum_t, count = normal[4, 4], normal[4, 5], normal[5, 5]
    if count == 0 or steep == 0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    return (
        count,
        sum_tt - sum_t * sum_t / count,
        sum_ii - sum_i * sum_i / count,
        sum_ti - sum_t * sum_i / count,
        noise_level / steep,
    )


@lean_kernel
def add_row(
    template: NDArray[np.float32], row: int, columns: tuple[int, int], corners: tuple[NDArray[np.float32], ...],
    weights: tuple[np.float32, ...], tone: Array, powers: tuple[float, ...], normal: Array,
    right: Array,
) -> tuple[float, ...]:  # fmt: skip
    """Add a row of the template, and what it is compared with, to normal equations.

    Returns sums over its pixels: of the image i, i i, and i times the template; of the squared gradient, and of that
    times the squared residual.

    Parameters
    ----------
    template : numpy.ndarray
        (n, n) float32: the earlier frame.
    row : int
        Row of the template.
    columns : tuple of int
        First column and the one after the last.
    corners, weights : tuple
        Give samples of the image by :func:`~.sampling.between`.
    tone : numpy.ndarray
        Gain and offset of the image against the template.
    powers : tuple of float
        (m,) derivatives of the row's shift by the m coefficients that each axis has.
    normal, right : numpy.ndarray
        (2 m + 2, 2 m + 2) and (2 m + 2,) for the coefficients of rows, those of columns, gain and offset; rows of
        gain and offset from the diagonal on.
    """
    begin, end = columns
    gain, offset, half, zero = np.float32(tone[0]), np.float32(tone[1]), np.float32(0.5), np.float32(0)
    here, over, under = template[row, begin:end], template[row - 1, begin:end], template[row + 1, begin:end]
    left, right_of = template[row, begin - 1 : end - 1], template[row, begin + 1 : end + 1]
    t1, i1, tt, ti, ii = zero, zero, zero, zero, zero
    y1, x1, yy, yx, xx, yt, xt, ye, xe, gg = zero, zero, zero, zero, zero, zero, zero, zero, zero, zero
    for k in range(end - begin):
        t, gx, gy = here[k], half * (right_of[k] - left[k]), half * (under[k] - over[k])
        i = between(corners, weights, k)
        e = i - gain * t - offset
        t1 += t
        i1 += i
        tt += t * t
        ti += t * i
        ii += i * i
        y1 += gy
        x1 += gx
        yy += gy * gy
        yx += gy * gx
        xx += gx * gx
        yt += gy * t
        xt += gx * t
        ye += gy * e
        xe += gx * e
        gg += (gy * gy + gx * gx) * e * e
    gradients, both, with_tone, with_residual = ((yy, yx), (yx, xx)), (y1, x1), (yt, xt), (ye, xe)
    size = len(powers)
    for m in range(2):
        for p in range(size):
            at = size * m + p
            for n in range(2):
                for q in range(size):
                    normal[at, size * n + q] += powers[p] * powers[q] * gradients[m][n]
            normal[at, 2 * size] += powers[p] * with_tone[m]
            normal[at, 2 * size + 1] += powers[p] * both[m]
            right[at] += powers[p] * with_residual[m]
    of_gain = 2 * size
    normal[of_gain, of_gain] += float(tt)
    normal[of_gain, of_gain + 1] += float(t1)
    normal[of_gain + 1, of_gain + 1] += end - begin
    right[of_gain] += float(ti) - tone[0] * float(tt) - tone[1] * float(t1)
    right[of_gain + 1] += float(i1) - tone[0] * float(t1) - tone[1] * (end - begin)
    return float(i1), float(ii), float(ti), float(yy) + float(xx), float(gg)


@lean_kernel
def align(
    pair: FramePair, how: Iteration, expected: Array, stiffness: Array, correlated_px: float, warp: Array,
    information: Array, work: Workspace,
) -> tuple[float, float]:  # fmt: skip
    """Refine a warp in place; fill its information matrix; return correlation and number of pixels of the overlap.

    Parameters
    ----------
    pair : FramePair
        Frames that are compared.
    how : Iteration
        How often, and of which rows.
    expected, stiffness : numpy.ndarray
        (4,) and (4, 4) float64, or larger: prior mean of the warp, and its information; zero leaves a
        parameter free.
    correlated_px : float
        Number of pixels that share one independent noise value: scales the information.
    warp : numpy.ndarray
        (4,) float64: a, b, s, d; where to start, and the result.
    information : numpy.ndarray
        (4, 4) float64: inverse covariance of the result, the prior included.
    work : Workspace
        For frames of this size or larger; its gain and offset are where to start, and refined.

    Returns
    -------
    float
        Zero-mean normalised correlation just before the last step; 0 where there is no overlap or no structure.
    float
        Number of pixels in it.
    """
    normal, right, tone = work.equations[0], work.equations[1, 0], work.tone
    ncc, count = 0.0, 0.0
    information[:] = 0.0
    for _ in range(how.steps):
        count, template_sum, image_sum, both, noise = accumulate(pair, warp, how.row_step, how.finely, work)
        if not (template_sum > 0 and image_sum > 0):
            return 0.0, count
        ncc = both / np.sqrt(template_sum * image_sum)
        noise = max(noise, 1e-6 * image_sum / count) * correlated_px
        if how.finely:
            # noise adds to the gradient of the template: what both frames share of it is information
            shared = 1 - NOISE_GRADIENT * (1 - ncc) * template_sum / (normal[1, 1] + normal[3, 3])
            noise /= max(shared, MIN_SHARED) ** 2
        # a pixel of motion changes the image by the template's gradient times the gain
        gain = tone[2] = np.sqrt(image_sum / template_sum)
        scale_by_gain(normal, right, gain)
        for i in range(PARAMETERS):
            for k in range(PARAMETERS):
                normal[i, k] += stiffness[i, k] * noise
                right[i] += stiffness[i, k] * noise * (warp[k] - expected[k])
        if not solve(normal, right, work.equations[2]):
            return 0.0, count
        da, db, ds, dd = right[0], right[1], right[2], right[3]
        if abs(da) > 0.2 or abs(ds) > 0.2:
            return 0.0, count
        s = (warp[2] - ds) / (1 + da)
        a = warp[0] / (1 + da)
        warp[1] -= a * db
        warp[3] -= dd + s * db
        warp[0], warp[2] = a, s
        tone[0] += right[PARAMETERS]
        tone[1] += right[PARAMETERS + 1]
        # information on the warp once gain and offset are eliminated: the Schur complement, left by the elimination
        for i in range(PARAMETERS):
            for k in range(PARAMETERS):
                information[i, k] = normal[i, k] / noise
        if abs(db) + abs(dd) + (abs(da) + abs(ds)) * 0.5 * len(pair.first) < how.tolerance_px:
            break
    return ncc, count


@lean_kernel
def scale_by_gain(normal: Array, right: Array, gain: float) -> None:
    """Multiply the derivatives by the warp in normal equations, which are the template's, by the gain of the image.

    Parameters
    ----------
    normal, right : numpy.ndarray
        As of :func:`accumulate`.
    gain : float
        Ratio of the frames' standard deviations.
    """
    for i in range(PARAMETERS):
        right[i] *= gain
        for k in range(PARAMETERS):
            normal[i, k] *= gain * gain
        for k in range(PARAMETERS, UNKNOWNS):
            normal[i, k] *= gain
            normal[k, i] *= gain


@lean_kernel
def solve(normal: Array, right: Array, rest: Array) -> bool:
    """Solve symmetric equations in place, gain and offset first; leave the warp's Schur complement in `normal`.

    `rest` is scratch of the size of `normal`.

    Parameters
    ----------
    normal : numpy.ndarray
        (n, n) float64; left with the Schur complement of the warp.
    right : numpy.ndarray
        (n,) float64; the solution in return.
    rest : numpy.ndarray
        (n, n) float64 scratch.
    """
    size = len(right)
    for pivot in range(size - 1, PARAMETERS - 1, -1):
        p = normal[pivot, pivot]
        if not p > 0:
            return False
        for i in range(pivot):
            f = normal[i, pivot] / p
            for k in range(pivot):
                normal[i, k] -= f * normal[pivot, k]
            right[i] -= f * right[pivot]
    for i in range(PARAMETERS):
        for k in range(PARAMETERS):
            rest[i, k] = normal[i, k]
    for pivot in range(PARAMETERS):
        p = rest[pivot, pivot]
        if not p > 1e-9 * normal[pivot, pivot]:
            return False
        for i in range(pivot + 1, PARAMETERS):
            f = rest[i, pivot] / p
            for k in range(pivot, PARAMETERS):
                rest[i, k] -= f * rest[pivot, k]
            right[i] -= f * right[pivot]
    for i in range(PARAMETERS - 1, -1, -1):
        for k in range(i + 1, PARAMETERS):
            right[i] -= rest[i, k] * right[k]
        right[i] /= rest[i, i]
    for i in range(PARAMETERS, size):
        for k in range(i):
            right[i] -= normal[i, k] * right[k]
        right[i] /= normal[i, i]
    return True
