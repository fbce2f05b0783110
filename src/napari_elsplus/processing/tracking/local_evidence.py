"""How much two frames say for a warp against its rivals, place by place: for views in which little is to be seen.

A correlation weighs all pixels alike, so that in a view with one fibre its bright, even length drowns its end, which
alone tells the motion along it. Here every block of pixels has a noise of its own, learnt from what the warp leaves
unexplained there; blocks are then summed as log-likelihoods. Chance may favour a warp by a little in every block along
a fibre, so the frames as a whole must agree.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.compiled import lean_kernel
from napari_elsplus.processing.tracking.descent import CORRELATED_PX
from napari_elsplus.processing.tracking.evidence import HELD, in_pixels_of, weakest_direction
from napari_elsplus.processing.tracking.lucas_kanade import align, fitted_tone
from napari_elsplus.processing.tracking.sampling import between, bilinear, neighbours, row_shift

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.lucas_kanade import Workspace

    Levels = tuple[NDArray[np.float32], ...]
    Columns = tuple[NDArray[np.int32], ...]

LEAST_NATS: Final = 6.0
"""Evidence that a warp needs against each of its rivals, the blocks taken together."""
LEAST_EVERYWHERE: Final = 0.15
"""The same if all pixels had one noise, nats per pixel: what is left of the core pattern favours a warp by chance, a
little in many blocks."""
BLOCK_PX: Final = 8
"""Side of the blocks, pixels of half resolution."""
_STRUCTURE: Final = 0.01
_FLOOR: Final = 0.3
"""Unexplained variance that is no evidence: that part of the brightest block's, and so many squared grey levels."""
_LEAST_PIXELS: Final = 20
_LEAST_NOISE: Final = 1e-6
_RIVALS_PX: Final = (-8.0, -6.0, -4.0, 4.0, 6.0, 8.0)
_STEPS: Final = (8, 12, 16)
_TOLERANCE_PX: Final = (0.02, 0.02, 0.05)
_ROW_STEPS: Final = (2, 2, 1)
"""Of each level, the finest first: largest number of steps, smallest step in its own pixels, rows used."""
_RIVAL_STEPS: Final = 4
_HALF: Final = 1


def blocks(side: int) -> NDArray[np.float64]:
    """Return what :func:`look_again` sums blocks in, for frames of such a side at full resolution."""
    across = -(-(side // 2) // BLOCK_PX)
    return np.zeros((5, across * across))


@lean_kernel
def look_again(
    earlier: Levels,
    later: Levels,
    first: Columns,
    last: Columns,
    middles: tuple[float, ...],
    coarsest: int,
    expected: NDArray[np.float64],
    prior: tuple[float, float, float, float],
    warp: NDArray[np.float64],
    information: NDArray[np.float64],
    sums: NDArray[np.float64],
    work: Workspace,
) -> tuple[float, float, float]:
    """Refine a warp in place under a prior that ties stretch to shift, and weigh it against its rivals.

    Parameters
    ----------
    earlier, later : tuple of numpy.ndarray
        Frames at full, half and quarter resolution, (n, n) float32.
    first, last : tuple of numpy.ndarray
        (n,) int32 lit columns of each row at each level.
    middles : tuple of float
        Row of the bundle's centre at each level.
    coarsest : int
        Level to begin with.
    expected : numpy.ndarray
        (4,) float64: the warp that is expected, pixels of full resolution.
    prior : tuple of float
        Stiffness, tie and slopes of a :class:`~napari_elsplus.processing.tracking.warp_prior.WarpPrior`.
    warp : numpy.ndarray
        (4,) float64: where to start, and the result.
    information : numpy.ndarray
        (4, 4) float64: inverse covariance of the result.
    sums : numpy.ndarray
        From :func:`blocks`.
    work : Workspace
        For frames of this size.

    Returns
    -------
    correlation : float
        Zero-mean normalised correlation of the overlap.
    count : float
        Number of pixels in it.
    certainty : float
        Evidence for this warp against the best of its rivals, over what is needed.
    """
    equations = work.equations
    stiff, middle_of_prior, scaled = equations[3], equations[5, 0], equations[5, 1]
    correlation, count = 0.0, 0.0
    for level in range(coarsest, -1, -1):
        px = 2.0**level
        hold(px, prior, stiff)
        in_pixels_of(px, (expected[0], expected[1], expected[2], expected[3]), middle_of_prior)
        in_pixels_of(px, (warp[0], warp[1], warp[2], warp[3]), scaled)
        correlation, count = align(
            earlier[level], later[level], first[level], last[level], middles[level], _ROW_STEPS[level], _STEPS[level],
            _TOLERANCE_PX[level], level == 0, middle_of_prior, stiff,
            CORRELATED_PX / _ROW_STEPS[level] / 4**level, scaled, information, work,
        )  # fmt: skip
        if correlation == 0.0:
            return 0.0, count, 0.0
        in_pixels_of(1 / px, (scaled[0], scaled[1], scaled[2], scaled[3]), warp)
    certainty = _against_rivals(
        earlier[_HALF], later[_HALF], first[_HALF], last[_HALF], middles[_HALF], expected, prior, warp, information,
        sums, work,
    )  # fmt: skip
    return correlation, count * _ROW_STEPS[0], certainty


@lean_kernel
def look_at_half(
    earlier: NDArray[np.float32],
    later: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    middle: float,
    expected: NDArray[np.float64],
    prior: tuple[float, float, float, float],
    warp: NDArray[np.float64],
    work: Workspace,
) -> tuple[float, float]:
    """Refine a warp, in pixels of full resolution, on frames of half resolution; return correlation and pixels."""
    equations = work.equations
    stiff, middle_of_prior, scaled = equations[3], equations[5, 0], equations[5, 1]
    hold(2.0, prior, stiff)
    in_pixels_of(2.0, (expected[0], expected[1], expected[2], expected[3]), middle_of_prior)
    in_pixels_of(2.0, (warp[0], warp[1], warp[2], warp[3]), scaled)
    correlation, count = align(
        earlier, later, first, last, middle, _ROW_STEPS[1], _STEPS[1], _TOLERANCE_PX[1], False, middle_of_prior, stiff,
        CORRELATED_PX / 8, scaled, equations[4], work,
    )  # fmt: skip
    in_pixels_of(0.5, (scaled[0], scaled[1], scaled[2], scaled[3]), warp)
    return correlation, count * _ROW_STEPS[1]


@lean_kernel
def hold(px: float, prior: tuple[float, float, float, float], out: NDArray[np.float64]) -> None:
    """Write a prior's information on a, b, s, d, in pixels of another size."""
    stiffness, tie, row_slope, col_slope = prior
    out[:] = 0.0
    for k in range(2):
        slope = px * (row_slope if k == 0 else col_slope)
        out[2 * k, 2 * k] = stiffness + tie
        out[2 * k, 2 * k + 1] = out[2 * k + 1, 2 * k] = -tie * slope
        out[2 * k + 1, 2 * k + 1] = tie * slope * slope


@lean_kernel
def _against_rivals(
    template: NDArray[np.float32],
    image: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    middle: float,
    expected: NDArray[np.float64],
    prior: tuple[float, float, float, float],
    warp: NDArray[np.float64],
    information: NDArray[np.float64],
    sums: NDArray[np.float64],
    work: Workspace,
) -> float:
    _, across, along, a_follows, s_follows = weakest_direction(information)
    if across == 0.0 and along == 0.0:
        return 0.0
    stiffness, tie, row_slope, col_slope = prior
    equations = work.equations
    held, found, rival, start = equations[3], equations[6, 0], equations[6, 1], equations[6, 2]
    in_pixels_of(2.0, (warp[0], warp[1], warp[2], warp[3]), found)
    smallest = np.inf
    for k in range(len(_RIVALS_PX)):
        shift = _RIVALS_PX[k]
        a, b = warp[0] + shift * a_follows, warp[1] + shift * across
        s, d = warp[2] + shift * s_follows, warp[3] + shift * along
        in_pixels_of(2.0, (a, b, s, d), rival)
        # of all warps that are shifted as far along this direction, the one that was expected most
        miss = across * (b - expected[1]) + along * (d - expected[3])
        follows = tie / (tie + stiffness)
        in_pixels_of(
            2.0,
            (
                expected[0] + follows * row_slope * miss * across,
                expected[1] + miss * across,
                expected[2] + follows * col_slope * miss * along,
                expected[3] + miss * along,
            ),
            start,
        )
        hold(2.0, prior, held)
        held[1, 1] += 4 * HELD * across * across
        held[1, 3] += 4 * HELD * across * along
        held[3, 1] += 4 * HELD * across * along
        held[3, 3] += 4 * HELD * along * along
        align(
            template, image, first, last, middle, 2, _RIVAL_STEPS, 0.02, False, start, held, CORRELATED_PX / 8, rival,
            equations[4], work,
        )  # fmt: skip
        smallest = min(smallest, local_evidence(template, image, first, last, middle, found, rival, sums))
    return float(smallest)


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
) -> float:
    """Evidence for a warp against another, where both have the frames overlap, over what is needed.

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
    float
        Positive where the first warp explains the frames better. The smaller of two: with a noise of its own for each
        block, and with one for all.
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
    pixels, total = 0.0, 0.0
    for block in range(sums.shape[1]):
        pixels += sums[0, block]
        total += sums[3, block]
    if pixels == 0:
        return 0.0
    mean, brightest = total / pixels, 0.0
    for block in range(sums.shape[1]):
        n = sums[0, block]
        if n > _LEAST_PIXELS:
            brightest = max(brightest, sums[4, block] / n - 2 * mean * sums[3, block] / n + mean * mean)
    least, nats, unexplained, otherwise = _STRUCTURE * brightest + _FLOOR, 0.0, 0.0, 0.0
    for block in range(sums.shape[1]):
        n = sums[0, block]
        if n > 0:
            unexplained += sums[1, block]
            otherwise += sums[2, block]
            values = n / (CORRELATED_PX / 4)
            nats += 0.5 * values * np.log((sums[2, block] + n * least) / (sums[1, block] + n * least))
    everywhere = 0.5 * np.log((otherwise + _LEAST_NOISE * pixels) / (unexplained + _LEAST_NOISE * pixels))
    return float(min(nats / LEAST_NATS, everywhere / LEAST_EVERYWHERE))


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
