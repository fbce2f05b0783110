"""Pose graph: nodes along the track, edges between them, and the poses that agree best with all edges.

The tracker registers frame after frame, and its errors add up. Nodes are taken from its track
(``pose_graph.keyframes``) and registered with earlier ones that show the same place: within a segment those whose poses
lie near, in other segments those that their thumbnails recognise (``pose_graph.place_recognition``). Live, the graph
grows in a thread of its own and is marginalised beyond a number of nodes; a finished track is solved by the same graph
without that bound.
"""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement
from napari_elsplus.processing.tracking.pose_graph.correction import Correction, Corrections
from napari_elsplus.processing.tracking.pose_graph.least_squares import UNKNOWN_TURN, Edge, least_squares
from napari_elsplus.processing.tracking.pose_graph.marginalisation import marginalised_edges, retained_nodes
from napari_elsplus.processing.tracking.pose_graph.place_recognition import PlaceIndex
from napari_elsplus.processing.tracking.pose_graph.relative_pose import (
    AGREEMENT_PX,
    agree,
    displacement_between,
    joining,
)
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel, turned_by

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.pose_graph.keyframes import Node
    from napari_elsplus.processing.tracking.pose_graph.node_registration import NodeRegistration
    from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame

REACH: Final = 0.45
"""Distance up to which nodes of a segment are registered, bundle diameters; chosen: half of the field is common."""
AWAY: Final = 1.0
"""Path between two nodes, bundle diameters, from which an edge closes a loop; derived: before it they are in view."""
EDGES_PER_NODE: Final = 3
"""Edges that close loops, of each node; chosen: one wrong edge is outvoted."""
MAX_CANDIDATES: Final = 3
"""Nodes of other segments that a node is registered with; chosen: the right one ranks first but for rare ties."""
MAX_NODES: Final = 1500
"""Nodes from which on some are marginalised, down to two thirds; chosen: solving then takes some 0.1 s."""
_LANDMARK_SPACING: Final = 0.4
"""Distance between the nodes by which a segment is recognised, beside its ends, bundle diameters; chosen: a view within
the segment overlaps one of them by half."""
_DRIFT: Final = 0.01
"""Largest drift of a track, fraction of the path; chosen, ten times that of jerky recordings."""
_GROWTH: Final = 1.25
"""Factor by which the number of nodes grows between two marginalisations; chosen, so that its cost stays linear."""
TURNS_PER_NODE: Final = 2
"""Edges from before the rotation was modelled whose angle is estimated with each new node."""
_GUESSED_TURN_SIGMA: Final = 0.5
"""Standard deviation of the angle of an edge that could not be registered with one, radians; chosen, large."""


class PoseGraph:
    """Nodes, edges and corrected poses; used by one thread.

    Parameters
    ----------
    grid : Grid
        Tracking grid.
    registration : NodeRegistration
        Registers two nodes.
    view : callable
        Returns the prepared frame of a node by the number of its frame, or None if it is no longer kept.

    Attributes
    ----------
    grid : Grid
        As given.
    nodes : list of Node
        In the order in which they were added.
    places : list of Pose
        Their corrected poses.
    closed : int
        Edges that closed a loop or joined segments, so far.
    """

    def __init__(self, grid: Grid, registration: NodeRegistration, view: Callable[[int], PreparedFrame | None]) -> None:
        self.grid = grid
        self._registration, self._frame = registration, view
        self._diameter = grid.diameter
        self._index = PlaceIndex(grid)
        self.nodes: list[Node] = []
        self.places: list[Pose] = []
        self.closed = 0
        self._model = MotionModel.TRANSLATION
        self._where = np.zeros((256, 3))
        """Row and column of each node, and path along the track up to it, pixels."""
        self._group = np.zeros(256, np.int64)
        self._landmark = np.zeros(256, bool)
        self._chain: list[Edge] = []
        self._loops: list[Edge] = []
        self._bridges: dict[tuple[int, int], list[Edge]] = {}
        self._newest: dict[int, int] = {}
        self._deferred: list[int] = []
        self._heading: dict[int, float] = {}
        self._turns_unknown = False
        self._unsolved: set[int] = set()
        self._limit = MAX_NODES

    def add(self, node: Node, model: MotionModel = MotionModel.TRANSLATION, *, everywhere: bool = True) -> bool:
        """Add a node and register it with others; return True if :meth:`solve` will change poses.

        Parameters
        ----------
        node : Node
            Registered with others if its frame is kept.
        model : MotionModel
            Model beside translations.
        everywhere : bool
            False to defer the search in other segments to :meth:`register_deferred`.
        """
        number, segment = len(self.nodes), node.pose.segment
        before = self._newest.get(segment)
        place = self.correction(segment).of(node.pose)
        self._model = model
        self._heading.setdefault(place.segment, self._orientation(number - 1) if number else 0.0)
        self.nodes.append(node)
        self.places.append(place)
        self._newest[segment] = number
        if number == len(self._where):
            self._where, self._group, self._landmark = (
                np.concatenate([values, np.zeros_like(values)]) for values in (self._where, self._group, self._landmark)
            )
        gone = AWAY * self._diameter if before is None else node.gone_px
        path = gone + (self._where[number - 1, 2] if number else 0.0)
        self._where[number], self._group[number] = (place.row, place.col, path), place.segment
        if before is not None:
            self._chain.append(self._along(before, number))
        elif number:
            self._mark(number - 1, spacing_px=0.0)
        found = []
        if self._view(number) is not None:
            self._mark(number, _LANDMARK_SPACING * self._diameter)
            found = self._revisits(number)
            if not found and everywhere:
                found = self._recognised(number)
            elif not found:
                self._deferred.append(number)
        self._extend(found)
        self._turns_unknown |= any(edge.turn_sigma >= UNKNOWN_TURN for edge in (*self._chain[-1:], *found))
        if node.upright is not None:
            self._unsolved.add(self.places[number].segment)
        return self._register_turns(TURNS_PER_NODE) or bool(found) or node.upright is not None

    def register_deferred(self, limit: int | None = None) -> bool:
        """Do what was left for when the probe rests; return True if :meth:`solve` will change poses.

        Parameters
        ----------
        limit : int, optional
            Number of registrations of each kind at most; all by default.
        """
        count = len(self._deferred) if limit is None else limit
        now, self._deferred = self._deferred[:count], self._deferred[count:]
        found = [edge for number in now if self._view(number) is not None for edge in self._recognised(number)]
        self._extend(found)
        return self._register_turns(limit) or bool(found)

    def solve(self) -> bool:
        """Solve for the poses of all segments with new edges; return True if there were any."""
        groups, self._unsolved = self._unsolved, set()
        for group in groups:
            members = np.flatnonzero(self._group[: len(self.nodes)] == group)
            edges = [edge for edge in (*self._chain, *self._loops) if self._group[edge.earlier] == group]
            if not edges:
                continue
            first = self.places[int(members[0])]
            base = Correction(group, first.row, first.col, first.angle)
            for number, place in least_squares(edges, int(members[0]), self._model).items():
                self.places[number] = base.of(self.places[number]._replace(**place._asdict()))
            self._where[members, :2] = [(self.places[k].row, self.places[k].col) for k in members.tolist()]
        return bool(groups)

    def correction(self, segment: int) -> Correction:
        """Return the correction of the newest frames of one of the tracker's segments."""
        newest = self._newest.get(segment)
        if newest is None:
            return Correction(segment)
        return Correction.between(self.nodes[newest].pose, self.places[newest])

    @property
    def corrections(self) -> Corrections:
        """Those along the whole track."""
        known: dict[int, list[tuple[int, Correction]]] = {}
        for node, place in zip(self.nodes, self.places, strict=True):
            along = known.setdefault(node.pose.segment, [])
            here = Correction.between(node.pose, place)
            if node.upright is not None:
                frame, pose, turn = node.upright
                along.append((frame, Correction.between(pose, here.of(pose)._replace(angle=place.angle - turn))))
            along.append((node.frame, here))
        return Corrections(known)

    @property
    def loops(self) -> list[Edge]:
        """Edges that close loops or join segments, between the numbers of frames."""
        frame = [node.frame for node in self.nodes]
        return [edge._replace(earlier=frame[edge.earlier], later=frame[edge.later]) for edge in self._loops]

    def remove(self, group: int) -> None:
        """Remove all nodes and edges of a segment.

        Parameters
        ----------
        group : int
            Segment as the graph numbers them: the first of those that were joined.
        """
        self._retain(self._group[: len(self.nodes)] != group)
        self._unsolved.discard(group)

    def marginalise(self, kept: Callable[[Node], bool]) -> None:
        """Marginalise nodes whose frames are no longer kept where there are many; the others get new numbers.

        Parameters
        ----------
        kept : callable
            Returns True if a node's frame is kept.
        """
        count = len(self.nodes)
        if count <= self._limit:
            return
        segment = np.array([node.pose.segment for node in self.nodes])
        free = np.array([not kept(node) and node.upright is None for node in self.nodes])
        stays = retained_nodes(self._where[:count, 2], segment, free, 2 * MAX_NODES // 3)
        self._chain, self._loops = marginalised_edges(self._chain, self._loops, stays)
        self._retain(stays)
        self._limit = max(MAX_NODES, int(_GROWTH * len(self.nodes)))

    def _retain(self, stays: NDArray[np.bool_]) -> None:
        """Remove all but some nodes (n,), and the edges that end at them; the others get new numbers."""
        number, left = (np.cumsum(stays) - 1).tolist(), np.flatnonzero(stays).tolist()

        def renumbered(edges: Iterable[Edge]) -> list[Edge]:
            within = (edge for edge in edges if stays[edge.earlier] and stays[edge.later])
            return [edge._replace(earlier=number[edge.earlier], later=number[edge.later]) for edge in within]

        self._chain, self._loops = renumbered(self._chain), renumbered(self._loops)
        self._bridges = {pair: renumbered(edges) for pair, edges in self._bridges.items()}
        self.nodes, self.places = [self.nodes[k] for k in left], [self.places[k] for k in left]
        for values in (self._where, self._group, self._landmark):
            values[: len(left)], values[len(left) :] = values[left], 0
        self._newest = {segment: number[k] for segment, k in self._newest.items() if stays[k]}
        self._deferred = [number[k] for k in self._deferred if stays[k]]
        self._index.retain({node.frame for node in self.nodes})

    # edges

    def _view(self, number: int) -> PreparedFrame | None:
        return self._frame(self.nodes[number].frame)

    def _along(self, earlier: int, later: int) -> Edge:
        """Return the edge between two successive nodes of the tracker."""
        a, node = self.nodes[earlier].pose, self.nodes[later]
        moved = displacement_between(a, node.pose)
        turn = node.pose.angle - a.angle
        return Edge(earlier, later, (moved.row, moved.col), node.covariance, turn, node.turn_sigma)

    def _revisits(self, number: int) -> list[Edge]:
        """Return edges to nodes of the same segment that lie beside this one but far back along the path."""
        row, col, path = self._where[number]
        where, group = self._where[:number], self._group[:number]
        distance = np.hypot(where[:, 0] - row, where[:, 1] - col)
        near = (group == self._group[number]) & (path - where[:, 2] > AWAY * self._diameter)
        near &= distance <= REACH * self._diameter
        edges: list[Edge] = []
        nearest = np.flatnonzero(near)[np.argsort(distance[near])].tolist()
        kept = (earlier for earlier in nearest if self._view(earlier) is not None)
        for earlier in islice(kept, 2 * EDGES_PER_NODE):
            a, b = self.places[earlier], self.places[number]
            expected = displacement_between(a, b)
            edge = self._register(earlier, number, expected, b.angle - a.angle)
            drift_px = AGREEMENT_PX + _DRIFT * (path - where[earlier, 2])
            if edge is not None and np.hypot(*np.subtract(edge.displacement, expected)) < drift_px:
                edges.append(edge)
            if len(edges) == EDGES_PER_NODE:
                break
        return edges

    def _recognised(self, number: int) -> list[Edge]:
        """Return edges that join this node's segment with others in which its place is recognised."""
        groups = self._group[: len(self.nodes)]
        others = np.flatnonzero((groups != groups[number]) & self._landmark[: len(groups)])
        if not len(others):
            return []
        view, angle = self._view(number), self._orientation(number)
        assert view is not None
        thumbnail = self._index.thumbnail(view, self.places[number]._replace(angle=angle))
        frames = {self.nodes[k].frame: k for k in others.tolist()}
        edges: list[Edge] = []
        for candidate in self._index.candidates(thumbnail, list(frames), MAX_CANDIDATES):
            other = frames[candidate.frame]
            if groups[other] == groups[number]:
                continue
            row, col = turned_by(-angle) @ candidate.displacement
            turn = angle - self._orientation(other)
            edge = self._register(other, number, Displacement(float(row), float(col)), turn, anywhere=True)
            if edge is not None:
                edges += self._joined(edge)
        return edges

    def _joined(self, edge: Edge) -> list[Edge]:
        """Return the edges that join two segments once one is sure or two without a common node agree, else none."""
        first, second = sorted((int(self._group[edge.earlier]), int(self._group[edge.later])))
        pairs = self._bridges.setdefault((first, second), [])
        agreed = [pair for pair in pairs if agree(pair, edge, self.places)]
        pairs.append(edge)
        disjoint = any({pair.earlier, pair.later}.isdisjoint({edge.earlier, edge.later}) for pair in agreed)
        if not disjoint and not edge.sure:
            return []
        self._join(edge)
        return [*agreed, edge]

    def _register(
        self, earlier: int, later: int, expected: Displacement, turn: float, *, anywhere: bool = False
    ) -> Edge | None:
        a, b = self._view(earlier), self._view(later)
        if a is None or b is None:
            return None
        pair, poses = (earlier, later), (self.places[earlier], self.places[later])
        return self._registration.register(pair, poses, (a, b), expected, turn, self._model, anywhere=anywhere)

    def _extend(self, edges: list[Edge]) -> None:
        self._loops += edges
        self.closed += len(edges)
        self._unsolved |= {self.places[edge.earlier].segment for edge in edges}

    # segments

    def _mark(self, number: int, spacing_px: float) -> None:
        """Add the thumbnail of a node to the index if its segment has none within a distance."""
        own = self._landmark[:number] & (self._group[:number] == self._group[number])
        near = np.hypot(*(self._where[:number, :2][own] - self._where[number, :2]).T) < spacing_px
        view, place = self._view(number), self.places[number]
        if view is None or near.any() or self._landmark[number]:
            return
        thumbnail = self._index.thumbnail(view, place._replace(angle=self._orientation(number)))
        self._index.add(self.nodes[number].frame, thumbnail)
        self._landmark[number] = True

    def _orientation(self, number: int) -> float:
        """Return the angle of a node, radians, as if the probe had not turned between segments."""
        return self.places[number].angle + self._heading.get(self.places[number].segment, 0.0)

    def _join(self, edge: Edge) -> None:
        """Move the later one of two segments into the earlier one."""
        group = max(int(self._group[edge.earlier]), int(self._group[edge.later]))
        moved = joining(edge, self.places, group)
        members = np.flatnonzero(self._group[: len(self.nodes)] == group)
        self._group[members] = moved.segment
        for number in members.tolist():
            self.places[number] = moved.of(self.places[number])
            self._where[number, :2] = self.places[number].row, self.places[number].col
        self._bridges = {pair: edges for pair, edges in self._bridges.items() if group not in pair}
        self._unsolved = (self._unsolved - {group}) | {moved.segment}

    # rotation

    def _register_turns(self, limit: int | None = None) -> bool:
        """Estimate the angles of edges from before the rotation was modelled, the newest first."""
        if self._model is MotionModel.TRANSLATION or not self._turns_unknown:
            return False
        count = 0
        for edges in (self._chain, self._loops):
            for k in reversed(range(len(edges))):
                if count == limit:
                    return True
                if edges[k].turn_sigma >= UNKNOWN_TURN:
                    edges[k] = self._turned(edges[k])
                    self._unsolved.add(self.places[edges[k].earlier].segment)
                    count += 1
        self._turns_unknown = False
        return count > 0

    def _turned(self, edge: Edge) -> Edge:
        """Return an edge registered once more with its angle, or with that of its nodes."""
        turn, there = self.places[edge.later].angle - self.places[edge.earlier].angle, Displacement(*edge.displacement)
        found = self._register(edge.earlier, edge.later, there, turn)
        if found is not None and found.turn_sigma < UNKNOWN_TURN:
            limit_px = AGREEMENT_PX + abs(found.turn) * np.hypot(*there)
            if np.hypot(*np.subtract(found.displacement, there)) < limit_px:
                return found
        return edge._replace(turn=turn, turn_sigma=_GUESSED_TURN_SIGMA)
