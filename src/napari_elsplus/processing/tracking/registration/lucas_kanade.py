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

from napari_elsplus.processing.compiled import compilable, lean_kernel
from napari_elsplus.processing.tracking.front_end import sampling
from napari_elsplus.processing.tracking.motion.rolling_shutter import Warp

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.sampling import FramePair

    Array = NDArray[np.float64]

TONE = 2
"""Gain and offset between the frames: the first unknowns of all normal equations."""
PARAMETERS = 4
"""a, b, s, d of the warp: the next ones."""
UNKNOWNS = TONE + PARAMETERS
"""Both together; a rotation and a stretch of the columns, where they are estimated, are the next."""
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
    """

    row_step: int
    steps: int
    tolerance_px: float
    finely: bool


class Workspace(NamedTuple):
    """Scratch of :func:`align` and of what is built on it; one for each thread.

    Parameters
    ----------
    normal, right : numpy.ndarray
        (8, 8) and (8,) float64: normal equations of gain, offset and warp; of rotation and stretch as well in the score
        test of rotation.
    tone : numpy.ndarray
        (2,) float64: gain and offset of the image against the template.
    stiffness, schur : numpy.ndarray
        (4, 4) float64: information of the prior of a warp; what :func:`solve` leaves of the equations of a warp that is
        not kept.
    sums : numpy.ndarray
        (5,) float64: of :func:`add_row`.
    samples : numpy.ndarray
        (2, n) float32, as wide as the frames.
    """

    normal: Array
    right: Array
    tone: Array
    stiffness: Array
    schur: Array
    sums: Array
    samples: NDArray[np.float32]

    @classmethod
    def of(cls, side: int) -> Workspace:
        """Return one for frames of so many rows and columns, `side`."""
        stiffness, schur = np.zeros((2, PARAMETERS, PARAMETERS))
        normal, right = np.zeros((UNKNOWNS + 2, UNKNOWNS + 2)), np.zeros(UNKNOWNS + 2)
        return cls(normal, right, np.array([1.0, 0.0]), stiffness, schur, np.zeros(5), np.zeros((2, side), np.float32))


@lean_kernel
def accumulate(
    pair: FramePair, how: Iteration, warp: Warp, work: Workspace, column: float | None
) -> tuple[float, float, float, float, float]:
    """Fill the normal equations of a step, to be completed by :func:`complete`.

    Returns the number of pixels; the variances of template and image and their covariance, times that number; and the
    mean squared difference between the frames, weighted by the squared gradient: noise counts where structure is.

    Parameters
    ----------
    pair : FramePair
        Frames that are compared.
    how : Iteration
        Which rows, and how they are sampled.
    warp : Warp
        From the template to the image.
    work : Workspace
        With gain and offset of the image against the template.
    column : float or None
        Column of the bundle's centre, if equations of a rotation about it and of a stretch of the columns are to be the
        last ones. For None the kernel is compiled without them.
    """
    template, image, middle = pair.template, pair.image, pair.middle
    normal, right, sums = work.normal, work.right, work.sums
    normal[:] = 0.0
    right[:] = 0.0
    sums[:] = 0.0
    for row in range(1, len(template) - 1, how.row_step):
        above, down, whole, across, begin, end = sampling.row_shift(pair, row, warp)
        if end <= begin:
            continue
        size = end - begin
        if how.finely and sampling.reaches(image.shape, above, begin + whole, size):
            corners, weights = sampling.finely_sampled(image, above, down, begin + whole, across, size, work.samples)
        else:
            corners, weights = sampling.bilinear(image, above, down, begin + whole, across, size)
        powers = (row - middle, 1.0)
        add_row(template, row, (begin, end), corners, weights, work.tone, powers, column, normal, right, sums)
    sum_tt, sum_t, count = normal[0, 0], normal[1, 0], normal[1, 1]
    if count == 0 or sums[3] == 0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    variances = sum_tt - sum_t * sum_t / count, sums[1] - sums[0] * sums[0] / count
    return count, *variances, sums[2] - sum_t * sums[0] / count, sums[4] / sums[3]


@compilable
def add_row(
    template: NDArray[np.float32], row: int, columns: tuple[int, int], corners: tuple[NDArray[np.float32], ...],
    weights: tuple[np.float32, ...], tone: Array, powers: tuple[float, ...], column: float | None, normal: Array,
    right: Array, sums: Array,
) -> None:  # fmt: skip
    """Add a row of the template, and what it is compared with, to normal equations.

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
    column
        As of :func:`accumulate`.
    normal, right : numpy.ndarray
        (2 m + 2, 2 m + 2) and (2 m + 2,), or larger, for gain, offset, the coefficients of rows and those of columns;
        columns of gain and offset from the diagonal on.
    sums : numpy.ndarray
        (5,), for sums over pixels: of the image i, i i, and i times the template; of the squared gradient, and of that
        times the squared residual.
    """
    begin, end = columns
    gain, offset, half, zero = np.float32(tone[0]), np.float32(tone[1]), np.float32(0.5), np.float32(0)
    here, over, under = template[row, begin:end], template[row - 1, begin:end], template[row + 1, begin:end]
    left, right_of = template[row, begin - 1 : end - 1], template[row, begin + 1 : end + 1]
    t1, i1, tt, ti, ii = zero, zero, zero, zero, zero
    y1, x1, yy, yx, xx, yt, xt, ye, xe, gg = zero, zero, zero, zero, zero, zero, zero, zero, zero, zero
    w1, ww, wy, wx, wt, we, x0 = zero, zero, zero, zero, zero, zero, zero
    u1, uu, ux, uw, ut, ue = zero, zero, zero, zero, zero, zero
    if column is not None:
        x0 = np.float32(begin - column)
    for k in range(end - begin):
        t, gx, gy = here[k], half * (right_of[k] - left[k]), half * (under[k] - over[k])
        i = sampling.between(corners, weights, k)
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
        if column is not None:
            x = x0 + np.float32(np.int32(k))
            w, u = x * gy, x * gx
            w1 += w
            ww += w * w
            wy += w * gy
            wx += w * gx
            wt += w * t
            we += w * e
            u1 += u
            uu += u * u
            ux += u * gx
            uw += u * w
            ut += u * t
            ue += u * e
    gradients, both, with_tone, with_residual = ((yy, yx), (yx, xx)), (y1, x1), (yt, xt), (ye, xe)
    size = len(powers)
    for m in range(2):
        for p in range(size):
            at = TONE + size * m + p
            for n in range(2):
                for q in range(size):
                    normal[at, TONE + size * n + q] += powers[p] * powers[q] * gradients[m][n]
            normal[at, 0] += powers[p] * with_tone[m]
            normal[at, 1] += powers[p] * both[m]
            right[at] += powers[p] * with_residual[m]
    if column is not None:
        turn, stretch = TONE + 2 * size, TONE + 2 * size + 1
        for at, of_1, of_t, of_y, of_x, of_e in ((turn, w1, wt, wy, wx, we), (stretch, u1, ut, wx, ux, ue)):
            normal[at, 0] += of_t
            normal[at, 1] += of_1
            for p in range(size):
                normal[at, TONE + p] += powers[p] * of_y
                normal[at, TONE + size + p] += powers[p] * of_x
            right[at] += of_e
        normal[turn, turn] += ww
        normal[stretch, turn] += uw
        normal[stretch, stretch] += uu
    normal[0, 0] += float(tt)
    normal[1, 0] += float(t1)
    normal[1, 1] += end - begin
    right[0] += float(ti) - tone[0] * float(tt) - tone[1] * float(t1)
    right[1] += float(i1) - tone[0] * float(t1) - tone[1] * (end - begin)
    for n, total in enumerate((float(i1), float(ii), float(ti), float(yy) + float(xx), float(gg))):
        sums[n] += total


@compilable
def align(
    pair: FramePair, how: Iteration, expected: Warp, stiffness: Array, correlated_px: float, warp: Warp,
    information: Array, work: Workspace,
) -> tuple[float, float, Warp]:  # fmt: skip
    """Refine a warp; fill its information matrix.

    Parameters
    ----------
    pair : FramePair
        Frames that are compared.
    how : Iteration
        How often, and of which rows.
    expected, stiffness : Warp, numpy.ndarray
        Prior mean of the warp, and its (4, 4) float64 information; zero leaves a parameter free.
    correlated_px : float
        Number of pixels that share one independent noise value: scales the information.
    warp : Warp
        Where to start.
    information : numpy.ndarray
        (4, 4) float64, filled: inverse covariance of the result, the prior included.
    work : Workspace
        For frames of this size or larger; its gain and offset are where to start, and refined.

    Returns
    -------
    float
        Zero-mean normalised correlation just before the last step; 0 where there is no overlap or no structure.
    float
        Number of pixels of the overlap.
    Warp
        The result.
    """
    normal, right, tone = work.normal, work.right[:UNKNOWNS], work.tone
    ncc, count = 0.0, 0.0
    information[:] = 0.0
    for _ in range(how.steps):
        count, template_sum, image_sum, both, noise = accumulate(pair, how, warp, work, None)
        if not (template_sum > 0 and image_sum > 0):
            return 0.0, count, warp
        ncc = both / np.sqrt(template_sum * image_sum)
        noise = max(noise, 1e-6 * image_sum / count) * correlated_px
        if how.finely:
            # noise adds to the gradient of the template: what both frames share of it is information
            shared = 1 - NOISE_GRADIENT * (1 - ncc) * template_sum / (normal[3, 3] + normal[5, 5])
            noise /= max(shared, MIN_SHARED) ** 2
        # a pixel of motion changes the image by the template's gradient times the gain
        complete(normal, right, np.sqrt(image_sum / template_sum))
        for i in range(PARAMETERS):
            for k in range(PARAMETERS):
                normal[TONE + i, TONE + k] += stiffness[i, k] * noise
                right[TONE + i] += stiffness[i, k] * noise * (warp[k] - expected[k])
        if not solve(normal, right, TONE, information):
            return 0.0, count, warp
        da, db, ds, dd = right[2], right[3], right[4], right[5]
        if abs(da) > 0.2 or abs(ds) > 0.2:
            return 0.0, count, warp
        a, s = warp.a / (1 + da), (warp.s - ds) / (1 + da)
        warp = Warp(a, warp.b - a * db, s, warp.d - dd - s * db)
        tone[0] += right[0]
        tone[1] += right[1]
        information /= noise
        if abs(db) + abs(dd) + (abs(da) + abs(ds)) * 0.5 * len(pair.first) < how.tolerance_px:
            break
    return ncc, count, warp


@lean_kernel
def complete(normal: Array, right: Array, gain: float) -> None:
    """Multiply the derivatives by motion in normal equations, which are the template's, by the gain of the image.

    Parameters
    ----------
    normal, right : numpy.ndarray
        (n, n), or larger, and (n,) float64: gain and offset, then motion. What stands above the diagonal is filled.
    gain : float
        Ratio of the frames' standard deviations.
    """
    for i in range(len(right)):
        of_row = gain if i >= TONE else 1.0
        right[i] *= of_row
        for k in range(i + 1):
            normal[i, k] *= of_row * (gain if k >= TONE else 1.0)
            normal[k, i] = normal[i, k]


@lean_kernel
def solve(normal: Array, right: Array, begin: int, schur: Array) -> bool:
    """Solve symmetric equations in place by elimination of the first unknown, the second, and so on.

    Returns False where they constrain an unknown too little.

    Parameters
    ----------
    normal : numpy.ndarray
        (n, n) float64, or larger; each row is left as it was when its unknown was eliminated.
    right : numpy.ndarray
        (n,) float64; the solution in return.
    begin : int
        The unknown from which on a warp stands.
    schur : numpy.ndarray
        (4, 4) float64, filled: equations of the warp once the unknowns before it are eliminated.
    """
    size = len(right)
    for pivot in range(size):
        if pivot == begin:
            for i in range(PARAMETERS):
                for k in range(PARAMETERS):
                    schur[i, k] = normal[begin + i, begin + k]
        of_warp = 0 <= pivot - begin < PARAMETERS
        least = 1e-9 * schur[pivot - begin, pivot - begin] if of_warp else 0.0
        p = normal[pivot, pivot]
        if not p > least:
            return False
        for i in range(pivot + 1, size):
            f = normal[i, pivot] / p
            for k in range(pivot, size):
                normal[i, k] -= f * normal[pivot, k]
            right[i] -= f * right[pivot]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right[i] -= normal[i, k] * right[k]
        right[i] /= normal[i, i]
    return True
