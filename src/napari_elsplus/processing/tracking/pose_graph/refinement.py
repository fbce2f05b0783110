"""Pose graph of a finished track: loops closed, segments joined, predicted frames interpolated."""

from __future__ import annotations

from cmath import rect
from math import nan
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState, frame_periods, tracked_frames
from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
from napari_elsplus.processing.tracking.pose_graph.correction import Correction
from napari_elsplus.processing.tracking.pose_graph.edge import Edge
from napari_elsplus.processing.tracking.pose_graph.least_squares import least_squares_positions
from napari_elsplus.processing.tracking.pose_graph.nodes import LINK_STRETCH_PX, KeyframeSelector, edge_covariance
from napari_elsplus.processing.tracking.pose_graph.uncertainty import with_uncertainties
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter
    from napari_elsplus.processing.tracking.pose_graph.graph import PoseGraph
    from napari_elsplus.processing.tracking.registration.pair_registration import TrackedPair

SURE_ODDS_NATS: Final = 200.0
"""Log posterior odds from which a registration stands even if no later one does; chosen on seeds 1000 to 1059 of
``benchmarks.studies.acceptance``: at 50, 20 registrations of sparse and jerky scenes are wrong where 15 are, and
without a bound right ones of rich tissue are withdrawn before each jolt."""
BREAK_FRAMES: Final = 2
"""Frames from the end of a segment within which the next one begins where a jolt parts them; chosen on seeds 3000 to
3019 and 920 to 959 of ``benchmarks.studies.acceptance``: with 1, one of eight wrong registrations is withdrawn."""
_SOLVED_AT: Final = 1.1
"""Factor by which the number of nodes grows between two solutions; chosen, so that their cost stays linear."""


def refine(
    poses: Sequence[Pose], links: Sequence[TrackedPair], graph: PoseGraph, model: MotionModel = MotionModel.TRANSLATION,
    lost: Mapping[int, int] | None = None,
) -> list[Pose]:  # fmt: skip
    """Return the poses that the pose graph corrects once all nodes are in it: loops closed, segments joined.

    Parameters
    ----------
    poses : sequence of Pose
        Of :func:`located`, one for every frame.
    links : sequence of TrackedPair
        The registrations that locate them.
    graph : PoseGraph
        Empty.
    model : MotionModel
        Model beside translations.
    lost : mapping of int to int, optional
        How many frames were lost before some.

    Returns
    -------
    list of Pose
        One for every frame. Segments are counted from 0, the first frame of each at (0, 0) and upright; predicted
        frames are interpolated between tracked ones, and those after the last of a segment are lost. Uncertainties are
        those of :func:`~.uncertainty.with_uncertainties`.
    """
    tracked = tracked_frames(poses)
    registered = {link.later: link for link in reversed(links)}  # the first of several, as the tracker's come first
    selector, solved = KeyframeSelector(graph.grid), 0
    for k in tracked:
        for node in selector.add(k, poses[k], registered.get(k)):
            graph.add(node, model)
        if len(graph.nodes) > _SOLVED_AT * solved:
            graph.solve()
            solved = len(graph.nodes)
    for node in selector.end():
        graph.add(node, model)
    graph.register_deferred()
    graph.solve()
    placed = from_origins(graph.corrections.of_poses(range(len(poses)), poses))
    stretch = LINK_STRETCH_PX / graph.grid.shutter.line_periods_per_frame
    within = within_segments(poses, links)
    edges = [Edge(a, b, complex(*moved), edge_covariance(link, stretch)) for a, b, moved, link, _ in within]
    at, angle = np.array([pose.at for pose in placed]), np.array([pose.angle for pose in placed])
    at = least_squares_positions([*edges, *graph.loops], at, angle)
    result = interpolate([pose._replace(row=z.real, col=z.imag) for pose, z in zip(placed, at.tolist(), strict=True)])
    return with_uncertainties(result, frame_periods(len(poses), lost or {}), within, graph)


def from_origins(poses: Sequence[Pose]) -> list[Pose]:
    """Return poses with segments counted from 0, the first tracked frame of each at (0, 0) and upright.

    Parameters
    ----------
    poses : sequence of Pose
        One for every frame.
    """
    firsts: dict[int, Pose] = {}
    for pose in poses:
        if pose.state is TrackingState.TRACKED:
            firsts.setdefault(pose.segment, pose)
    moves = {
        segment: Correction.between(first, first.placed(0.0, 0.0, number))
        for number, (segment, first) in enumerate(firsts.items())
    }
    result, move = [], Correction(0)
    for pose in poses:
        move = moves.get(pose.segment, move)
        result.append(move.of(pose))
    return result


def borne_out(poses: Sequence[Pose], links: Sequence[TrackedPair]) -> list[TrackedPair]:
    """Return the registrations that are sure or that a later one bears out; the others are withdrawn.

    Along a fibre, or after a jolt within a frame, a shift can be probable and wrong. The frame after it then mostly
    cannot be registered.

    Parameters
    ----------
    poses : sequence of Pose
        As tracked, one for every frame.
    links : sequence of TrackedPair
        The tracker's registrations.
    """
    followed = {frame for link in links for frame in (link.earlier, link.later - 1)} | {len(poses) - 1}
    standing = [link for link in links if link.registration.odds >= SURE_ODDS_NATS or link.later in followed]
    # a first registration that waited stands with the one that confirmed it
    begun = {link.earlier for link in standing}
    return [link for link in standing if poses[link.later].state is TrackingState.TRACKED or link.later in begun]


def without_jolts(links: Sequence[TrackedPair]) -> list[TrackedPair]:
    """Return the registrations but for those that begin a segment just after another, to which nothing joins them.

    Where a jolt parts the track, the first frame after it may show fibres only in rows read after the jolt. Its middle
    lies elsewhere, which its registration with the next frame does not show.

    Parameters
    ----------
    links : sequence of TrackedPair
        Those of a finished track, with those tracked backwards, which join segments that no jolt parts.
    """
    reached = {link.later for link in links}
    return [
        link
        for link in links
        if link.earlier in reached
        or link.registration.odds >= SURE_ODDS_NATS
        or reached.isdisjoint(range(link.earlier - BREAK_FRAMES, link.earlier))
    ]


def located(poses: Sequence[Pose], links: Sequence[TrackedPair], shutter: RollingShutter) -> list[Pose]:
    """Return the poses with frames lost that no registration locates, and the first frame of each segment located.

    Parameters
    ----------
    poses : sequence of Pose
        As tracked, one for every frame.
    links : sequence of TrackedPair
        The tracker's registrations.
    shutter : RollingShutter
        Timing of the rows.
    """
    return with_origins(settle(poses, links), links, shutter)


def within_segments(poses: Sequence[Pose], links: Sequence[TrackedPair]) -> list[TrackedPair]:
    """Return the registrations between tracked frames of one segment.

    Others locate no frame: one that is registered to a lost frame alone is lost, too.

    Parameters
    ----------
    poses : sequence of Pose
        One for every frame.
    links : sequence of TrackedPair
        Registrations.
    """
    segment = [pose.segment if pose.state is TrackingState.TRACKED else nan for pose in poses]
    return [link for link in links if segment[link.earlier] == segment[link.later]]


def settle(poses: Sequence[Pose], links: Sequence[TrackedPair]) -> list[Pose]:
    """Return the poses with frames lost that no registration locates.

    These are predicted frames after the last tracked one of their segment, a frame whose registration was withdrawn,
    and a first frame to which none is registered where others are: the probe was lifted then, or elsewhere.

    Parameters
    ----------
    poses : sequence of Pose
        One for every frame.
    links : sequence of TrackedPair
        The tracker's registrations.
    """
    located = {frame for link in links for frame in (link.earlier, link.later)} or {0}
    tracked = [pose.state is TrackingState.TRACKED and k in located for k, pose in enumerate(poses)]
    last = {pose.segment: k for k, pose in enumerate(poses) if tracked[k]}
    return [
        pose if tracked[k] or (pose.state is TrackingState.PREDICTED and k <= last.get(pose.segment, -1)) else pose.lost
        for k, pose in enumerate(poses)
    ]


def with_origins(poses: Sequence[Pose], links: Sequence[TrackedPair], shutter: RollingShutter) -> list[Pose]:
    """Return the poses with those of the frames from which segments started, derived from their first registration.

    While frames came their velocity and position were not known. One that is lost becomes the segment's first frame if
    another lost frame comes before it, so that segments stay apart.

    Parameters
    ----------
    poses : sequence of Pose
        One for every frame.
    links : sequence of TrackedPair
        The tracker's registrations.
    shutter : RollingShutter
        Timing of the rows.
    """
    result = list(poses)
    # two of them begin a segment where the first had to wait
    for earlier, later, moved, link, periods in reversed(links):
        first, after = result[earlier], result[later]
        begins = first.state is TrackingState.TRACKED and np.isnan(first.score)
        alone = earlier == 0 or np.isnan(result[earlier - 1].score)
        if later != earlier + 1 or after.state is not TrackingState.TRACKED:
            continue
        if begins or (first.state is TrackingState.LOST and alone):
            at, angle = after.at - rect(1, after.angle) * complex(*moved), after.angle - link.turn
            velocity, _ = shutter.velocities(link.warp, periods)
            first = first._replace(velocity=velocity, score=np.nan, sigma=np.nan, state=TrackingState.TRACKED)
            result[earlier] = first.placed(at, angle, after.segment)
    return result


def interpolate(poses: Sequence[Pose]) -> list[Pose]:
    """Return the poses with predicted ones interpolated linearly between the tracked ones around them.

    Parameters
    ----------
    poses : sequence of Pose
        One for every frame; no predicted one is the first or the last of its segment.
    """
    result = list(poses)
    known = np.array(tracked_frames(poses), int)
    at, angle = np.array([poses[k].at for k in known]), np.array([poses[k].angle for k in known])
    velocity = np.diff(at) / np.diff(known)
    for k, pose in enumerate(poses):
        if pose.state is TrackingState.PREDICTED:
            v = velocity[np.searchsorted(known, k) - 1].item()
            moving = pose._replace(velocity=Velocity(v.real, v.imag))
            there, turned = np.interp(k, known, at), np.interp(k, known, angle)
            result[k] = moving.placed(complex(there), float(turned), pose.segment)
    return result
