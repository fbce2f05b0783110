"""The noise of each place in two frames, learnt from what a warp leaves unexplained there, and what follows from it.

A correlation weighs all pixels alike, so that in a view with one fibre its bright, even length drowns its end, which
alone tells the motion along it. Here every block of pixels has a noise of its own; blocks are summed as log-likelihoods
of one warp against another, or as information on one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import lean_kernel
from napari_elsplus.processing.tracking.front_end.sampling import between, bilinear, neighbours, row_shift
from napari_elsplus.processing.tracking.registration.lucas_kanade import PARAMETERS, solve
from napari_elsplus.processing.tracking.registration.pyramid_descent import CORRELATED_PX
from napari_elsplus.processing.tracking.registration.similarity import fitted_tone

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.registration.lucas_kanade import Workspace

BLOCK_PX: Final = 8
"""Side of the blocks, pixels of half resolution."""
VALUE_PX: Final = CORRELATED_PX / 4
"""Of these that share one noise value."""
_STRUCTURE: Final = 0.03
_FLOOR: Final = 0.3
"""Unexplained variance that is no evidence: that part of the brightest block's, and so many squared grey levels."""
_LEAST_PIXELS: Final = 20
_LEAST_NOISE: Final = 1e-6


def blocks(side: int) -> NDArray[np.float64]:
    """Return what :func:`look_again` sums blocks in, for frames of such a side at full resolution."""
    across = -(-(side // 2) // BLOCK_PX)
    return np.zeros((5, across * across))


@lean_kernel
def local_evidence(
    template: NDArray[np.float32],
    image: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    middle: float,
    found: NDArray[np.float64],
    rival: NDArray[np.float64],
    sums: NDArray[np.float64],
) -> tuple[float, float]:
    """Evidence for a warp against another, where both have the frames overlap.

    Parameters
    ----------
    template, image : numpy.ndarray
        (n, n) float32 frames at half resolution.
    first, last : numpy.ndarray
        (n,) int32: lit columns of each row.
    middle : float
        Row of the bundle's centre.
    found, rival : numpy.ndarray
        (4,) warps in pixels of half resolution.
    sums : numpy.ndarray
        From :func:`blocks`.

    Returns
    -------
    nats : float
        With a noise of its own for each block, positive where the first warp explains the frames better.
    everywhere : float
        With one for all, nats per pixel.
    """
    fill_blocks(template, image, first, last, middle, found, rival, sums)
    least, nats, pixels, unexplained, otherwise = least_noise(sums), 0.0, 0.0, 0.0, 0.0
    for block in range(sums.shape[1]):
        n = sums[0, block]
        if n > 0:
            pixels += n
            unexplained += sums[1, block]
            otherwise += sums[2, block]
            nats += 0.5 * n / VALUE_PX * np.log((sums[2, block] + n * least) / (sums[1, block] + n * least))
    if pixels == 0:
        return 0.0, 0.0
    everywhere = 0.5 * np.log((otherwise + _LEAST_NOISE * pixels) / (unexplained + _LEAST_NOISE * pixels))
    return nats, everywhere


@lean_kernel
def fill_blocks(
    template: NDArray[np.float32],
    image: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    middle: float,
    found: NDArray[np.float64],
    rival: NDArray[np.float64],
    sums: NDArray[np.float64],
) -> None:
    """Sum over each block, where two warps have the frames overlap: pixels, what each leaves squared, and template.

    Parameters
    ----------
    template, image, first, last, middle
        As in :func:`local_evidence`.
    found, rival : numpy.ndarray
        (4,) warps in pixels of half resolution.
    sums : numpy.ndarray
        From :func:`blocks`, filled.
    """
    gain, offset = _tone(template, image, first, last, middle, found)
    other_gain, other_offset = _tone(template, image, first, last, middle, rival)
    height = template.shape[0]
    across = (height + BLOCK_PX - 1) // BLOCK_PX
    sums[:] = 0.0
    for row in range(height):
        above, down, whole, aside, begin, end = row_shift(row, height, middle, found, first, last)
        above2, down2, whole2, aside2, begin2, end2 = row_shift(row, height, middle, rival, first, last)
        begin, end = max(begin, begin2), min(end, end2)
        if end <= begin:
            continue
        here = template[row, begin:end]
        corners, weights = neighbours(image, above, begin + whole, end - begin), bilinear(down, aside)
        corners2, weights2 = neighbours(image, above2, begin + whole2, end - begin), bilinear(down2, aside2)
        for k in range(end - begin):
            t = here[k]
            left = between(corners, weights, k) - gain * t - offset
            left2 = between(corners2, weights2, k) - other_gain * t - other_offset
            block = row // BLOCK_PX * across + (begin + k) // BLOCK_PX
            sums[0, block] += 1.0
            sums[1, block] += left * left
            sums[2, block] += left2 * left2
            sums[3, block] += t
            sums[4, block] += t * t


@lean_kernel
def least_noise(sums: NDArray[np.float64]) -> float:
    """Unexplained variance of a block that is no evidence, from what :func:`fill_blocks` summed."""
    pixels, total = 0.0, 0.0
    for block in range(sums.shape[1]):
        pixels += sums[0, block]
        total += sums[3, block]
    if pixels == 0:
        return _FLOOR
    mean, brightest = total / pixels, 0.0
    for block in range(sums.shape[1]):
        n = sums[0, block]
        if n > _LEAST_PIXELS:
            brightest = max(brightest, sums[4, block] / n - 2 * mean * sums[3, block] / n + mean * mean)
    return _STRUCTURE * brightest + _FLOOR


@lean_kernel
def _tone(
    template: NDArray[np.float32],
    image: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    middle: float,
    warp: NDArray[np.float64],
) -> tuple[float, float]:
    """Gain and offset of an image against a template."""
    height = template.shape[0]
    count, t1, i1, tt, ti = 0.0, 0.0, 0.0, 0.0, 0.0
    for row in range(height):
        above, down, whole, aside, begin, end = row_shift(row, height, middle, warp, first, last)
        if end <= begin:
            continue
        here = template[row, begin:end]
        corners, weights = neighbours(image, above, begin + whole, end - begin), bilinear(down, aside)
        for k in range(end - begin):
            t, i = float(here[k]), float(between(corners, weights, k))
            t1 += t
            i1 += i
            tt += t * t
            ti += t * i
        count += end - begin
    return fitted_tone(count, t1, i1, tt, ti)


@lean_kernel
def shared_information(
    template: NDArray[np.float32],
    image: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    middle: float,
    warp: NDArray[np.float64],
    stiff: NDArray[np.float64],
    sums: NDArray[np.float64],
    information: NDArray[np.float64],
    work: Workspace,
) -> None:
    """Fill the information on a warp from what both frames show, over the noise of its place.

    Lucas-Kanade counts the slopes of one frame, its noise included, so that along a fibre noise passes for structure.
    The noise of two frames is independent: of products of the slopes of one and of the other only structure is left.

    Parameters
    ----------
    template, image, first, last, middle
        As in :func:`local_evidence`.
    warp : numpy.ndarray
        (4,) in pixels of half resolution.
    stiff : numpy.ndarray
        (4, 4), or larger: what is known beforehand, in pixels of half resolution.
    sums : numpy.ndarray
        From :func:`blocks`.
    information : numpy.ndarray
        (4, 4) inverse covariance of a, b, s, d in pixels of full resolution; zero where nothing is told.
    work : Workspace
        For frames of this size, with the tone of the warp.
    """
    fill_blocks(template, image, first, last, middle, warp, warp, sums)
    least = least_noise(sums)
    for block in range(sums.shape[1]):
        sums[2, block] = 1 / (VALUE_PX * (sums[1, block] / max(sums[0, block], 1.0) + least))
    normal, right, gain = work.equations[0], work.equations[1, 0], work.tone[2]
    normal[:] = 0.0
    right[:] = 0.0
    height = template.shape[0]
    across = (height + BLOCK_PX - 1) // BLOCK_PX
    for row in range(1, height - 1):
        above, down, whole, aside, begin, end = row_shift(row, height, middle, warp, first, last)
        begin, end = begin + 1, end - 1
        if end <= begin or above < 1 or above + 2 >= height:
            continue
        y = row - middle
        weights = bilinear(down, aside)
        at = begin + whole
        size = end - begin
        upper, lower = neighbours(image, above - 1, at, size), neighbours(image, above + 1, at, size)
        before, after = neighbours(image, above, at - 1, size), neighbours(image, above, at + 1, size)
        for k in range(size):
            col = begin + k
            weight = sums[2, row // BLOCK_PX * across + col // BLOCK_PX]
            t = template[row, col]
            gy = 0.5 * gain * (template[row + 1, col] - template[row - 1, col])
            gx = 0.5 * gain * (template[row, col + 1] - template[row, col - 1])
            hy = 0.5 * (between(lower, weights, k) - between(upper, weights, k))
            hx = 0.5 * (between(after, weights, k) - between(before, weights, k))
            yy, xx, yx = weight * gy * hy, weight * gx * hx, 0.5 * weight * (gy * hx + gx * hy)
            down_slope, side_slope = 0.5 * weight * (gy + hy), 0.5 * weight * (gx + hx)
            normal[0, 0] += y * y * yy
            normal[0, 1] += y * yy
            normal[0, 2] += y * y * yx
            normal[0, 3] += y * yx
            normal[0, 4] += y * down_slope * t
            normal[0, 5] += y * down_slope
            normal[1, 1] += yy
            normal[1, 3] += yx
            normal[1, 4] += down_slope * t
            normal[1, 5] += down_slope
            normal[2, 2] += y * y * xx
            normal[2, 3] += y * xx
            normal[2, 4] += y * side_slope * t
            normal[2, 5] += y * side_slope
            normal[3, 3] += xx
            normal[3, 4] += side_slope * t
            normal[3, 5] += side_slope
            normal[4, 4] += weight * t * t
            normal[4, 5] += weight * t
            normal[5, 5] += weight
    normal[1, 2] = normal[0, 3]
    for m in range(len(normal)):
        for n in range(m):
            normal[m, n] = normal[n, m]
    for m in range(PARAMETERS):
        for n in range(PARAMETERS):
            normal[m, n] += stiff[m, n]
    information[:] = 0.0
    if solve(normal, right, work.equations[2]):
        for m in range(PARAMETERS):
            for n in range(PARAMETERS):
                information[m, n] = normal[m, n] / (1.0 + m % 2) / (1.0 + n % 2)
