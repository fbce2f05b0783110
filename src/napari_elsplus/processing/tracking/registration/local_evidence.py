"""How much two frames say for a warp against its rivals, place by place: for views in which little is to be seen.

Every block of pixels has a noise of its own (``registration.local_noise``). Three things are
asked of a warp. What both frames show must tell the shift well enough in every direction. Each rival a few pixels away
must explain the frames worse; what is known of the motion counts: a rival that slides along a fibre by another stretch
than its shift asks for pays for that. Chance may favour a warp by a little in every block along a fibre, so the frames
as a whole must agree.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import lean_kernel
from napari_elsplus.processing.tracking.registration.evidence import HELD, in_pixels_of, weakest_direction
from napari_elsplus.processing.tracking.registration.local_noise import local_evidence, shared_information
from napari_elsplus.processing.tracking.registration.lucas_kanade import align
from napari_elsplus.processing.tracking.registration.pyramid_descent import CORRELATED_PX

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.registration.lucas_kanade import Workspace

    Levels = tuple[NDArray[np.float32], ...]
    Columns = tuple[NDArray[np.int32], ...]

LEAST_NATS: Final = 3.0
"""Evidence that a warp needs against each of its rivals, the blocks and what is known of the motion taken together."""
LEAST_EVERYWHERE: Final = 0.1
"""The same of the frames alone if all pixels had one noise, nats per pixel: what is left of the core pattern favours a
warp by chance, a little in many blocks."""
MOST_UNSURE_PX: Final = 0.85
"""Uncertainty of the shift, where it is known least, up to which it is told: one standard deviation."""
_HOPELESS: Final = 0.1
"""Part of what is needed below which rivals are not asked."""
_RIVALS_PX: Final = (-8.0, -6.0, -4.0, 4.0, 6.0, 8.0)
_STEPS: Final = (8, 12, 16)
_TOLERANCE_PX: Final = (0.02, 0.02, 0.05)
_ROW_STEPS: Final = (2, 2, 1)
"""Of each level, the finest first: largest number of steps, smallest step in its own pixels, rows used."""
_RIVAL_STEPS: Final = 4
_HALF: Final = 1
_FREEDOM: Final = 4.0


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
        Stiffness, tie and slopes of a :class:`~napari_elsplus.processing.tracking.motion.warp_prior.WarpPrior`.
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
        Evidence for this warp, over what is needed.
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
    in_pixels_of(2.0, (warp[0], warp[1], warp[2], warp[3]), scaled)
    hold(2.0, prior, stiff)
    shared_information(
        earlier[_HALF], later[_HALF], first[_HALF], last[_HALF], middles[_HALF], scaled, stiff, sums, information, work
    )
    told = (MOST_UNSURE_PX / weakest_direction(information)[0]) ** 2
    if told < _HOPELESS:
        return correlation, count * _ROW_STEPS[0], told
    against = _against_rivals(
        earlier[_HALF], later[_HALF], first[_HALF], last[_HALF], middles[_HALF], expected, prior, warp, information,
        sums, work,
    )  # fmt: skip
    return correlation, count * _ROW_STEPS[0], min(told, against)


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
    """Refine a warp, in pixels of full resolution, on frames of half resolution; return correlation and pixels.

    Parameters
    ----------
    earlier, later : numpy.ndarray
        (n, n) float32 frames of half resolution.
    first, last : numpy.ndarray
        (n,) int32: first lit column of each row, and the one after the last.
    middle : float
        Row of the bundle's centre.
    expected : numpy.ndarray
        (4,) a, b, s, d of the prior.
    prior : tuple of float
        :attr:`WarpPrior.terms`.
    warp : numpy.ndarray
        (4,) a, b, s, d; modified in place.
    work : Workspace
        For frames of this size or larger.
    """
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
    """Write a prior's information on a, b, s, d, in pixels of another size.

    Parameters
    ----------
    px : float
        Size of the other pixels, in pixels of full resolution.
    prior : tuple of float
        :attr:`WarpPrior.terms`.
    out : numpy.ndarray
        (4, 4) float64 or larger, filled.
    """
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
    unlikely = unlikelihood(warp, expected, prior)
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
        nats, everywhere = local_evidence(template, image, first, last, middle, found, rival, sums)
        in_pixels_of(0.5, (rival[0], rival[1], rival[2], rival[3]), start)
        nats += unlikelihood(start, expected, prior) - unlikely
        smallest = min(smallest, nats / LEAST_NATS, everywhere / LEAST_EVERYWHERE)
    return float(smallest)


@lean_kernel
def unlikelihood(
    warp: NDArray[np.float64], expected: NDArray[np.float64], prior: tuple[float, float, float, float]
) -> float:
    """Nats by which stretch and shear of a warp speak against its shift; pixels of full resolution.

    What is known of a velocity may be wrong by more than is thought: the tails are heavy, those of Student's t.

    Parameters
    ----------
    warp, expected : numpy.ndarray
        (4,) a, b, s, d.
    prior : tuple of float
        :attr:`WarpPrior.terms`.
    """
    _, tie, row_slope, col_slope = prior
    stretch = warp[0] - expected[0] - row_slope * (warp[1] - expected[1])
    shear = warp[2] - expected[2] - col_slope * (warp[3] - expected[3])
    misfit = tie * (stretch * stretch + shear * shear)
    return float(0.5 * (_FREEDOM + 2) * np.log1p(misfit / _FREEDOM))
