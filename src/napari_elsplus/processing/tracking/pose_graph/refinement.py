"""A finished track made better: loops closed, segments joined, errors shared out, nothing left that was guessed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
from napari_elsplus.processing.tracking.pose_graph.least_squares import Edge, Place, least_squares, least_squares_places
from napari_elsplus.processing.tracking.pose_graph.loop_closure import LINK_STRETCH_PX, LoopCloser, edge_covariance
from napari_elsplus.processing.tracking.pose_graph.rotation_review import review_rotation, turned_links
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, RollingShutter
    from napari_elsplus.processing.tracking.registration.pair_registration import (
        PairRegistration,
        PreparedFrame,
        Registrar,
    )

_NOWHERE: Final = Velocity(np.nan, np.nan)


def refine(
    poses: Sequence[Pose],
    links: Sequence[tuple[int, int, Displacement, PairRegistration]],
    registrar: Registrar,
    view: Callable[[int], PreparedFrame],
    rung: MotionModel = MotionModel.TRANSLATION,
) -> list[Pose]:
    """Close loops, join segments and solve for all positions at once.

    Parameters
    ----------
    poses : sequence of Pose
        What the tracker made of every frame.
    links : sequence of tuple
        The tracker's links.
    registrar : Registrar
        Of the same grid.
    view : callable
        Returns the prepared view of a frame by its index.
    rung : MotionModel
        What the frames asked for while they came. All links are asked once more, and if the probe turned, those from
        before that was noticed are corrected.

    Returns
    -------
    list of Pose
        One for every frame. Segments that were recognised as one carry the earlier one's number; predicted frames lie
        between tracked ones, and those after the last of a segment are lost.
    """
    settled = with_origins(settle(poses, links), links, registrar.grid.shutter)
    tracked = {k: pose.segment for k, pose in enumerate(settled) if pose.state is TrackingState.TRACKED}
    stretch = LINK_STRETCH_PX / registrar.grid.shutter.line_periods_per_frame
    if rung is MotionModel.TRANSLATION:
        rung = review_rotation(links, registrar, view)
    if rung is not MotionModel.TRANSLATION:
        links = turned_links(links, settled, registrar, view, rung)
    edges = [
        Edge(a, b, (moved.row, moved.col), edge_covariance(link, stretch), link.turn, link.zoom, link.turn_sigma)
        for a, b, moved, link in links
        if tracked.get(a, -1) == tracked.get(b, -2)
    ]
    if rung is not MotionModel.TRANSLATION:
        settled = _relaid(settled, edges, tracked)
    closer = LoopCloser(registrar, view, settled, rung)
    segments = sorted(set(tracked.values()))
    belongs = {segment: segment for segment in segments}
    for n, segment in enumerate(segments):
        edges += closer.close(segment)
        for earlier in segments[:n]:
            bridge = closer.join(earlier, segment)
            if bridge:
                edges += bridge
                belongs[segment] = belongs[earlier]
                break
    places: dict[int, Place] = {}
    for group in set(belongs.values()):
        first = min(k for k, segment in tracked.items() if belongs[segment] == group)
        places |= least_squares(edges, first, rung)
    number = {group: n for n, group in enumerate(sorted(set(belongs.values())))}
    moved = [_moved(pose, places.get(k), number, belongs) for k, pose in enumerate(settled)]
    return interpolate(moved)


def _relaid(poses: Sequence[Pose], edges: Sequence[Edge], tracked: dict[int, int]) -> list[Pose]:
    """Lay each segment by its own links, now that all of them tell how the probe turned."""
    result = list(poses)
    for segment in set(tracked.values()):
        first = min(k for k, other in tracked.items() if other == segment)
        for frame, place in least_squares_places([e for e in edges if tracked[e.earlier] == segment], first).items():
            result[frame] = result[frame]._replace(**place._asdict())
    return result


def settle(poses: Sequence[Pose], links: Sequence[tuple[int, int, Displacement, PairRegistration]]) -> list[Pose]:
    """Call lost what has no place among the others, now that it is known what came after.

    That is what was predicted and never linked to a later frame of its segment; and a first frame to which nothing was
    linked, where anything was to another: the probe was lifted then, or elsewhere.

    Parameters
    ----------
    poses : sequence of Pose
        One for every frame.
    links : sequence of tuple
        The tracker's registrations.
    """
    last = {pose.segment: k for k, pose in enumerate(poses) if pose.state is TrackingState.TRACKED}
    linked = {frame for earlier, later, *_ in links for frame in (earlier, later)}
    return [
        pose._replace(row=np.nan, col=np.nan, velocity=_NOWHERE, state=TrackingState.LOST)
        if (pose.state is TrackingState.PREDICTED and k > last.get(pose.segment, -1))
        or (pose.state is TrackingState.TRACKED and linked and k not in linked)
        else pose
        for k, pose in enumerate(poses)
    ]


def with_origins(
    poses: Sequence[Pose], links: Sequence[tuple[int, int, Displacement, PairRegistration]], shutter: RollingShutter
) -> list[Pose]:
    """Return the poses with velocity and place, from their first link, of the frames from which segments started.

    While frames came in nothing was known of them. One that is lost becomes the segment's first frame if another lost
    frame comes before it, so that segments stay apart.

    Parameters
    ----------
    poses : sequence of Pose
        One for every frame.
    links : sequence of tuple
        The tracker's registrations.
    shutter : RollingShutter
        Timing of the rows.
    """
    result = list(poses)
    for earlier, later, moved, link in links:
        first, after = result[earlier], result[later]
        begins = first.state is TrackingState.TRACKED and np.isnan(first.score)
        alone = earlier == 0 or result[earlier - 1].state is TrackingState.LOST
        if later != earlier + 1 or after.state is not TrackingState.TRACKED:
            continue
        if begins or (first.state is TrackingState.LOST and alone):
            before, _ = shutter.velocities(link.warp)
            row, col = after.row - moved.row, after.col - moved.col
            result[earlier] = Pose(after.segment, row, col, before, np.nan, np.nan, TrackingState.TRACKED)
    return result


def interpolate(poses: Sequence[Pose]) -> list[Pose]:
    """Put predicted frames onto the line between the tracked frames around them.

    Parameters
    ----------
    poses : sequence of Pose
        One for every frame; no predicted one is the first or the last of its segment.
    """
    result = list(poses)
    known = np.array([k for k, pose in enumerate(poses) if pose.state is TrackingState.TRACKED])
    for k, pose in enumerate(poses):
        if pose.state is not TrackingState.PREDICTED:
            continue
        n = int(np.searchsorted(known, k))
        a, b = int(known[n - 1]), int(known[n])
        part = (k - a) / (b - a)
        row = poses[a].row + part * (poses[b].row - poses[a].row)
        col = poses[a].col + part * (poses[b].col - poses[a].col)
        velocity = Velocity((poses[b].row - poses[a].row) / (b - a), (poses[b].col - poses[a].col) / (b - a))
        angle = poses[a].angle + part * (poses[b].angle - poses[a].angle)
        result[k] = pose._replace(row=row, col=col, velocity=velocity, angle=angle)
    return result


def _moved(pose: Pose, place: Place | None, number: dict[int, int], belongs: dict[int, int]) -> Pose:
    group = belongs.get(pose.segment)
    segment = pose.segment if group is None else number[group]
    return pose._replace(segment=segment) if place is None else pose._replace(segment=segment, **place._asdict())
