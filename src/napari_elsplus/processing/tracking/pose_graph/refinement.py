"""Pose graph of a finished track: loops closed, segments joined, predicted frames interpolated."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
from napari_elsplus.processing.tracking.pose_graph.correction import Correction
from napari_elsplus.processing.tracking.pose_graph.keyframes import KeyframeSelector
from napari_elsplus.processing.tracking.pose_graph.least_squares import Edge, least_squares_positions, upright_edges
from napari_elsplus.processing.tracking.pose_graph.node_registration import LINK_STRETCH_PX, edge_covariance
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel, turned_by

if TYPE_CHECKING:
    from collections.abc import Sequence

    from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, RollingShutter
    from napari_elsplus.processing.tracking.pose_graph.graph import PoseGraph
    from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration

    Links = Sequence[tuple[int, int, Displacement, PairRegistration]]
    """Earlier and later frame, displacement in the later one's orientation, and registration."""

_SOLVED_AT: Final = 1.1
"""Factor by which the number of nodes grows between two solutions; chosen, so that their cost stays linear."""


def refine(
    poses: Sequence[Pose], links: Links, graph: PoseGraph, model: MotionModel = MotionModel.TRANSLATION
) -> list[Pose]:
    """Return the poses that the pose graph corrects once all nodes are in it: loops closed, segments joined.

    Parameters
    ----------
    poses : sequence of Pose
        As tracked, one for every frame.
    links : sequence of tuple
        The tracker's registrations.
    graph : PoseGraph
        Empty.
    model : MotionModel
        Model beside translations.

    Returns
    -------
    list of Pose
        One for every frame. Segments are counted from 0, the first frame of each at (0, 0) and upright; predicted
        frames are interpolated between tracked ones, and those after the last of a segment are lost.
    """
    settled = with_origins(settle(poses, links), links, graph.grid.shutter)
    selector = KeyframeSelector(graph.grid)
    registered = {later: (earlier, later, link) for earlier, later, _, link in links}
    solved = 0
    for k, pose in enumerate(settled):
        if pose.state is not TrackingState.TRACKED:
            continue
        for node in selector.add(k, pose, registered.get(k)):
            graph.add(node, model)
        if len(graph.nodes) > _SOLVED_AT * solved:
            graph.solve()
            solved = len(graph.nodes)
    graph.register_deferred()
    graph.solve()
    corrections = graph.corrections
    placed = from_origins([corrections.of(k, pose) for k, pose in enumerate(settled)])
    stretch = LINK_STRETCH_PX / graph.grid.shutter.line_periods_per_frame
    tracked = {k: pose.segment for k, pose in enumerate(settled) if pose.state is TrackingState.TRACKED}
    edges = [
        Edge(a, b, (moved.row, moved.col), edge_covariance(link, stretch))
        for a, b, moved, link in links
        if tracked.get(a, -1) == tracked.get(b, -2)
    ]
    return interpolate(positioned(placed, [*edges, *graph.loops]))


def positioned(poses: Sequence[Pose], edges: Sequence[Edge]) -> list[Pose]:
    """Return the poses at the positions that agree best with the displacements between frames.

    Parameters
    ----------
    poses : sequence of Pose
        From :func:`from_origins`; their angles stay.
    edges : sequence of Edge
        Between tracked frames of the same segment.
    """
    upright = upright_edges(edges, {k: pose.angle for k, pose in enumerate(poses)})
    result = list(poses)
    for first in {poses[edge.earlier].segment: edge.earlier for edge in reversed(edges)}.values():
        own = [edge for edge in upright if poses[edge.earlier].segment == poses[first].segment]
        for k, (row, col) in least_squares_positions(own, first).items():
            result[k] = poses[k]._replace(row=row, col=col)
    return result


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
        segment: Correction.between(first, first._replace(segment=number, row=0.0, col=0.0, angle=0.0))
        for number, (segment, first) in enumerate(sorted(firsts.items()))
    }
    result, move = [], Correction(0)
    for pose in poses:
        move = moves.get(pose.segment, move)
        result.append(move.of(pose))
    return result


def settle(poses: Sequence[Pose], links: Links) -> list[Pose]:
    """Return the poses with frames lost that no registration locates.

    These are predicted frames after the last tracked one of their segment, and a first frame to which none is
    registered where others are: the probe was lifted then, or elsewhere.

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
        pose.lost
        if (pose.state is TrackingState.PREDICTED and k > last.get(pose.segment, -1))
        or (pose.state is TrackingState.TRACKED and linked and k not in linked)
        else pose
        for k, pose in enumerate(poses)
    ]


def with_origins(poses: Sequence[Pose], links: Links, shutter: RollingShutter) -> list[Pose]:
    """Return the poses with those of the frames from which segments started, derived from their first registration.

    While frames came their velocity and position were not known. One that is lost becomes the segment's first frame if
    another lost frame comes before it, so that segments stay apart.

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
    for earlier, later, moved, link in reversed(links):  # two of them begin a segment where the first had to wait
        first, after = result[earlier], result[later]
        begins = first.state is TrackingState.TRACKED and np.isnan(first.score)
        alone = earlier == 0 or np.isnan(result[earlier - 1].score)
        if later != earlier + 1 or after.state is not TrackingState.TRACKED:
            continue
        if begins or (first.state is TrackingState.LOST and alone):
            before, _ = shutter.velocities(link.warp)
            row, col = (after.row, after.col) - turned_by(after.angle) @ moved
            angle, place = after.angle - link.turn, (after.segment, float(row), float(col))
            result[earlier] = Pose(*place, before, np.nan, np.nan, TrackingState.TRACKED, angle)
    return result


def interpolate(poses: Sequence[Pose]) -> list[Pose]:
    """Return the poses with predicted ones interpolated linearly between the tracked ones around them.

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
