"""Finished tracks by the middle rows of their frames.

Where uneven motion is not estimated (``registration.uneven_motion``), a registration tells the shift of the mean place
of a frame's rows. Under an acceleration a this lies a d^2 / (32 R^2) from the place at which the middle row is read, d
being the diameter of the disc that is compared and R the rows of one frame period. In a finished track the acceleration
from frame to frame follows from the positions (:func:`mean_shifts`); how much of it acts within frames they do not tell
(:data:`WITHIN_FRAMES`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.tracking.front_end.grid import INNER_FIELD
from napari_elsplus.processing.tracking.motion.pose import TrackingState, frame_periods, tracked_frames
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.registration.pair_registration import TrackedPair

    Array = NDArray[np.float64]

WITHIN_FRAMES: Final = 0.5
"""Part of the acceleration from frame to frame that is taken to act within frames, too. Derived: 1 for a hand, 0 for a
stage that is moved once a frame, which frames do not tell apart; errors are then half of the larger ones at most."""


def mean_shifts(poses: Sequence[Pose], grid: Grid, lost: Mapping[int, int]) -> NDArray[np.complex128]:
    """Return where the rows of each frame lie in the mean, from the place where its middle row is read.

    Parameters
    ----------
    poses : sequence of Pose
        One for every frame.
    grid : Grid
        Of the frames.
    lost : mapping of int to int
        How many frames were lost before some, by their index.

    Returns
    -------
    numpy.ndarray
        (frames,) rows as real, columns as imaginary part, pixels; 0 in segments of fewer than three tracked frames.
    """
    shifts, periods = np.zeros(len(poses), np.complex128), frame_periods(len(poses), lost)
    bend = min(INNER_FIELD * grid.diameter / grid.shutter.line_periods_per_frame, 1.0) ** 2 / 32
    segments: dict[int, list[int]] = {}
    for index in tracked_frames(poses):
        segments.setdefault(poses[index].segment, []).append(index)
    for frames in segments.values():
        if len(frames) > 2:
            times = periods[frames]
            velocities = np.diff([poses[k].at for k in frames]) / np.diff(times)
            # a second difference is the acceleration at the mean of its three times
            at = (times[:-2] + times[1:-1] + times[2:]) / 3
            accelerations = 2 * np.diff(velocities) / (times[2:] - times[:-2])
            between = np.arange(frames[0], frames[-1] + 1)
            shifts[between] = bend * np.interp(periods[between], *_extended(at, accelerations))
    return shifts


def of_mean_places(
    links: Sequence[TrackedPair], poses: Sequence[Pose], grid: Grid, lost: Mapping[int, int]
) -> list[TrackedPair]:
    """Return registrations with the displacements of the mean places of the frames' rows, also of uneven motion.

    Parameters
    ----------
    links : sequence of TrackedPair
        The tracker's registrations; those of uneven motion are of the middle rows.
    poses, grid, lost
        As of :func:`mean_shifts`.
    """
    shifts = (WITHIN_FRAMES * mean_shifts(poses, grid, lost)).tolist()

    def moved(link: TrackedPair) -> TrackedPair:
        more = shifts[link.later] - shifts[link.earlier]
        row, col = link.displacement
        return link._replace(displacement=Displacement(row + more.real, col + more.imag))

    return [moved(link) if link.registration.evened else link for link in links]


def at_middle_rows(poses: Sequence[Pose], grid: Grid, lost: Mapping[int, int]) -> list[Pose]:
    """Return poses of the frames' mean places moved towards the times at which their middle rows are read.

    Those of each segment remain relative to its first tracked frame. Parameters are those of :func:`mean_shifts`.
    """
    shifts = (WITHIN_FRAMES * mean_shifts(poses, grid, lost)).tolist()
    first: dict[int, complex] = {}
    result = []
    for pose, shift in zip(poses, shifts, strict=True):
        if pose.state is TrackingState.TRACKED:
            first.setdefault(pose.segment, shift)
        moved = pose.at - shift + first.get(pose.segment, 0)
        result.append(pose.placed(moved, pose.angle, pose.segment) if pose.state is not TrackingState.LOST else pose)
    return result


def _extended(at: Array, values: NDArray[np.complex128]) -> tuple[Array, NDArray[np.complex128]]:
    """Return places and values with those of two places beyond the ends, on the straight lines through the last two."""
    if len(at) == 1:
        return at, values
    before, after = (2 * each[[0, -1]] - each[[1, -2]] for each in (at, values))
    return np.insert(before, 1, at), np.insert(after, 1, values)
