"""Edges of the pose graph: displacement and turn of one node relative to another, and marginalisation.

The edges of marginalised nodes are composed into edges between the retained ones.
"""

from __future__ import annotations

from cmath import rect
from math import hypot
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.tracking.registration.motion_models import turned_by

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.pose import Pose

UNKNOWN_TURN: Final = 1.0
"""Standard deviation of an angle that was not estimated, radians, and the largest that is distinguished."""


class Edge(NamedTuple):
    """Displacement and turn between two nodes.

    Parameters
    ----------
    earlier, later : int
        The nodes.
    displacement : complex
        Of the later node from the earlier one, row + i col, in the later one's orientation, pixels.
    covariance : numpy.ndarray
        (2, 2) of (row, col), pixels squared.
    turn : float
        Angle of the later node less that of the earlier one, radians.
    turn_sigma : float
        One standard deviation of the angle.
    sure : bool
        True if this edge alone joins two segments.

    Examples
    --------
    >>> quarter = Edge(0, 1, 10j, np.eye(2), turn=np.pi / 2, turn_sigma=0.3)
    >>> both = quarter.then(quarter._replace(earlier=1, later=2, turn_sigma=0.4))
    >>> complex(np.round(both.displacement, 6)), both.later, both.turn == np.pi, both.turn_sigma
    ((10+10j), 2, True, 0.5)
    """

    earlier: int
    later: int
    displacement: complex
    covariance: NDArray[np.float64]
    turn: float = 0.0
    turn_sigma: float = UNKNOWN_TURN
    sure: bool = False

    @classmethod
    def between(cls, earlier: int, later: int, a: Pose, b: Pose) -> Edge:
        """Return the edge, without uncertainty, that the poses of two nodes imply.

        Parameters
        ----------
        earlier, later : int
            The nodes.
        a, b : Pose
            Of the earlier and the later one.
        """
        return cls(earlier, later, rect(1, -b.angle) * (b.at - a.at), np.zeros((2, 2)), b.angle - a.angle)

    def from_pose(self, a: Pose, b: Pose) -> Pose:
        """Return the pose of the later node that follows from that of the earlier one, in its segment.

        Parameters
        ----------
        a, b : Pose
            Of the earlier and the later node.
        """
        angle = a.angle + self.turn
        return b.placed(a.at + rect(1, angle) * self.displacement, angle, a.segment)

    def then(self, following: Edge) -> Edge:
        """Return the composition of this edge and another.

        Parameters
        ----------
        following : Edge
            Begins at the node at which this one ends.
        """
        turned = turned_by(-following.turn)
        return self._replace(
            later=following.later,
            displacement=rect(1, -following.turn) * self.displacement + following.displacement,
            covariance=turned @ self.covariance @ turned.T + following.covariance,
            turn=self.turn + following.turn,
            turn_sigma=min(UNKNOWN_TURN, hypot(self.turn_sigma, following.turn_sigma)),
        )


def retained_nodes(
    path: NDArray[np.float64], segment: NDArray[np.int64], free: NDArray[np.bool_], count: int
) -> NDArray[np.bool_]:
    """Return the nodes to retain, so that they lie evenly along the path; ends of segments are retained.

    Parameters
    ----------
    path : numpy.ndarray
        (n,) path up to each node, in their order.
    segment : numpy.ndarray
        (n,) of the tracker.
    free : numpy.ndarray
        (n,) bool: True for nodes that may be marginalised.
    count : int
        Number of nodes to retain, if enough are free.

    Returns
    -------
    numpy.ndarray
        (n,) bool.

    Examples
    --------
    >>> path = np.array([0.0, 1, 2, 3, 4, 9, 14])
    >>> retained_nodes(path, np.zeros(7, np.int64), np.ones(7, bool), 4).tolist()
    [True, False, False, False, True, True, True]
    """
    stays = np.ones(len(path), bool)
    for _ in range(len(path) - count):
        left = np.flatnonzero(stays)
        before, here, after = left[:-2], left[1:-1], left[2:]
        within = (segment[before] == segment[after]) & free[here]
        if not within.any():
            break
        gaps = np.where(within, path[after] - path[before], np.inf)
        stays[here[np.argmin(gaps)]] = False
    return stays


def marginalised_edges(
    chain: Sequence[Edge], loops: Sequence[Edge], stays: NDArray[np.bool_]
) -> tuple[list[Edge], list[Edge]]:
    """Return the edges between retained nodes; of several between the same two the most accurate is kept.

    Parameters
    ----------
    chain : sequence of Edge
        From each node to the next of its segment, in their order.
    loops : sequence of Edge
        Others, from earlier to later nodes.
    stays : numpy.ndarray
        (n,) bool: True for retained nodes. The first and the last of each segment are.

    Returns
    -------
    chain, loops : list of Edge
        The nodes numbered as before.
    """
    up_to: dict[int, Edge] = {}  # for each node, the edge from the retained node before it
    onwards: dict[int, Edge] = {}  # and to the one after it
    for edge in chain:
        up_to[edge.later] = edge if stays[edge.earlier] else up_to[edge.earlier].then(edge)
    for edge in reversed(chain):
        onwards[edge.earlier] = edge if stays[edge.later] else edge.then(onwards[edge.later])
    best: dict[tuple[int, int], Edge] = {}
    for edge in loops:
        whole = edge if stays[edge.earlier] else up_to[edge.earlier].then(edge)
        whole = whole if stays[edge.later] else whole.then(onwards[edge.later])
        ends = whole.earlier, whole.later
        if ends not in best or np.trace(whole.covariance) < np.trace(best[ends].covariance):
            best[ends] = whole
    return [up_to[edge.later] for edge in chain if stays[edge.later]], list(best.values())
