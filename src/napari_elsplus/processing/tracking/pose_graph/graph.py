"""Pose graph: nodes along the track, edges between them, and the poses that agree best with all edges.

The tracker registers frame after frame, and its errors add up. Nodes are taken from its track
(``pose_graph.nodes``) and registered with earlier ones that show the same place: within a segment those whose poses
lie near, in other segments those that their thumbnails recognise (``pose_graph.place_recognition``). Live, the graph
grows in a thread of its own, in which the newest of many nodes are solved for; a finished track is solved by the same
graph without that bound.
"""

from __future__ import annotations

from cmath import rect
from itertools import compress, islice
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.tracking.pose_graph.correction import Correction, Corrections
from napari_elsplus.processing.tracking.pose_graph.edge import UNKNOWN_TURN, Edge
from napari_elsplus.processing.tracking.pose_graph.least_squares import least_squares
from napari_elsplus.processing.tracking.pose_graph.place_recognition import PlaceRecognition
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.pose_graph.nodes import Node, NodeRegistration
    from napari_elsplus.processing.tracking.registration.masked_correlation import CoarseImage
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
"""Newest nodes that are solved for while a track grows, and number from which those before are thinned out; chosen:
solving then takes some 0.1 s."""
_LANDMARK_SPACING: Final = 0.4
"""Distance between the nodes by which a segment is recognised, beside its ends, bundle diameters; chosen: a view within
the segment overlaps one of them by half."""
_TURN_STEP_RAD: Final = float(np.deg2rad(5.0))
"""Step of the turns between segments at which a place is sought once rotation is modelled, and largest turn by which
one edge joins them; chosen: thumbnails tolerate 3 degrees and more, and turned by more one fibre resembles any."""
_TURN_STEPS: Final = 3
"""Steps to either side; chosen: up to 15 degrees."""
_GROWTH: Final = 1.25
"""Factor by which the number of nodes grows before they are thinned out again; chosen: its cost stays linear."""
TURNS_PER_NODE: Final = 2
"""Edges from before the rotation was modelled whose angle is estimated with each new node."""
_GUESSED_TURN_SIGMA: Final = 0.5
"""Standard deviation of the angle of an edge that could not be registered with one, radians; chosen, large."""
AGREEMENT_PX: Final = 3.0
"""Distance of two edges' predictions up to which they agree; chosen, far above the scatter of edges in dim light
(0.3 px)."""
_AGREEMENT_RAD: Final = 0.02
"""The same of angles, radians; derived: 2 px at the rim."""
_PLACE: Final = np.dtype([("segment", np.int64), ("at", np.complex128), ("angle", np.float64), ("path", np.float64)])
"""Corrected place of a node: segment, position, angle; and the path along the track up to it, pixels."""


class PoseGraph:
    """Nodes, edges and corrected poses; used by one thread.

    Parameters
    ----------
    registration : NodeRegistration
        Registers two nodes.
    view : callable
        Returns the prepared frame of a node by the number of its frame, or None if it is no longer kept.

    Attributes
    ----------
    grid : Grid
        Tracking grid.
    nodes : list of Node
        In the order in which they were added.
    closed : int
        Edges that closed a loop or joined segments, so far.
    unsolved : bool
        True if :meth:`solve` will change poses.
    noise_share : float
        That of the registration.
    """

    def __init__(self, registration: NodeRegistration, view: Callable[[int], PreparedFrame | None]) -> None:
        self.grid, self.noise_share = registration.grid, registration.noise_share
        self._registration, self._frame = registration, view
        self._diameter = self.grid.diameter
        self._recognition = PlaceRecognition(self.grid)
        self._thumbnails: dict[int, CoarseImage] = {}
        self.nodes: list[Node] = []
        self.closed = 0
        self.unsolved = False
        self._model = MotionModel.TRANSLATION
        self._places = np.zeros(0, _PLACE)
        self._chain: list[Edge] = []
        self._loops: list[Edge] = []
        self._bridges: dict[frozenset[int], list[Edge]] = {}
        self._deferred: list[int] = []
        self._heading: dict[int, float] = {}
        self._limit = 2 * MAX_NODES

    def place(self, number: int) -> Pose:
        """Return the corrected pose of a node, given its number."""
        segment, at, angle, _ = self._places[number].item()
        return self.nodes[number].pose.placed(at, angle, segment)

    def add(self, node: Node, model: MotionModel = MotionModel.TRANSLATION, *, everywhere: bool = True) -> None:
        """Add a node and register it with others.

        Parameters
        ----------
        node : Node
            Registered with others if its frame is kept.
        model : MotionModel
            Model beside translations.
        everywhere : bool
            False to defer the search in other segments to :meth:`register_deferred`.
        """
        number, place, gone, self._model = len(self.nodes), node.pose, AWAY * self._diameter, model
        before = self.nodes[-1].pose if self.nodes else None
        follows = before is not None and before.segment == place.segment
        if before is not None and follows:
            place, gone = Correction.between(before, self.place(number - 1)).of(node.pose), node.gone_px
            along = Edge.between(number - 1, number, before, node.pose)
            self._chain.append(along._replace(covariance=node.covariance, turn_sigma=node.turn_sigma))
        elif number:
            self._mark(number - 1, spacing_px=0.0)
        self._heading.setdefault(place.segment, self._orientation(number - 1) if number else 0.0)
        self.nodes.append(node)
        path = gone + (self._places["path"][-1] if number else 0.0)
        self._places = np.append(self._places, np.array([(place.segment, place.at, place.angle, path)], _PLACE))
        self.unsolved |= node.upright is not None
        if self._view(number) is not None:
            self._mark(number, _LANDMARK_SPACING * self._diameter)
            found = self._revisits(number)
            if not found and everywhere:
                found = self._recognised(number)
            elif not found:
                self._deferred.append(number)
            self._extend(found)
        self._register_turns(TURNS_PER_NODE)

    def register_deferred(self, limit: int | None = None) -> None:
        """Do what was left for when the probe rests.

        Parameters
        ----------
        limit : int, optional
            Number of registrations of each kind at most; all by default.
        """
        for number in self._deferred[:limit]:
            if self._view(number) is not None:
                self._extend(self._recognised(number))
        del self._deferred[:limit]
        self._register_turns(limit)

    def solve(self, newest: int | None = None) -> None:
        """Solve for the poses of nodes if there are new edges.

        Parameters
        ----------
        newest : int, optional
            Number of nodes that are solved for, while those before them stay where they are; all by default.
        """
        if self.unsolved:
            places, first = self._places, 0 if newest is None else max(0, len(self.nodes) - newest)
            edges = [edge for edge in (*self._chain, *self._loops) if edge.later >= first]
            places["at"], places["angle"] = least_squares(edges, places["at"], places["angle"], first)
        self.unsolved = False

    @property
    def corrections(self) -> Corrections:
        """Those along the whole track."""
        known: dict[int, list[tuple[int, Correction]]] = {}
        for number, node in enumerate(self.nodes):
            place, along = self.place(number), known.setdefault(node.pose.segment, [])
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
        self._retain(self._places["segment"] != group)
        self.unsolved = True

    def thin(self, kept: Callable[[Node], bool]) -> None:
        """Remove every second of many nodes that are neither solved for any more nor kept; others get new numbers.

        Parameters
        ----------
        kept : callable
            Returns True if a node's frame is kept.
        """
        if len(self.nodes) <= self._limit:
            return
        first = len(self.nodes) - MAX_NODES
        needed = {edge.earlier for edge in (*self._chain, *self._loops) if edge.later >= first}
        old = (k for k in range(first) if k not in needed)
        stays = np.ones(len(self.nodes), bool)
        stays[[k for k in old if self.nodes[k].upright is None and not kept(self.nodes[k])][::2]] = False
        self._retain(stays)
        self._limit = max(2 * MAX_NODES, int(_GROWTH * len(self.nodes)))

    def _retain(self, stays: NDArray[np.bool_]) -> None:
        """Remove all but some nodes (n,), and the edges that end at them; the others get new numbers."""
        number = {k: new for new, k in enumerate(np.flatnonzero(stays).tolist())}

        def renumbered(edges: Iterable[Edge]) -> list[Edge]:
            within = (edge for edge in edges if edge.earlier in number and edge.later in number)
            return [edge._replace(earlier=number[edge.earlier], later=number[edge.later]) for edge in within]

        self._chain, self._loops = renumbered(self._chain), renumbered(self._loops)
        self._bridges = {pair: renumbered(edges) for pair, edges in self._bridges.items()}
        self.nodes, self._places = list(compress(self.nodes, stays)), self._places[stays]
        self._deferred = [number[k] for k in self._deferred if k in number]
        self._thumbnails = {number[k]: thumbnail for k, thumbnail in self._thumbnails.items() if k in number}

    # edges

    def _view(self, number: int) -> PreparedFrame | None:
        return self._frame(self.nodes[number].frame)

    def _revisits(self, number: int) -> list[Edge]:
        """Return edges to nodes of the same segment that lie beside this one but far back along the path."""
        here, places = self._places[number], self._places[:number]
        distance, gone = abs(places["at"] - here["at"]), here["path"] - places["path"]
        near = (places["segment"] == here["segment"]) & (gone > AWAY * self._diameter)
        near &= distance <= REACH * self._diameter
        edges: list[Edge] = []
        nearest = np.flatnonzero(near)[np.argsort(distance[near])].tolist()
        kept = (earlier for earlier in nearest if self._view(earlier) is not None)
        for earlier in islice(kept, 2 * EDGES_PER_NODE):
            edge = self._register(Edge.between(earlier, number, self.place(earlier), self.place(number)))
            if edge is not None:
                edges.append(edge)
            if len(edges) == EDGES_PER_NODE:
                break
        return edges

    def _recognised(self, number: int) -> list[Edge]:
        """Return edges that join this node's segment with others in which its place is recognised."""
        groups = self._places["segment"]
        others = {k: thumbnail for k, thumbnail in self._thumbnails.items() if groups[k] != groups[number]}
        edges: list[Edge] = []
        if others:
            steps = 0 if self._model is MotionModel.TRANSLATION else _TURN_STEPS
            turns = [_TURN_STEP_RAD * step for step in range(-steps, steps + 1)]
            seen = {turn: self._thumbnail(number, turn) for turn in turns}
            for other, turn, _, displacement in self._recognition.candidates(seen, others, MAX_CANDIDATES):
                if groups[other] != groups[number]:
                    angle, of_other = self._orientation(number), self._orientation(other)
                    moved = rect(1, -angle - turn) * displacement
                    expected = Edge(other, number, moved, np.zeros((2, 2)), angle + turn - of_other)
                    edge = self._register(expected, anywhere=True)
                    if edge is not None:
                        sure = edge.sure and abs(edge.turn - angle + of_other) <= _TURN_STEP_RAD
                        edges += self._joined(edge._replace(sure=sure))
        return edges

    def _joined(self, edge: Edge) -> list[Edge]:
        """Return the edges that join two segments once one is sure or two without a common node agree, else none."""
        pose = self.place(edge.later)
        pairs = self._bridges.setdefault(frozenset(self._places["segment"][[edge.earlier, edge.later]].tolist()), [])
        seen, agreed = self._between_segments(edge, pose.segment).of(pose), []
        for pair in pairs:
            expected = self._between_segments(pair, pose.segment).of(pose)
            if abs(seen.at - expected.at) < AGREEMENT_PX and abs(seen.angle - expected.angle) < _AGREEMENT_RAD:
                agreed.append(pair)
        pairs.append(edge)
        disjoint = any({pair.earlier, pair.later}.isdisjoint({edge.earlier, edge.later}) for pair in agreed)
        if not disjoint and not edge.sure:
            return []
        self._join(edge)
        return [*agreed, edge]

    def _between_segments(self, edge: Edge, segment: int) -> Correction:
        """Return the correction that takes one of the two segments of an edge, given by its number, into the other."""
        here = self.place(edge.later)
        there = edge.from_pose(self.place(edge.earlier), here)
        return Correction.between(here, there) if here.segment == segment else Correction.between(there, here)

    def _register(self, expected: Edge, *, anywhere: bool = False) -> Edge | None:
        """Register the nodes of an expected edge; None where one is no longer kept or they cannot be registered."""
        ends = expected.earlier, expected.later
        a, b = (self._view(number) for number in ends)
        if a is None or b is None:
            return None
        nodes = self.nodes[ends[0]], self.nodes[ends[1]]
        return self._registration.register(expected, nodes, (a, b), self._model, anywhere=anywhere)

    def _extend(self, edges: list[Edge]) -> None:
        self._loops += edges
        self.closed += len(edges)
        self.unsolved |= bool(edges)

    # segments

    def _mark(self, number: int, spacing_px: float) -> None:
        """Keep the thumbnail of a node if its segment has none within a distance."""
        marked, here = self._places[list(self._thumbnails)], self._places[number]
        near = (marked["segment"] == here["segment"]) & (abs(marked["at"] - here["at"]) < spacing_px)
        if self._view(number) is not None and number not in self._thumbnails and not near.any():
            self._thumbnails[number] = self._thumbnail(number)

    def _thumbnail(self, number: int, turn: float = 0.0) -> CoarseImage:
        view = self._view(number)
        assert view is not None
        return self._recognition.thumbnail(view, self.nodes[number].pose.velocity, self._orientation(number) + turn)

    def _orientation(self, number: int) -> float:
        """Return the angle of a node, radians, as if the probe had not turned between segments."""
        segment, _, angle, _ = self._places[number].item()
        return float(angle + self._heading.get(segment, 0.0))

    def _join(self, edge: Edge) -> None:
        """Move the later one of two segments into the earlier one."""
        places = self._places
        into, group = sorted(places["segment"][[edge.earlier, edge.later]].tolist())
        moved, members = self._between_segments(edge, group), places["segment"] == group
        places["segment"][members] = into
        places["at"][members] = rect(1, moved.angle) * places["at"][members] + moved.shift
        places["angle"][members] += moved.angle
        self._bridges = {pair: edges for pair, edges in self._bridges.items() if group not in pair}

    # rotation

    def _register_turns(self, limit: int | None = None) -> None:
        """Estimate the angles of edges from before the rotation was modelled, the newest first."""
        if self._model is MotionModel.TRANSLATION:
            return
        unknown = (
            (edges, k)
            for edges in (self._chain, self._loops)
            for k in reversed(range(len(edges)))
            if edges[k].turn_sigma >= UNKNOWN_TURN
        )
        for edges, k in islice(unknown, limit):
            edges[k] = self._turned(edges[k])
            self.unsolved = True

    def _turned(self, edge: Edge) -> Edge:
        """Return an edge registered once more with its angle, or with that of its nodes."""
        expected = edge._replace(turn=self.place(edge.later).angle - self.place(edge.earlier).angle)
        found = self._register(expected)
        if found is not None and found.turn_sigma < UNKNOWN_TURN:
            limit_px = AGREEMENT_PX + abs(found.turn) * abs(edge.displacement)
            if abs(found.displacement - edge.displacement) < limit_px:
                return found
        return expected._replace(turn_sigma=_GUESSED_TURN_SIGMA)
