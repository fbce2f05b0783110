"""Angles of nodes from before the rotation was modelled: the probe turned evenly until then."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from napari_elsplus.processing.tracking.pose_graph.keyframes import Node
    from napari_elsplus.processing.tracking.pose_graph.least_squares import Edge

UNKNOWN_TURN: Final = 1.0
"""Standard deviation of an edge's angle from which it was not estimated, radians."""
_GUESSED_SIGMAS: Final = (1e-3, 0.5)
"""Limits of the standard deviation of an angle derived from the rate of rotation, radians: all of it at most."""


class TurnRates:
    """Mean rate of rotation of each segment up to its first node with an angle."""

    def __init__(self) -> None:
        self._begun: dict[int, int] = {}
        self._rate: dict[int, float] = {}

    def add(self, node: Node) -> None:
        """Add a node of the track."""
        segment = node.pose.segment
        begun = self._begun.setdefault(segment, node.frame)
        if node.pose.angle != 0 and segment not in self._rate and node.frame > begun:
            self._rate[segment] = node.pose.angle / (node.frame - begun)

    def with_turn(self, edge: Edge, nodes: Sequence[Node]) -> Edge:
        """Return an edge with the angle by the rate where none was estimated, and at most all of it as deviation.

        Parameters
        ----------
        edge : Edge
            Between two of the nodes.
        nodes : sequence of Node
            All nodes.
        """
        if edge.turn_sigma < UNKNOWN_TURN:
            return edge
        turn = self._angle(nodes[edge.later]) - self._angle(nodes[edge.earlier])
        return edge._replace(turn=turn, turn_sigma=float(np.clip(abs(turn), *_GUESSED_SIGMAS)))

    def _angle(self, node: Node) -> float:
        segment = node.pose.segment
        return node.pose.angle or self._rate.get(segment, 0.0) * (node.frame - self._begun[segment])
