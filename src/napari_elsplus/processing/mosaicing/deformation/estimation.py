"""Deformation of the tissue in all frames of a finished track, estimated from pairs of them.

The Bayesian information criterion decides by a few pairs together whether fields are modelled at all: rigid scenes are
left as they are. All fields are then solved for at once.

References
----------
Schwarz, Ann. Stat. 6, 461 (1978), doi:10.1214/aos/1176344136.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from math import ceil
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.mosaicing.deformation.fields import Deformation
from napari_elsplus.processing.tracking.motion.pose import Pose, tracked_frames
from napari_elsplus.processing.tracking.pose_graph.graph import AWAY, REACH

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid

MAX_TESTED: Final = 9
"""Pairs that decide whether fields are modelled, spread over the track; chosen."""
ROUNDS: Final = (False, True, True)
"""Whether each step compares frames that show a place again, too; chosen: these lie within the texture's size of where
they are expected once the fields along the track are known. One step more of either kind adds at most 0.002."""
TESTED_DIAMETERS: Final = 0.25
"""Distance of the frames that are tested, in diameters; chosen: tissue has deformed by then, and most is in common."""
_EVERY: Final = 2
"""Every how many frames a place that is shown again is sought; chosen."""
MAX_HELD: Final = 64
"""Images that are held; chosen, others are made again."""


def estimate_deformation(
    image: Callable[[int], NDArray[np.float32]], poses: Sequence[Pose], grid: Grid
) -> Deformation | None:
    """Estimate the deformation of the tissue in all tracked frames; None where the scene is rigid.

    Parameters
    ----------
    image : callable
        Returns the image (side, side) of a frame by its index, valid until the next call.
    poses : sequence of Pose
        Final poses of all frames.
    grid : Grid
        The frames' grid.
    """
    tracked = tracked_frames(poses)
    tested, deformation = _tested_pairs(poses, tracked, grid.diameter), Deformation(grid)

    @lru_cache(MAX_HELD)
    def held(index: int) -> NDArray[np.float32]:
        return image(index).copy()

    compared = (deformation.compare((held(a), held(b)), (a, b), (poses[a], poses[b])) for a, b in tested)
    if sum(deformation.gain(*found) for found in compared if found is not None) <= 0:
        return None
    along = [(a, b) for a, b in pairwise(tracked) if poses[a].segment == poses[b].segment]
    again = revisits(poses, tracked, grid.diameter)
    for whole in ROUNDS:
        deformation.solve(held, poses, along + again if whole else along)
    deformation.settle(poses)
    return deformation


def _tested_pairs(poses: Sequence[Pose], tracked: Sequence[int], diameter: float) -> list[tuple[int, int]]:
    """Return a few pairs of `tracked` frames, each with the first that is some way off, or the last of its segment."""
    pairs = []
    for k in tracked[:: ceil(len(tracked) / MAX_TESTED) or 1]:
        later = [j for j in tracked if j > k and poses[j].segment == poses[k].segment]
        away = (j for j in later if abs(poses[j].at - poses[k].at) > TESTED_DIAMETERS * diameter)
        if later:
            pairs.append((k, next(away, later[-1])))
    return pairs


def revisits(poses: Sequence[Pose], tracked: Sequence[int], diameter: float) -> list[tuple[int, int]]:
    """Return pairs of `tracked` frames that show the same place far apart along the path: the nearest to every few.

    Parameters
    ----------
    poses : sequence of Pose
        Of all frames.
    tracked : sequence of int
        Indices of those that are tracked.
    diameter : float
        Of a frame, pixels.
    """
    at, segments = np.array([poses[k].at for k in tracked]), np.array([poses[k].segment for k in tracked])
    gone, pairs = np.cumsum(abs(np.diff(at, prepend=at[0]))), []
    for k in range(0, len(tracked), _EVERY):
        distance = abs(at[:k] - at[k])
        near = (distance < REACH * diameter) & (gone[k] - gone[:k] > AWAY * diameter)
        near &= segments[:k] == segments[k]
        if near.any():
            pairs.append((tracked[int(np.argmin(np.where(near, distance, np.inf)))], tracked[k]))
    return pairs
