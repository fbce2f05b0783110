"""Registration down a pyramid of two frames, from coarse to full resolution; each level starts where the last ended."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus.processing.compiled import lean_kernel
from napari_elsplus.processing.tracking.registration.lucas_kanade import align
from napari_elsplus.processing.tracking.registration.odds import (
    CORRELATED_PX,
    in_pixels_of,
    prior_terms,
    weakest_direction,
    write_prior,
)
from napari_elsplus.processing.tracking.registration.pyramid import LEVELS

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.registration.lucas_kanade import Workspace

    Levels = tuple[NDArray[np.float32], ...]

SHARP_PX: Final = 0.04
"""Uncertainty of a shift at half resolution, pixels, below which structure constrains it in every direction; noise
alone makes 0.06."""
_STAGES: Final = (
    (2, 1, False, 12, 0.2),
    (1, 2, False, 10, 0.1),
    (0, 6, True, 4, 0.1),
    (0, 2, True, 1, 0.0),
)
"""Down the pyramid: level, every how many rows are used, whether they are sampled finely, largest number of steps, and
smallest step in the level's own pixels."""


@lean_kernel
def descend(
    earlier: Levels,
    later: Levels,
    lit: NDArray[np.int32],
    middles: tuple[float, ...],
    coarsest: int,
    finest: int,
    expected: NDArray[np.float64],
    terms: tuple[float, float, float],
    warp: NDArray[np.float64],
    information: NDArray[np.float64],
    work: Workspace,
) -> tuple[float, float, bool]:
    """Refine a warp in place from a coarse to a fine level.

    From half to full resolution it goes on only if the shift is sharp by then: structure constrains it in every
    direction. Noise then matters less than what does not move at the rim, which is left out.

    Parameters
    ----------
    earlier, later : tuple of numpy.ndarray
        Frames at full, half and quarter resolution, (n, n) float32.
    lit : numpy.ndarray
        (LEVELS + 1, 2, n) int32: first lit column of each row, and the one after the last, at each level; and at full
        resolution without the rim.
    middles : tuple of float
        Row of the bundle's centre at each level.
    coarsest, finest : int
        First and last level.
    expected : numpy.ndarray
        (4,) float64: a, b, s, d that the motion prior expects, pixels of full resolution.
    terms : tuple of float
        :attr:`~.motion_prior.MotionPrior.terms`.
    warp : numpy.ndarray
        (4,) float64: where to start, and the result, pixels of full resolution.
    information : numpy.ndarray
        (4, 4) float64: inverse covariance of the result, the prior of stretch and shear included.
    work : Workspace
        For frames of this size.

    Returns
    -------
    float
        Zero-mean normalised correlation of the overlap; 0 where there is none.
    float
        Pixels of the overlap.
    bool
        True if the shift is sharp.
    """
    equations = work.equations
    stiff, centre, scaled = equations[3], equations[5, 0], equations[5, 1]
    correlation, count, sharp = 0.0, 0.0, False
    for level, row_step, finely, steps, tolerance_px in _STAGES:
        if level > coarsest or level < finest:
            continue
        if level == 0 < coarsest and not sharp:
            sharp = 2 * weakest_direction(information)[0] < SHARP_PX
            if not sharp:
                break
        px = 2.0**level
        write_prior(px, terms, prior_terms(warp, expected, terms)[0], stiff)
        in_pixels_of(px, (expected[0], expected[1], expected[2], expected[3]), centre)
        in_pixels_of(px, (warp[0], warp[1], warp[2], warp[3]), scaled)
        at, side = (LEVELS if sharp else level), len(earlier[level])
        correlation, count = align(
            earlier[level], later[level], lit[at, 0, :side], lit[at, 1, :side], middles[level], row_step, steps,
            tolerance_px, finely, centre, stiff, CORRELATED_PX / row_step / 4**level, scaled, information, work,
        )  # fmt: skip
        if correlation == 0.0:
            break
        count *= row_step * 4.0**level
        in_pixels_of(1 / px, (scaled[0], scaled[1], scaled[2], scaled[3]), warp)
    return correlation, count, sharp
