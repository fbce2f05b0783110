"""Loops closed while the probe moves: where frames belong by all links so far, and what that does to the newest.

The tracker goes on from frame to frame as if it were alone. Nodes are taken from it
(``pose_graph.keyframes``) and compared with earlier ones that show the same place; what all
links say together moves the nodes, and the correction of the newest is that of the frames to come.
"""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.tracking.pose_graph.correction import Correction, Corrections
from napari_elsplus.processing.tracking.pose_graph.least_squares import Edge, least_squares
from napari_elsplus.processing.tracking.pose_graph.loop_closure import AWAY, LINKS_PER_KEY, REACH, Bridge, LoopCloser
from napari_elsplus.processing.tracking.pose_graph.marginalisation import linked_anew, retained_nodes
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel, turned_by

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.pose_graph.keyframes import Node
    from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame, Registrar

RECALLED: Final = 6
"""Nodes of other segments with which a node is compared: the newest of them, and as many others in turn."""
MOST_NODES: Final = 1500
"""Nodes from which on some are let go, so that solving takes no longer the longer the path is: down to two thirds."""
_RENEWED: Final = 1.25
_UNTOLD: Final = 1.0
"""Uncertainty of a link's angle, in radians, where no rotation was asked for."""
_GUESSED_SIGMAS: Final = (1e-3, 0.5)
"""Limits of what an angle is trusted to that is guessed from how fast the probe turned: it may be off by all of it."""
ASKED_WITH_EACH: Final = 2
"""Links from before a turn was noticed that are asked again with each node."""
_NOWHERE: Final = -1


class LiveGraph:
    """All nodes, the links between them, and where they belong; used by one thread.

    Parameters
    ----------
    registrar : Registrar
        Of the tracking grid; of this thread's own.
    view : callable
        Returns the prepared view of a node by its number, or None if it is kept no more.

    Attributes
    ----------
    nodes : list of Node
        In the order in which they were added.
    places : list of Pose
        Where each belongs, by all links so far.
    closed : int
        Links that closed a loop, or joined segments, so far.
    """

    def __init__(self, registrar: Registrar, view: Callable[[int], PreparedFrame | None]) -> None:
        self._registrar, self._view = registrar, view
        self._diameter = registrar.grid.diameter
        self.nodes: list[Node] = []
        self.places: list[Pose] = []
        self._rung = MotionModel.TRANSLATION
        self._closer: LoopCloser | None = None
        self._closer_knows = 0
        self._where = np.zeros((256, 3))
        self._group = np.zeros(256, np.int64)
        self._chain: list[Edge] = []
        self._loops: list[Edge] = []
        self._newest: dict[int, int] = {}
        self._begun: dict[int, int] = {}
        self._turn_rate: dict[int, float] = {}
        self._untold = False
        self._bridges: dict[tuple[int, int], Bridge] = {}
        self._recalled = 0
        self._unsolved: set[int] = set()
        self._many = MOST_NODES
        self.closed = 0

    def add(self, node: Node, rung: MotionModel = MotionModel.TRANSLATION, *, everywhere: bool = True) -> bool:
        """Take in a node; whether it showed a place again, so that :meth:`solve` has something to say.

        Parameters
        ----------
        node : Node
            Compared with others if its view is at hand.
        rung : MotionModel
            What is modelled beside translations.
        everywhere : bool
            Whether it is also looked for in other segments, which takes the longest.
        """
        number, segment = len(self.nodes), node.pose.segment
        before = self._newest.get(segment)
        place = self.correction(segment).of(node.pose)
        self._rung = rung
        self.nodes.append(node)
        self.places.append(place)
        self._newest[segment] = number
        begun = self._begun.setdefault(segment, node.frame)
        if node.pose.angle != 0 and segment not in self._turn_rate and node.frame > begun:
            self._turn_rate[segment] = node.pose.angle / (node.frame - begun)
        if number == len(self._where):
            self._where = np.concatenate([self._where, np.zeros_like(self._where)])
            self._group = np.concatenate([self._group, np.zeros_like(self._group)])
        gone = AWAY * self._diameter if before is None else node.gone_px
        path = gone + (self._where[number - 1, 2] if number else 0.0)
        self._where[number], self._group[number] = (place.row, place.col, path), place.segment
        if before is not None:
            self._chain.append(self._along(before, number))
        seen = self._view(number) is not None
        found = self._revisits(number) if seen else []
        if seen and everywhere and not found:
            found = self._recognised(number)
        self._loops += found
        self._untold |= any(edge.turn_sigma >= _UNTOLD for edge in (*self._chain[-1:], *found))
        self.closed += len(found)
        self._unsolved |= {self.places[edge.earlier].segment for edge in found}
        if node.upright is not None:
            self._unsolved.add(self.places[number].segment)
        return self.ask_again(ASKED_WITH_EACH) or bool(found) or node.upright is not None

    def ask_again(self, most: int | None = None) -> bool:
        """Once the probe is known to turn: ask links from before how far they are turned; whether there were any.

        Parameters
        ----------
        most : int, optional
            How many, the newest first; all by default.
        """
        if self._rung is MotionModel.TRANSLATION or not self._untold:
            return False
        asked = 0
        for edges in (self._chain, self._loops):
            for k in reversed(range(len(edges))):
                if asked == most:
                    return True
                if edges[k].turn_sigma >= _UNTOLD:
                    edges[k] = self._asked_again(edges[k])
                    self._unsolved.add(self.places[edges[k].earlier].segment)
                    asked += 1
        self._untold = False
        return asked > 0

    def solve(self) -> bool:
        """Find where nodes belong, after something was recognised; whether there was anything to solve for."""
        groups, self._unsolved = self._unsolved, set()
        for group in groups:
            members = np.flatnonzero(self._group[: len(self.nodes)] == group)
            edges = [self._told(e) for e in (*self._chain, *self._loops) if self._group[e.earlier] == group]
            if not edges or not len(members):
                continue
            first = self.places[int(members[0])]
            base = Correction(group, first.row, first.col, first.angle, first.scale)
            for number, place in least_squares(edges, int(members[0]), self._rung).items():
                self.places[number] = base.of(self.places[number]._replace(**place._asdict()))
            self._where[members, :2] = [(self.places[k].row, self.places[k].col) for k in members.tolist()]
        return bool(groups)

    def correction(self, segment: int) -> Correction:
        """Return what takes the newest frames of one of the tracker's segments to where they belong."""
        newest = self._newest.get(segment)
        if newest is None:
            return Correction(segment)
        return Correction.between(self.nodes[newest].pose, self.places[newest])

    @property
    def corrections(self) -> Corrections:
        """Those along the whole track."""
        known: dict[int, list[tuple[int, Correction]]] = {}
        for node, place in zip(self.nodes, self.places, strict=True):
            if place.segment == _NOWHERE:
                continue
            along = known.setdefault(node.pose.segment, [])
            here = Correction.between(node.pose, place)
            if node.upright is not None:
                frame, pose = node.upright
                along.append((frame, Correction.between(pose, here.of(pose)._replace(angle=place.angle))))
            along.append((node.frame, here))
        return Corrections(known)

    def forget(self, group: int) -> None:
        """Let go of all that lies in one segment.

        Parameters
        ----------
        group : int
            Segment, as the graph numbers them, whose nodes and edges are removed.
        """
        gone = self._group[: len(self.nodes)] == group
        self._group[: len(self.nodes)][gone] = _NOWHERE
        for number in np.flatnonzero(gone).tolist():
            self.places[number] = self.places[number]._replace(segment=_NOWHERE)
        self._chain = [edge for edge in self._chain if not gone[edge.earlier]]
        self._loops = [edge for edge in self._loops if not gone[edge.earlier]]
        self._newest = {segment: number for segment, number in self._newest.items() if not gone[number]}
        self._unsolved.discard(group)

    def thin(self, kept: Callable[[Node], bool]) -> None:
        """Where there are many nodes, let go of some that can be linked to no more; the others get new numbers.

        Parameters
        ----------
        kept : callable
            Whether a node's frame is still at hand.
        """
        count = len(self.nodes)
        if count <= self._many:
            return
        there = self._group[:count] != _NOWHERE
        segment = np.array([node.pose.segment for node in self.nodes])
        free = np.array([not kept(node) and node.upright is None for node in self.nodes])
        stays = there.copy()
        stays[there] = retained_nodes(self._where[:count, 2][there], segment[there], free[there], 2 * MOST_NODES // 3)
        chain, loops = linked_anew(self._chain, self._loops, stays)
        number, left = (np.cumsum(stays) - 1).tolist(), np.flatnonzero(stays).tolist()
        self._chain, self._loops = (
            [edge._replace(earlier=number[edge.earlier], later=number[edge.later]) for edge in edges]
            for edges in (chain, loops)
        )
        self.nodes, self.places = [self.nodes[k] for k in left], [self.places[k] for k in left]
        self._where[: len(left)], self._group[: len(left)] = self._where[left], self._group[left]
        self._newest = {segment: number[k] for segment, k in self._newest.items()}
        self._bridges, self._closer, self._closer_knows = {}, None, 0
        self._many = max(MOST_NODES, int(_RENEWED * len(left)))

    # inside

    def _along(self, earlier: int, later: int) -> Edge:
        """Return what the tracker says of two successive nodes."""
        a, node = self.nodes[earlier].pose, self.nodes[later]
        b = node.pose
        row, col = b.row - a.row, b.col - a.col
        if b.angle != 0 or b.scale != 1:
            row, col = (turned_by(-b.angle, 1 / b.scale) @ (row, col)).tolist()
        return Edge(earlier, later, (row, col), node.covariance, b.angle - a.angle, b.scale / a.scale, node.turn_sigma)

    def _told(self, edge: Edge) -> Edge:
        """Return a link with what is thought of its angle, where it was not asked for."""
        if self._rung is MotionModel.TRANSLATION or edge.turn_sigma < _UNTOLD:
            return edge
        turn = self._turn_between(edge.earlier, edge.later)
        return edge._replace(turn=turn, turn_sigma=float(np.clip(abs(turn), *_GUESSED_SIGMAS)))

    def _asked_again(self, edge: Edge) -> Edge:
        known = self._told(edge)
        if self._view(edge.earlier) is None or self._view(edge.later) is None:
            return known
        found = self._closing().again(edge, known.turn)
        return known if found is None or found.turn_sigma >= _UNTOLD else found

    def _turn_between(self, earlier: int, later: int) -> float:
        """How far the probe has turned between two nodes: evenly, until it was noticed."""
        return self._angle_of(later) - self._angle_of(earlier)

    def _angle_of(self, number: int) -> float:
        node = self.nodes[number]
        segment = node.pose.segment
        return node.pose.angle or self._turn_rate.get(segment, 0.0) * (node.frame - self._begun[segment])

    def _revisits(self, number: int) -> list[Edge]:
        """Links with nodes of the same segment that lie beside this one but far back along the path."""
        row, col, path = self._where[number]
        where, group = self._where[:number], self._group[:number]
        distance = np.hypot(where[:, 0] - row, where[:, 1] - col)
        near = (group == self._group[number]) & (path - where[:, 2] > AWAY * self._diameter)
        near &= distance <= REACH * self._diameter
        edges: list[Edge] = []
        nearest = np.flatnonzero(near)[np.argsort(distance[near])]
        for earlier in islice(self._seen(nearest.tolist()), 2 * LINKS_PER_KEY):
            edge = self._closing().revisit(earlier, number, float(path - where[earlier, 2]))
            edges += [] if edge is None else [edge]
            if len(edges) == LINKS_PER_KEY:
                break
        return edges

    def _recognised(self, number: int) -> list[Edge]:
        """Links with other segments, once two pairs of nodes agree on how this one lies in one of them."""
        groups, group = self._group[:number], int(self._group[number])
        others = np.flatnonzero((groups != group) & (groups != _NOWHERE))
        if not len(others):
            return []
        own = np.flatnonzero(groups == group)
        first = int(own[0]) if len(own) else number
        rest = others[:-RECALLED]
        turn = np.roll(rest, -self._recalled)[:RECALLED]
        self._recalled = (self._recalled + RECALLED) % max(len(rest), 1)
        for earlier in self._seen([*others[: -RECALLED - 1 : -1].tolist(), *turn.tolist()]):
            edge = self._closing().recognise(earlier, number, int(others[-1]), first)
            if edge is None:
                continue
            there = int(groups[earlier])
            agreed = self._bridges.setdefault((there, group), Bridge()).add(self._closing().offset(edge), edge)
            if agreed:
                self._join(*sorted((there, group)))
                return agreed
        return []

    def _join(self, into: int, group: int) -> None:
        members = np.flatnonzero(self._group[: len(self.nodes)] == group)
        self._group[members] = into
        for number in members.tolist():
            self.places[number] = self.places[number]._replace(segment=into)
        if group in self._unsolved:
            self._unsolved = (self._unsolved - {group}) | {into}

    def _seen(self, numbers: Iterable[int]) -> Iterable[int]:
        """Those of the nodes whose views are still kept."""
        return (number for number in numbers if self._view(number) is not None)

    def _closing(self) -> LoopCloser:
        """Return what links nodes; it learns now and then how well frames agree here."""
        closer = self._closer
        if closer is None or closer.rung is not self._rung or len(self.places) > _RENEWED * self._closer_knows:
            self._closer_knows = len(self.places)
            self._closer = closer = LoopCloser(self._registrar, self._prepared, self.places, self._rung)
        return closer

    def _prepared(self, number: int) -> PreparedFrame:
        view = self._view(number)
        assert view is not None, f"node {number} is not kept any more"
        return view
