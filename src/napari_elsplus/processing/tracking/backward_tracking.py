"""Frames that were lost before a segment, tracked from it backwards in time.

A segment begins where frames can be registered while no motion is known; those before it, with less structure, are
lost. From the segment on backwards its motion predicts them. Upside down and in reversed order, frames are again those
of a rolling shutter, of a mirrored scene: the same tracker tracks them.
"""

from __future__ import annotations

from cmath import rect
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.ndimage import binary_dilation

from napari_elsplus.processing.tracking.front_end.grid import FIELD
from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity, Warp
from napari_elsplus.processing.tracking.pose_graph.correction import Correction
from napari_elsplus.processing.tracking.pose_graph.nodes import JOLTED_FALL
from napari_elsplus.processing.tracking.pose_graph.refinement import (
    borne_out,
    located,
    settle,
    within_segments,
    without_jolts,
)
from napari_elsplus.processing.tracking.registration.pair_registration import Registrar, TrackedPair
from napari_elsplus.processing.tracking.tracker import Tracker

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration

MIN_ODDS_NATS: Final = 20.0
"""Odds from which a registration is used; chosen: twice those of the tracker, as the frames are those that it lost.
Where a lone fibre slid along itself with the motion that was expected, they were 14 and less."""
CONTEXT_FRAMES: Final = 8
"""Frames tracked again on either side of those that were lost; chosen: by then the motion is known."""
JOLTED_READ: Final = 0.3
"""Part of the frame period in which a frame is read from which a jolt between two frames may lie in one; chosen: it is
0.38 at 120 Hz, and 0.19 at 60 Hz, where none of 903 registrations of the acceptance study was wrong."""


def completed(
    poses: Sequence[Pose], tracker: Tracker, image: Callable[[int], NDArray[np.float32]]
) -> tuple[list[Pose], list[TrackedPair]]:
    """Return the poses of a finished track and the registrations that locate them, lost frames tracked backwards.

    Parameters
    ----------
    poses : sequence of Pose
        As tracked, one for every frame.
    tracker : Tracker
        That tracked them.
    image : callable
        Returns the image (n, n) of a frame by its index.

    Returns
    -------
    poses : list of Pose
        Segments that a frame between them connects are one.
    links : list of TrackedPair
        Those of the tracker that later ones bear out, but for those after jolts, and those that were added.
    """
    shutter = tracker.grid.shutter
    links = borne_out(poses, tracker.links)
    result = located(poses, links, shutter)
    # a first registration backwards has no others before it that it could be compared with
    least = np.median([link.registration.at_half for link in links] or [0.0]) - JOLTED_FALL
    registrar = Registrar(tracker.grid.upside_down())
    registrar.fall_of_correlation = JOLTED_FALL
    for begin, end in _stretches(result):
        again, backwards = Tracker(registrar, tracker.turn_rate), []
        for frame in range(end - 1, begin - 1, -1):
            again.slot()[:] = image(frame)[::-1]
            backwards.append(again.add())
            again.skip(tracker.lost.get(frame, 0))
        alike = [link for link in again.links if link.registration.at_half >= least]
        found = borne_out(backwards, alike)
        ahead = {end - 1 - k: pose for k, pose in enumerate(located(backwards, found, shutter))}
        added = [_forwards(link, end - 1, result) for link in found]
        links += _joined(result, {k: pose for k, pose in ahead.items() if pose.state is TrackingState.TRACKED}, added)
    if FIELD * registrar.grid.diameter > JOLTED_READ * shutter.line_periods_per_frame:
        links = without_jolts(links)
    return settle(result, within_segments(result, links)), links


def _stretches(poses: Sequence[Pose]) -> list[tuple[int, int]]:
    """Return where frames are missing before tracked ones, with their context: the first, and the one after the last.

    Parameters
    ----------
    poses : sequence of Pose
        One for every frame.
    """
    missing = np.array([pose.state is not TrackingState.TRACKED for pose in poses], bool)
    missing[np.flatnonzero(~missing).max(initial=0) :] = False
    near = binary_dilation(missing, iterations=CONTEXT_FRAMES)
    ends = np.flatnonzero(np.diff(near, prepend=False, append=False))
    return list(zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True))


def _joined(poses: list[Pose], found: Mapping[int, Pose], links: Sequence[TrackedPair]) -> list[TrackedPair]:
    """Place frames that were found into the segments after them; return the registrations that locate frames or join.

    Parameters
    ----------
    poses : list of Pose
        One for every frame; changed.
    found : mapping of int to Pose
        Tracked backwards, by the frames' numbers.
    links : sequence of TrackedPair
        Registrations of these, the latest first.
    """
    used = []
    for link in links:
        if link.later not in found or link.earlier not in found or link.registration.odds < MIN_ODDS_NATS:
            continue
        before, after = poses[link.earlier], poses[link.later]
        if after.state is not TrackingState.TRACKED:
            segment = 1 + max(pose.segment for pose in poses)
            after = poses[link.later] = _timely(found[link.later]).placed(0j, 0.0, segment)
        angle = after.angle - link.registration.turn
        at = after.at - rect(1, after.angle) * complex(*link.displacement)
        if before.state is not TrackingState.TRACKED:
            poses[link.earlier] = _timely(found[link.earlier]).placed(at, angle, after.segment)
        elif before.segment != after.segment:
            move = Correction.between(before.placed(at, angle, after.segment), before)
            poses[:] = [move.of(pose) if pose.segment == after.segment else pose for pose in poses]
        else:
            continue
        used.append(link)
    return used


def _timely(pose: Pose) -> Pose:
    """Return a pose of a frame tracked upside down and backwards with its velocity upright and forwards."""
    return pose._replace(velocity=Velocity(pose.velocity.row, -pose.velocity.col))


def _forwards(link: TrackedPair, last: int, poses: Sequence[Pose]) -> TrackedPair:
    """Return a registration of frames tracked upside down and backwards as one of frames upright and forwards.

    Its displacement is that by the velocity of the earlier frame. Where that had been tracked with another one, as
    before a jolt, the velocity is as uncertain as they differ.

    Parameters
    ----------
    link : TrackedPair
        By the count of the backward tracker.
    last : int
        Frame that is its first.
    poses : sequence of Pose
        Forwards, one for every frame.
    """
    turn, (down, across) = link.registration.turn, link.displacement
    moved = rect(1, -turn) * complex(down, -across)
    earlier, later = last - link.later, last - link.earlier
    found = reversed_registration(link.registration)
    if poses[earlier].state is TrackingState.TRACKED:
        apart = np.subtract(_timely(poses[earlier]).velocity, found.velocity)
        found = found._replace(velocity_variance=found.velocity_variance + float(apart @ apart))
    return TrackedPair(earlier, later, Displacement(moved.real, moved.imag), found, link.periods)


def reversed_registration(link: PairRegistration) -> PairRegistration:
    """Return a registration with the frames exchanged and upside down: its warp, and the information on that.

    Parameters
    ----------
    link : PairRegistration
        Of two frames.
    """
    a, b, s, d = link.warp
    warp = Warp(1 / a, b / a, s / a, s * b / a - d)
    # the reverse of the reverse is the same, so that the slopes of the one by the other are those at the reverse
    a, b, s, _ = warp
    slopes = np.array(
        [[-1 / a**2, 0, 0, 0], [-b / a**2, 1 / a, 0, 0], [-s / a**2, 0, 1 / a, 0], [-s * b / a**2, s / a, b / a, -1]]
    )
    return link._replace(warp=warp, information=slopes.T @ link.information @ slopes)
