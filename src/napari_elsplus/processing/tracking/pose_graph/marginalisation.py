"""Marginalisation of nodes: their edges are composed into edges between the retained nodes."""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.processing.tracking.registration.motion_models import turned_by

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.pose_graph.least_squares import Edge


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
    up_to: dict[int, Edge] = {}
    left = []
    for edge in chain:
        whole = edge if stays[edge.earlier] else joined(up_to[edge.earlier], edge)
        if stays[edge.later]:
            left.append(whole)
        else:
            up_to[edge.later] = whole
    onwards: dict[int, Edge] = {}
    for edge in reversed(chain):
        if not stays[edge.earlier]:
            onwards[edge.earlier] = edge if stays[edge.later] else joined(edge, onwards[edge.later])
    best: dict[tuple[int, int], Edge] = {}
    for edge in loops:
        whole = edge if stays[edge.earlier] else joined(up_to[edge.earlier], edge)
        whole = whole if stays[edge.later] else joined(whole, onwards[edge.later])
        ends = whole.earlier, whole.later
        if ends not in best or np.trace(whole.covariance) < np.trace(best[ends].covariance):
            best[ends] = whole
    return left, list(best.values())


def joined(first: Edge, second: Edge) -> Edge:
    """Return the composition of two edges, one after the other.

    Parameters
    ----------
    first, second : Edge
        Edges of which the first ends at the node at which the second begins.

    Examples
    --------
    >>> from napari_elsplus.processing.tracking.pose_graph.least_squares import Edge
    >>> quarter = Edge(0, 1, (0.0, 10.0), np.eye(2), turn=np.pi / 2, turn_sigma=0.3)
    >>> both = joined(quarter, quarter._replace(earlier=1, later=2, turn_sigma=0.4))
    >>> [round(value, 6) for value in both.displacement], both.later, both.turn == np.pi, both.turn_sigma
    ([10.0, 10.0], 2, True, 0.5)
    """
    turned = turned_by(-second.turn)
    row, col = (turned @ first.displacement + second.displacement).tolist()
    covariance = turned @ first.covariance @ turned.T + second.covariance
    return first._replace(
        later=second.later, displacement=(row, col), covariance=covariance, turn=first.turn + second.turn,
        turn_sigma=min(1.0, hypot(first.turn_sigma, second.turn_sigma)),
    )  # fmt: skip
