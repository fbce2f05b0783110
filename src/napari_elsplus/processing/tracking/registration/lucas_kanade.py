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
from napari_elsplus.processing.tracking.registration.row_sums import (
    GE,
    I1,
    II,
    MOMENTS,
    T1,
    TI,
    TT,
    U1,
    UE,
    UT,
    UU,
    UW,
    UX,
    W1,
    WE,
    WT,
    WW,
    WX,
    WY,
    X1,
    XE,
    XT,
    XX,
    Y1,
    YE,
    YT,
    YX,
    YY,
    add_row_sums,
)  # fmt: skip

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
    moments : numpy.ndarray
        (5, 32) float64: sums over pixels, times powers of their row's distance from the middle.
    samples : numpy.ndarray
        From :func:`~.sampling.scratch`.
    """

    normal: Array
    right: Array
    tone: Array
    stiffness: Array
    schur: Array
    moments: Array
    samples: NDArray[np.float32]

    @classmethod
    def of(cls, side: int) -> Workspace:
        """Return one for frames of so many rows and columns, `side`."""
        stiffness, schur = np.zeros((2, PARAMETERS, PARAMETERS))
        normal, right = np.zeros((UNKNOWNS + 2, UNKNOWNS + 2)), np.zeros(UNKNOWNS + 2)
        moments = np.zeros((5, MOMENTS))
        return cls(normal, right, np.array([1.0, 0.0]), stiffness, schur, moments, sampling.scratch(side))


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
    of_powers = work.moments[:3]
    of_powers[:] = 0.0
    pixels = 0
    for row in range(1, len(template) - 1, how.row_step):
        above, down, whole, across, begin, end = sampling.row_shift(pair, row, warp)
        if end <= begin:
            continue
        size = end - begin
        pixels += size
        if how.finely and sampling.reaches(image.shape, above, begin + whole, size):
            sampling.finely_sampled(image, above, down, begin + whole, across, size, work.samples)
        else:
            sampling.sampled(image, above, down, begin + whole, across, size, work.samples)
        y = row - middle
        add_row(template, row, (begin, end), work.samples, work.tone, (1.0, y, y * y), column, of_powers)
    write_equations(of_powers, float(pixels), (1, 0), (1.0, 1.0), work.tone, column, work.normal, work.right)
    moments = of_powers[0]
    count, squares = float(pixels), moments[YY] + moments[XX]
    if count == 0 or squares == 0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    sum_t, sum_i = moments[T1], moments[I1]
    variances = moments[TT] - sum_t * sum_t / count, moments[II] - sum_i * sum_i / count
    return count, *variances, moments[TI] - sum_t * sum_i / count, moments[GE] / squares


@compilable
def add_row(
    template: NDArray[np.float32], row: int, columns: tuple[int, int], samples: NDArray[np.float32], tone: Array,
    powers: tuple[float, ...], column: float | None, moments: Array,
) -> None:  # fmt: skip
    """Add a row of the template, and what it is compared with, to moments.

    Parameters
    ----------
    template : numpy.ndarray
        (n, n) float32, C-contiguous: the earlier frame.
    row : int
        Row of the template, not its first or last one.
    columns : tuple of int
        First column and the one after the last, neither at the edge.
    samples : numpy.ndarray
        (m,) float32, m at least the number of columns: the image there.
    tone : numpy.ndarray
        Gain and offset of the image against the template.
    powers : tuple of float
        Powers 0, 1, 2, ... of the row's distance from the middle.
    column
        As of :func:`accumulate`.
    moments : numpy.ndarray
        (m, 32) float64 for as many powers.
    """
    begin, size, side = columns[0], columns[1] - columns[0], template.shape[1]
    at, tones = row * side + begin, (np.float32(tone[0]), np.float32(tone[1]))
    if column is None:
        add_row_sums(template, at, side, samples, tones, size, None, powers, moments)
    else:
        add_row_sums(template, at, side, samples, tones, size, np.float32(begin - column), powers, moments)


@compilable
def write_equations(
    moments: Array, count: float, powers: tuple[int, ...], scales: tuple[float, ...], tone: Array, column: float | None,
    normal: Array, right: Array,
) -> None:  # fmt: skip
    """Write normal equations of gain, offset and the coefficients of rows and of columns, to be completed.

    Parameters
    ----------
    moments : numpy.ndarray
        Of :func:`add_row`.
    count : float
        Number of pixels.
    powers : tuple of int
        (m,): the shift of a row by each of the m coefficients of an axis goes with this power of its distance.
    scales : tuple of float
        (m,): by these factors.
    tone, column
        As of :func:`add_row`.
    normal, right : numpy.ndarray
        (2 m + 2, 2 m + 2) and (2 m + 2,), or larger: columns of gain and offset from the diagonal on are written, and
        those of the coefficients.
    """
    of_pixels, size = moments[0], len(powers)
    gradients, both, with_tone, with_residual = ((YY, YX), (YX, XX)), (Y1, X1), (YT, XT), (YE, XE)
    for m in range(2):
        for p in range(size):
            at, scale, power = TONE + size * m + p, scales[p], powers[p]
            for n in range(2):
                for q in range(size):
                    of_both = moments[power + powers[q], gradients[m][n]]
                    normal[at, TONE + size * n + q] = scale * scales[q] * of_both
            normal[at, 0] = scale * moments[power, with_tone[m]]
            normal[at, 1] = scale * moments[power, both[m]]
            right[at] = scale * moments[power, with_residual[m]]
    if column is not None:
        turn, stretch = TONE + 2 * size, TONE + 2 * size + 1
        for at, of_1, of_t, of_y, of_x, of_e in ((turn, W1, WT, WY, WX, WE), (stretch, U1, UT, WX, UX, UE)):
            normal[at, 0] = of_pixels[of_t]
            normal[at, 1] = of_pixels[of_1]
            for p in range(size):
                normal[at, TONE + p] = scales[p] * moments[powers[p], of_y]
                normal[at, TONE + size + p] = scales[p] * moments[powers[p], of_x]
            right[at] = of_pixels[of_e]
        normal[turn, turn] = of_pixels[WW]
        normal[stretch, turn] = of_pixels[UW]
        normal[stretch, stretch] = of_pixels[UU]
    normal[0, 0] = of_pixels[TT]
    normal[1, 0] = of_pixels[T1]
    normal[1, 1] = count
    right[0] = of_pixels[TI] - tone[0] * of_pixels[TT] - tone[1] * of_pixels[T1]
    right[1] = of_pixels[I1] - tone[0] * of_pixels[T1] - tone[1] * count


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
