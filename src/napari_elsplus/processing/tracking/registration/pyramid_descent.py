"""A link in one piece: down a pyramid of two frames to full resolution, then against the link's rivals.

Each level starts where the coarser one ended. Called as one, so that a frame costs one step out of Python.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import lean_kernel
from napari_elsplus.processing.tracking.registration.evidence import in_pixels_of, rival_evidence, weakest_direction
from napari_elsplus.processing.tracking.registration.lucas_kanade import align

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.registration.lucas_kanade import Workspace

    Levels = tuple[NDArray[np.float32], ...]

LEVELS: Final = 3
CORRELATED_PX: Final = 20.0
"""Pixels that share one noise value: the front end smooths, and the core pattern is correlated."""
_STAGES: Final = (
    (2, 1, False, 12, 0.2),
    (1, 2, False, 10, 0.1),
    (0, 6, True, 4, 0.1),
    (0, 2, True, 1, 0.0),
)
"""Down the pyramid: level, every how many rows are used, whether they are sampled finely, largest number of steps, and
smallest step in the level's own pixels."""
_KNOWN_PX: Final = 0.025
"""Uncertainty of a shift below which noise matters less than what does not move at the rim."""
_RIGID: Final = 1e12
_CANDIDATE_TOLERANCE_PX: Final = 0.1
_CANDIDATE_STEPS: Final = 8


@lean_kernel
def link_levels(
    earlier: Levels,
    later: Levels,
    lit: NDArray[np.int32],
    middles: tuple[float, ...],
    stiffness: tuple[float, float],
    warp: NDArray[np.float64],
    information: NDArray[np.float64],
    work: Workspace,
) -> tuple[float, float]:
    """Refine a warp in place, fill its information matrix, and weigh it against its rivals.

    Parameters
    ----------
    earlier, later : tuple of numpy.ndarray
        Frames at full, half and quarter resolution, (n, n) float32.
    lit : numpy.ndarray
        (LEVELS + 1, 2, n) int32: first lit column of each row, and the one after the last, at each level; and once more
        at full resolution without the rim, which is left out where the frames say enough without it.
    middles : tuple of float
        Row of the bundle's centre at each level.
    stiffness : tuple of float
        Information on a and s that is there beforehand.
    warp : numpy.ndarray
        (4,) float64: a, b, s, d in pixels of full resolution; what is expected, and the result.
    information : numpy.ndarray
        (4, 4) float64: inverse covariance of the result.
    work : Workspace
        For frames of this size.

    Returns
    -------
    correlation : float
        Zero-mean normalised correlation of the overlap.
    evidence : float
        For this warp and against the best of its rivals, nats per pixel.
    """
    equations = work.equations
    stiff, expected, scaled = equations[3], equations[5, 0], equations[5, 1]
    origin = warp[0], warp[1], warp[2], warp[3]
    correlation, finest = 0.0, 0
    for level, row_step, finely, steps, tolerance_px in _STAGES:
        px = 2.0**level
        stiff[:] = 0.0
        stiff[0, 0], stiff[2, 2] = (_RIGID, _RIGID) if level == LEVELS - 1 else stiffness
        in_pixels_of(px, origin, expected)
        in_pixels_of(px, (warp[0], warp[1], warp[2], warp[3]), scaled)
        columns = lit[level if level else finest, :, : len(earlier[level])]
        correlation, _ = align(
            earlier[level], later[level], columns[0], columns[1], middles[level], row_step, steps, tolerance_px,
            finely, expected, stiff, CORRELATED_PX / row_step / 4**level, scaled, information, work,
        )  # fmt: skip
        if correlation == 0.0:
            break
        in_pixels_of(1 / px, (scaled[0], scaled[1], scaled[2], scaled[3]), warp)
        if level and px * weakest_direction(information)[0] < _KNOWN_PX:
            finest = LEVELS
    columns = lit[1, :, : len(earlier[1])]
    evidence = rival_evidence(
        earlier[1], later[1], columns[0], columns[1], middles[1], warp, information, stiffness,
        CORRELATED_PX / 8, work,
    )  # fmt: skip
    return correlation, evidence


@lean_kernel
def align_candidate(
    earlier: NDArray[np.float32],
    later: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    middle: float,
    warp: NDArray[np.float64],
    work: Workspace,
) -> tuple[float, float]:
    """Refine the shift of a warp in pixels of full resolution, on frames of half resolution.

    Returns the correlation of the overlap and the number of its pixels.

    Parameters
    ----------
    earlier, later : numpy.ndarray
        (n, n) float32 frames of half resolution.
    first, last : numpy.ndarray
        (n,) int32: first lit column of each row, and the one after the last.
    middle : float
        Row of the bundle's centre.
    warp : numpy.ndarray
        (4,) a, b, s, d in pixels of full resolution, modified in place.
    work : Workspace
        For frames of this size or larger.
    """
    equations = work.equations
    stiff, expected, scaled = equations[3], equations[5, 0], equations[5, 1]
    stiff[:] = 0.0
    stiff[0, 0] = stiff[2, 2] = _RIGID
    in_pixels_of(2.0, (warp[0], warp[1], warp[2], warp[3]), expected)
    in_pixels_of(2.0, (warp[0], warp[1], warp[2], warp[3]), scaled)
    score = align(
        earlier, later, first, last, middle, 1, _CANDIDATE_STEPS, _CANDIDATE_TOLERANCE_PX, False, expected, stiff, 1.0,
        scaled, equations[4], work,
    )  # fmt: skip
    in_pixels_of(0.5, (scaled[0], scaled[1], scaled[2], scaled[3]), warp)
    return score


@lean_kernel
def fill_coarser(levels: Levels) -> None:
    """Fill each level but the first with the means of two by two pixels of the finer one."""
    quarter = np.float32(0.25)
    for level in range(1, LEVELS):
        fine, coarse = levels[level - 1], levels[level]
        for row in range(coarse.shape[0]):
            upper, lower, into = fine[2 * row], fine[2 * row + 1], coarse[row]
            for col in range(coarse.shape[1]):
                into[col] = quarter * (upper[2 * col] + upper[2 * col + 1] + lower[2 * col] + lower[2 * col + 1])
