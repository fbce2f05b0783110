"""Registration of a frame on an earlier one: the step that is made for every frame, compiled as a whole.

Down the pyramid of both, from coarse to full resolution, each level starting where the last ended; then the odds of the
warp, and the velocity that it means.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.compiled import compilable, lean_kernel
from napari_elsplus.processing.tracking.front_end.grid import FIELD, INNER_FIELD, overlap_of_discs
from napari_elsplus.processing.tracking.front_end.sampling import FramePair
from napari_elsplus.processing.tracking.motion.motion_prior import expected_warp, terms_of, velocity_given
from napari_elsplus.processing.tracking.registration import lucas_kanade, odds, pyramid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior, Terms
    from napari_elsplus.processing.tracking.motion.rolling_shutter import Warp
    from napari_elsplus.processing.tracking.registration.lucas_kanade import Workspace
    from napari_elsplus.processing.tracking.registration.pyramid import Levels, Pyramid

    Array = NDArray[np.float64]

SHARP_PX: Final = 0.04
"""Uncertainty of a shift at half resolution, pixels, below which structure constrains it in every direction; noise
alone makes 0.06."""
SHARP_PRIOR_PX: Final = 1.0
"""Standard deviation of the expected shift, pixels, below which registration begins at half resolution; chosen: half a
pixel of that."""
_STAGES: Final = (
    (2, lucas_kanade.Iteration(1, 12, 0.2, False)),
    (1, lucas_kanade.Iteration(4, 10, 0.1, False)),
    (1, lucas_kanade.Iteration(2, 10, 0.1, False)),
    (0, lucas_kanade.Iteration(6, 4, 0.1, True)),
    (0, lucas_kanade.Iteration(2, 1, 0.0, True)),
)
"""Down the pyramid: levels, and how each is registered; chosen, as docs/levers.md states. Every fourth row of half
resolution suffices where structure is rich; elsewhere half resolution is repeated with every second."""
_TO_HALF, _SHARP, _UNSHARP = (0, 2), (3, 5), (2, 5)
"""Which of the stages: those from a predicted shift to half resolution, and from there on."""


class Tools(NamedTuple):
    """What the registration of frames on one grid needs; one for each thread.

    Parameters
    ----------
    lit : tuple of tuple of numpy.ndarray
        For each image of a frame, (n,) int32: first column of each row that is compared, and the one after the last;
        without the rim in the image that is not high-passed.
    middles : tuple of float
        Row of the bundle's centre in each image.
    diameter : float
        Of the disc that is compared, pixels of full resolution.
    pyramid : Pyramid
        Fills the levels of frames.
    blocks : Blocks
        Scratch of the odds.
    work : Workspace
        Scratch of Lucas-Kanade.
    """

    lit: tuple[tuple[NDArray[np.int32], NDArray[np.int32]], ...]
    middles: tuple[float, ...]
    diameter: float
    pyramid: Pyramid
    blocks: odds.Blocks
    work: Workspace

    @classmethod
    def of(cls, grid: Grid, field: float) -> Tools:
        """Return those for frames on a grid that are lit in a part of the diameter, `field`."""
        half, quarter = grid.binned(2), grid.binned(4)
        lit = grid.spans(INNER_FIELD), half.spans(), quarter.spans(), grid.spans()
        middles = tuple(one.centre[0] for one in (grid, half, quarter, grid))
        scratch = odds.Blocks.of(grid.side), lucas_kanade.Workspace.of(grid.side)
        return cls(lit, middles, FIELD * grid.diameter, pyramid.Pyramid.of(grid, field), *scratch)


@compilable
def pair_of(which: int, earlier: Levels, later: Levels, tools: Tools) -> FramePair:
    """Return one image of each of two frames, to be compared.

    Parameters
    ----------
    which : int
        A level of their pyramids, or :data:`~.pyramid.HIGH_PASSED`.
    earlier, later, tools
        As of :func:`register`.
    """
    first, last = tools.lit[which]
    return FramePair(earlier.images[which], later.images[which], first, last, tools.middles[which])


@lean_kernel
def register(
    earlier: Levels, later: Levels, prior: MotionPrior, start: Warp, as_expected: bool, min_correlation: float,
    tools: Tools, information: Array,
) -> tuple[float, ...]:  # fmt: skip
    """Register two frames: descend the pyramid, compare with competing shifts, and derive the velocity.

    Returns a, b, s, d of the warp; the correlation; the part of the disc that both frames show; log odds, nats; what
    :func:`later_velocity` returns; and the correlation at half resolution.

    Parameters
    ----------
    earlier, later : Levels
        Frames; levels that are missing are filled.
    prior : MotionPrior
        Of the motion between them.
    start : Warp
        Where to start.
    as_expected : bool
        Start from the expected warp instead.
    min_correlation : float
        Correlation at half resolution that is needed: without it registration ends there, its odds minus infinity.
    tools : Tools
        For frames on this grid.
    information : numpy.ndarray
        (4, 4) float64, filled: inverse covariance of a, b, s, d.
    """
    pyramid.fill_levels(earlier, tools.pyramid)
    pyramid.fill_levels(later, tools.pyramid)
    terms, expected = terms_of(prior.covariance, prior.line_periods_per_frame), expected_warp(prior)
    warp = expected if as_expected else start
    begins_at_half = as_expected and prior.covariance[1][1] < SHARP_PRIOR_PX**2
    first, end = _TO_HALF
    stages = first + 1 if begins_at_half else first, end
    correlation, count, warp = descend(earlier, later, stages, True, expected, terms, warp, information, tools)
    nats, at_half = -np.inf, correlation
    alike_enough = at_half > max(min_correlation, 0.0)
    if alike_enough and 2 * odds.weakest_direction(information)[0] < SHARP_PX:
        # noise is less than what does not move at the rim, which is left out
        correlation, count, warp = descend(earlier, later, _SHARP, True, expected, terms, warp, information, tools)
        # against unrelated frames, the only competitor of a shift that is so sharp
        unexplained = max(1 - correlation * correlation, 1e-12)
        nats = min(-0.5 * count / odds.CORRELATED_PX * np.log(unexplained), 700.0)
    elif alike_enough:
        # noise is more than that: all that is lit, without what is smooth
        pyramid.high_pass(earlier, tools.pyramid)
        pyramid.high_pass(later, tools.pyramid)
        correlation, count, warp = descend(earlier, later, _UNSHARP, False, expected, terms, warp, information, tools)
        if correlation > 0:
            # smooth tissue loses by that most of its texture: what the frames tell as they are counts where it is more
            whole, less = tools.work.schur, odds.weakest_direction(information)[0]
            alike, _, other = descend(earlier, later, _SHARP, True, expected, terms, warp, whole, tools)
            if alike > 0 and odds.weakest_direction(whole)[0] < less:
                warp = other
                for i in range(lucas_kanade.PARAMETERS):
                    for k in range(lucas_kanade.PARAMETERS):
                        information[i, k] = whole[i, k]
            pair = pair_of(1, earlier, later, tools)
            nats = odds.log_odds(pair, warp, information, expected, terms, tools.blocks, tools.work)
    overlap = overlap_of_discs(np.hypot(warp.b, warp.d) / tools.diameter)
    row, col, variance = later_velocity(prior, warp, information, tools.work)
    return warp.a, warp.b, warp.s, warp.d, correlation, overlap, nats, row, col, variance, at_half


@lean_kernel
def later_velocity(prior: MotionPrior, warp: Warp, information: Array, work: Workspace) -> tuple[float, float, float]:
    """Return the later frame's velocity (rows, cols) given a registered warp, and its variance (larger axis).

    In pixels per frame period; the variance is infinite where nothing constrains the warp.

    Parameters
    ----------
    prior : MotionPrior
        Of the motion between the frames.
    warp : Warp
        From the earlier to the later frame.
    information : numpy.ndarray
        (4, 4) inverse covariance of a, b, s, d.
    work : Workspace
        Scratch.
    """
    velocity, variance, of_stretch, of_shift = velocity_given(prior, warp)
    along, largest = work.right[: lucas_kanade.PARAMETERS], 0.0
    for k in (0, 2):
        along[:] = 0.0
        along[k], along[k + 1] = of_stretch, of_shift
        for i in range(lucas_kanade.PARAMETERS):
            for j in range(lucas_kanade.PARAMETERS):
                work.normal[i, j] = information[i, j]
        if not lucas_kanade.solve(work.normal, along, 0, work.schur):
            return velocity.row, velocity.col, np.inf
        largest = max(largest, of_stretch * along[k] + of_shift * along[k + 1])
    return velocity.row, velocity.col, variance + largest


@compilable
def descend(
    earlier: Levels, later: Levels, stages: tuple[int, int], sharp: bool, expected: Warp, terms: Terms,
    warp: Warp, information: Array, tools: Tools,
) -> tuple[float, float, Warp]:  # fmt: skip
    """Refine a warp by some stages of the pyramid.

    Parameters
    ----------
    earlier, later : Levels
        Frames.
    stages : tuple of int
        The first of them, and the one after the last.
    sharp : bool
        Compare frames of full resolution as they are, without the rim; else high-passed, all that is lit.
    expected : Warp
        That the motion prior expects, pixels of full resolution.
    terms : tuple of float
        :attr:`~.motion_prior.MotionPrior.terms`.
    warp : Warp
        Where to start, pixels of full resolution.
    information : numpy.ndarray
        (4, 4) float64: inverse covariance of the result, the prior of stretch and shear included.
    tools : Tools
        For frames on this grid.

    Returns
    -------
    float
        Zero-mean normalised correlation of the overlap; 0 where there is none.
    float
        Pixels of the overlap.
    Warp
        The result, pixels of full resolution.
    """
    work, stiffness = tools.work, tools.work.stiffness
    correlation, count = 0.0, 0.0
    work.tone[0], work.tone[1] = 1.0, 0.0
    for stage in range(*stages):
        level, how = _STAGES[stage]
        px = 2.0**level
        odds.write_prior(px, terms, odds.prior_terms(warp, expected, terms)[0], stiffness)
        centre, scaled = odds.in_pixels_of(px, expected), odds.in_pixels_of(px, warp)
        pair = pair_of(level if sharp or level else pyramid.HIGH_PASSED, earlier, later, tools)
        correlated_px = odds.CORRELATED_PX / how.row_step / 4**level
        correlation, count, scaled = lucas_kanade.align(
            pair, how, centre, stiffness, correlated_px, scaled, information, work
        )
        if correlation == 0.0:
            break
        count *= how.row_step * 4.0**level
        warp = odds.in_pixels_of(1 / px, scaled)
    return correlation, count, warp
