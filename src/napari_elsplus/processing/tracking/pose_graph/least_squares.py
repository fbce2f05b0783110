"""Positions and angles of nodes by robust least squares over all edges of a pose graph.

Each edge is the displacement of one node from another with its covariance. Edges that close a loop distribute the error
that has added up along the path. Wrong ones are weighted down by their residuals with Cauchy's weights, which give them
up; edges along the track with Huber's, whose loss is convex: where tissue deforms no loop closes, and a loss that
gives edges up would break the track at its least accurate edge.

References
----------
Grisetti et al., IEEE Intell. Transp. Syst. Mag. 2(4), 31 (2010), doi:10.1109/MITS.2010.939925; weights of Cauchy's
and Huber's M-estimators after Zhang, Image Vis. Comput. 15, 59 (1997), doi:10.1016/S0262-8856(96)01112-2.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy import sparse
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse.linalg import spsolve

from napari_elsplus.processing.tracking.pose_graph.edge import UNKNOWN_TURN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.pose_graph.edge import Edge

    Real = NDArray[np.float64]
    Complex = NDArray[np.complex128]

_ROUNDS: Final = 8
"""Rounds of reweighting; chosen: weights change by less than 1 % after five."""
_MIN_TURN_SIGMA: Final = 1e-4
"""Smallest standard deviation of an angle, radians; chosen, far below that of any registration."""
_FIRST_WEIGHT: Final = 1e-6
"""First weight of edges that close loops: their residuals are those from the positions by all other edges."""
_TAIL: Final = 3.0
"""Residual at which an edge that closes a loop loses half of its weight, and beyond which others pull with the same
force, standard deviations; chosen, where Gaussian noise has 1 %."""


def least_squares(edges: Sequence[Edge], at: Complex, angle: Real, first: int = 0) -> tuple[Complex, Real]:
    """Return positions and angles of all nodes: angles are solved for first, then positions.

    Parameters
    ----------
    edges, at, angle, first
        As for :func:`least_squares_positions`. The angle of the first node of each connected set stays as it is;
        all do where no edge has a turn.

    Examples
    --------
    >>> from napari_elsplus.processing.tracking.pose_graph.edge import Edge
    >>> edges = [Edge(0, 1, 10j, np.eye(2), turn=np.pi / 2, turn_sigma=1e-3)]
    >>> np.round(least_squares(edges, np.zeros(2, complex), np.zeros(2))[0], 6).tolist()
    [0j, (-10+0j)]
    """
    if any(edge.turn for edge in edges):
        turns = np.array([[edge.turn] for edge in edges])
        sigmas = np.clip([edge.turn_sigma for edge in edges], _MIN_TURN_SIGMA, UNKNOWN_TURN)
        angle = _solved(edges, turns, sigmas[:, None, None] ** 2, angle[:, None], first)[:, 0]
    return least_squares_positions(edges, at, angle, first), angle


def least_squares_positions(edges: Sequence[Edge], at: Complex, angle: Real, first: int = 0) -> Complex:
    """Return the positions of all nodes, of which the first of each connected set stays where it is.

    Parameters
    ----------
    edges : sequence of Edge
        Between nodes by their indices; the most reliable ones first: those that close a loop of edges before them start
        with a small weight.
    at : numpy.ndarray
        (n,) complex positions, row + i col, pixels; those of nodes that begin no connected set do not matter.
    angle : numpy.ndarray
        (n,) angles, radians.
    first : int
        First node that is solved for; those before it stay where they are.

    Examples
    --------
    A loop that does not close by 0.3 px, of three edges with equal covariance:

    >>> from napari_elsplus.processing.tracking.pose_graph.edge import Edge
    >>> sure = np.eye(2)
    >>> edges = [Edge(0, 1, 10, sure), Edge(1, 2, 10, sure), Edge(0, 2, 20.3, sure)]
    >>> np.round(least_squares_positions(edges, np.zeros(3, complex), np.zeros(3)).real, 2).tolist()
    [0.0, 10.1, 20.2]
    """
    if not edges:
        return at
    upright = np.exp(1j * angle[[edge.later for edge in edges]]) * [edge.displacement for edge in edges]
    covariance = np.stack([edge.covariance for edge in edges])
    measured, start = (np.stack([values.real, values.imag], 1) for values in (upright, at))
    places = _solved(edges, measured, covariance, start, first)
    solved: Complex = places[:, 0] + 1j * places[:, 1]
    return solved


def _solved(edges: Sequence[Edge], measured: Real, covariance: Real, start: Real, first: int) -> Real:
    """Return the coordinates (n, m) of nodes from differences (e, m) with covariances (e, m, m), and first ones."""
    (count, axes), number, last_held = start.shape, np.arange(len(edges)), first - 1
    joined = DisjointSet(range(last_held, count))  # those that stay count as one node
    closing = np.array([not joined.merge(max(edge.earlier, last_held), max(edge.later, last_held)) for edge in edges])
    held = [*range(first), *(min(connected) for connected in joined.subsets())]
    free = ~np.isin(np.arange(count), held).repeat(axes)
    ends = np.array([(edge.later, edge.earlier) for edge in edges])
    signs = np.tile((1.0, -1.0), len(edges))
    of_nodes = sparse.csr_matrix((signs, (number.repeat(2), ends.ravel())), (len(edges), count))
    root = np.linalg.cholesky(np.linalg.inv(covariance)).transpose(0, 2, 1)
    whitening = sparse.bsr_matrix((root, number, np.arange(len(edges) + 1)))
    design = (whitening @ sparse.kron(of_nodes, np.eye(axes))).tocsc()[:, free]
    missed = whitening @ (measured - start[ends[:, 0]] + start[ends[:, 1]]).ravel()
    change, weight = np.zeros((count, axes)), np.where(closing, _FIRST_WEIGHT, 1.0)
    weighted = design.copy()
    for _ in range(_ROUNDS):
        weighted.data = design.data * weight.repeat(axes)[design.indices]
        solution = spsolve((weighted.T @ design).tocsc(), weighted.T @ missed)
        tails = np.linalg.norm((design @ solution - missed).reshape(-1, axes), axis=1) / _TAIL
        weight, before = np.where(closing, 1 / (1 + tails**2), 1 / np.maximum(tails, 1.0)), weight
        if np.array_equal(weight, before):  # as of a track without loops
            break
    change.ravel()[free] = solution
    return start + change
