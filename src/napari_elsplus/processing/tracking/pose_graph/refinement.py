"""Pose graph of a finished track: loops closed, segments joined, predicted frames interpolated."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
from napari_elsplus.processing.tracking.pose_graph.graph import PoseGraph
from napari_elsplus.processing.tracking.pose_graph.keyframes import KeyframeSelector
from napari_elsplus.processing.tracking.pose_graph.least_squares import Edge, Place, least_squares
from napari_elsplus.processing.tracking.pose_graph.node_registration import (
    LINK_STRETCH_PX,
    FrameRegistration,
    edge_covariance,
)
from napari_elsplus.processing.tracking.pose_graph.rotation_review import review_rotation, turned_links
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, RollingShutter
    from napari_elsplus.processing.tracking.pose_graph.keyframes import Node
    from napari_elsplus.processing.tracking.registration.pair_registration import (
        PairRegistration,
        PreparedFrame,
        Registrar,
    )

    Links = Sequence[tuple[int, int, Displacement, PairRegistration]]
    """Earlier and later frame, displacement in the later one's orientation, and registration."""

_NOWHERE: Final = Velocity(np.nan, np.nan)
_SOLVED_AT: Final = 1.1
"""Factor by which the number of nodes grows between two solutions; chosen, so that their cost stays linear."""


def refine(
    poses: Sequence[Pose],
    links: Links,
    registrar: Registrar,
    view: Callable[[int], PreparedFrame],
    model: MotionModel = MotionModel.TRANSLATION,
) -> list[Pose]:
    """Return the poses of the solved pose graph: loops closed, segments joined.

    Parameters
    ----------
    poses : sequence of Pose
        As tracked, one for every frame.
    links : sequence of tuple
        The tracker's registrations.
    registrar : Registrar
        Of the same grid.
    view : callable
        Returns the prepared frame of an index.
    model : MotionModel
        As selected while frames came. All registrations are tested once more, and if the probe turned, those from
        before that was noticed are corrected.

    Returns
    -------
    list of Pose
        One for every frame. Segments that were joined carry the number of the first; predicted frames are interpolated
        between tracked ones, and those after the last of a segment are lost.
    """
    settled = with_origins(settle(poses, links), links, registrar.grid.shutter)
    if model is MotionModel.TRANSLATION:
        model = review_rotation(links, registrar, view)
    if model is not MotionModel.TRANSLATION:
        links = turned_links(links, settled, registrar, view, model)
    stretch = LINK_STRETCH_PX / registrar.grid.shutter.line_periods_per_frame
    tracked = {k: pose.segment for k, pose in enumerate(settled) if pose.state is TrackingState.TRACKED}
    edges = [
        Edge(a, b, (moved.row, moved.col), edge_covariance(link, stretch), link.turn, link.zoom, link.turn_sigma)
        for a, b, moved, link in links
        if tracked.get(a, -1) == tracked.get(b, -2)
    ]
    if model is not MotionModel.TRANSLATION:
        settled = relocated(settled, edges, model)
    graph = PoseGraph(registrar.grid, FrameRegistration(registrar), lambda number: view(graph.nodes[number].frame))
    selector = KeyframeSelector(registrar.grid)
    registered = {later: (earlier, later, link) for earlier, later, _, link in links}
    edges += add_all(graph, (node for k in tracked for node in selector.add(k, settled[k], registered.get(k))), model)
    joined = [pose._replace(segment=graph.correction(pose.segment).segment) for pose in settled]
    return interpolate(relocated(joined, edges, model))


def add_all(graph: PoseGraph, nodes: Iterable[Node], model: MotionModel = MotionModel.TRANSLATION) -> list[Edge]:
    """Add the nodes of a finished track to a pose graph; return its edges that close loops or join segments.

    Parameters
    ----------
    graph : PoseGraph
        Empty.
    nodes : iterable of Node
        In the order of their frames.
    model : MotionModel
        Model beside translations.

    Returns
    -------
    list of Edge
        Between the numbers of frames.
    """
    solved = 0
    for node in nodes:
        graph.add(node, model)
        if len(graph.nodes) > _SOLVED_AT * solved:
            graph.solve()
            solved = len(graph.nodes)
    graph.register_deferred()
    return graph.loops


def relocated(poses: Sequence[Pose], edges: Sequence[Edge], model: MotionModel) -> list[Pose]:
    """Return poses solved for by edges: segments counted from 0, the first frame of each at (0, 0) and upright.

    Parameters
    ----------
    poses : sequence of Pose
        One for every frame.
    edges : sequence of Edge
        Between tracked frames of the same segment.
    model : MotionModel
        Model beside translations.
    """
    firsts: dict[int, int] = {}
    for k, pose in enumerate(poses):
        if pose.state is TrackingState.TRACKED:
            firsts.setdefault(pose.segment, k)
    number = {segment: k for k, segment in enumerate(sorted(firsts))}
    places: dict[int, Place] = {}
    for segment, first in firsts.items():
        places |= least_squares([e for e in edges if poses[e.earlier].segment == segment], first, model)
    result, segment = [], 0
    for k, pose in enumerate(poses):
        segment = number.get(pose.segment, segment)
        place = places.get(k)
        result.append(pose._replace(segment=segment, **({} if place is None else place._asdict())))
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
        pose._replace(row=np.nan, col=np.nan, velocity=_NOWHERE, state=TrackingState.LOST)
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
            row, col = after.row - moved.row, after.col - moved.col
            result[earlier] = Pose(after.segment, row, col, before, np.nan, np.nan, TrackingState.TRACKED)
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
