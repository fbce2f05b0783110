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

from itertools import compress
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy import sparse
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse.linalg import spsolve

from napari_elsplus.processing.tracking.registration.motion_models import MotionModel, turned_by

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

_ROUNDS: Final = 8
"""Rounds of reweighting; chosen: weights change by less than 1 % after five."""
_MIN_TURN_SIGMA: Final = 1e-4
UNKNOWN_TURN: Final = 1.0
"""Limits of the standard deviation of an angle, radians; the last is that of an angle that was not estimated."""
_FIRST_WEIGHT: Final = 1e-6
"""First weight of edges that close loops: their residuals are those from the positions by all other edges."""
_TAIL: Final = 3.0
"""Residual at which an edge that closes a loop loses half of its weight, and beyond which others pull with the same
force, standard deviations; chosen, where Gaussian noise has 1 %."""


class Edge(NamedTuple):
    """Displacement between two nodes.

    Parameters
    ----------
    earlier, later : int
        The nodes.
    displacement : tuple of float
        (row, col) of the later node relative to the earlier one, in the later one's orientation, pixels.
    covariance : numpy.ndarray
        (2, 2), pixels squared.
    turn : float
        Angle of the later node less that of the earlier one, radians.
    turn_sigma : float
        One standard deviation of the angle.
    sure : bool
        True if this edge alone joins two segments.
    """

    earlier: int
    later: int
    displacement: tuple[float, float]
    covariance: NDArray[np.float64]
    turn: float = 0.0
    turn_sigma: float = 1.0
    sure: bool = False


class Place(NamedTuple):
    """Position of a node (pixels) and its angle (radians)."""

    row: float
    col: float
    angle: float = 0.0


def least_squares(edges: Sequence[Edge], fixed: int, model: MotionModel) -> dict[int, Place]:
    """Return places under a motion model: :func:`least_squares_positions`, or with angles."""
    if model is MotionModel.TRANSLATION:
        return {frame: Place(*where) for frame, where in least_squares_positions(edges, fixed).items()}
    return least_squares_places(edges, fixed)


def least_squares_places(edges: Sequence[Edge], fixed: int = 0) -> dict[int, Place]:
    """Return positions and angles of all nodes that edges connect to one.

    Angles are solved for first; displacements are then rotated into the orientation of the fixed node, and positions
    solved for.

    Parameters
    ----------
    edges : sequence of Edge
        As for :func:`least_squares_positions`.
    fixed : int
        Node at (0, 0), upright.

    Examples
    --------
    >>> edges = [Edge(0, 1, (0.0, 10.0), np.eye(2), turn=np.pi / 2, turn_sigma=1e-3)]
    >>> place = least_squares_places(edges)[1]
    >>> round(place.row, 6), round(abs(place.col), 6)
    (-10.0, 0.0)
    """
    sigmas = np.clip([edge.turn_sigma for edge in edges], _MIN_TURN_SIGMA, UNKNOWN_TURN)
    rotations = [
        edge._replace(displacement=(edge.turn, 0.0), covariance=sigma**2 * np.eye(2))
        for edge, sigma in zip(edges, sigmas, strict=True)
    ]
    angles = {node: angle for node, (angle, _) in least_squares_positions(rotations, fixed).items()}
    places = least_squares_positions(upright_edges(edges, angles), fixed)
    return {node: Place(*where, angles[node]) for node, where in places.items()}


def upright_edges(edges: Sequence[Edge], angles: Mapping[int, float]) -> list[Edge]:
    """Return edges with their displacements turned into the orientation of the fixed node.

    Parameters
    ----------
    edges : sequence of Edge
        Each in the orientation of its later node.
    angles : mapping of int to float
        Angle of each node, radians; 0 for those that are not in it.
    """
    upright = []
    for edge in edges:
        row, col = turned_by(angles.get(edge.later, 0.0)) @ edge.displacement
        upright.append(edge._replace(displacement=(float(row), float(col))))
    return upright


def least_squares_positions(edges: Sequence[Edge], fixed: int = 0) -> dict[int, tuple[float, float]]:
    """Return the positions of all nodes that edges connect to one.

    Parameters
    ----------
    edges : sequence of Edge
        The most reliable ones first: those that close a loop of edges before them start with a small weight. Nodes that
        no chain of edges connects to `fixed` are left out.
    fixed : int
        Node at (0, 0).

    Returns
    -------
    dict of int to tuple of float
        (row, col) of each node, pixels.

    Examples
    --------
    A loop that does not close by 0.3 px, of three edges with equal covariance:

    >>> sure = np.eye(2)
    >>> edges = [Edge(0, 1, (10.0, 0.0), sure), Edge(1, 2, (10.0, 0.0), sure), Edge(0, 2, (20.3, 0.0), sure)]
    >>> [round(row, 2) for row, col in least_squares_positions(edges).values()]
    [0.0, 10.1, 20.2]
    """
    joined = DisjointSet([fixed])
    closing = np.array([not _join(joined, edge) for edge in edges])
    connected = joined.subset(fixed)
    within = np.array([edge.earlier in connected for edge in edges], bool)
    if not within.any():
        return {fixed: (0.0, 0.0)}
    edges, closing = list(compress(edges, within)), closing[within]
    number = {node: k for k, node in enumerate(sorted(connected))}
    measured = np.array([edge.displacement for edge in edges])
    information = np.linalg.inv(np.stack([edge.covariance for edge in edges]))
    root = np.linalg.cholesky(information).transpose(0, 2, 1).astype(np.float64, copy=False)
    incidence = _incidence(edges, number)
    free = np.arange(2 * len(number)) // 2 != number[fixed]
    weight = np.where(closing, _FIRST_WEIGHT, 1.0)
    places = np.zeros((len(number), 2))
    for _ in range(_ROUNDS):
        scaled = root * np.sqrt(weight)[:, None, None]
        blocks = sparse.bsr_matrix((scaled, np.arange(len(edges)), np.arange(len(edges) + 1)))
        design = (blocks @ incidence).tocsc()[:, free]
        right = np.einsum("eij,ej->ei", scaled, measured).ravel()
        places.ravel()[free] = spsolve((design.T @ design).tocsc(), design.T @ right)
        miss = np.einsum("eij,ej->ei", root, (incidence @ places.ravel()).reshape(-1, 2) - measured)
        tails = np.hypot(*miss.T) / _TAIL
        weight = np.where(closing, 1 / (1 + tails**2), 1 / np.maximum(tails, 1.0))
    return {node: (float(places[k, 0]), float(places[k, 1])) for node, k in number.items()}


def _join(joined: DisjointSet, edge: Edge) -> bool:
    """Join the nodes of an edge; return False if edges before it have, so that it closes a loop."""
    joined.add(edge.earlier)
    joined.add(edge.later)
    return bool(joined.merge(edge.earlier, edge.later))


def _incidence(edges: Sequence[Edge], number: Mapping[int, int]) -> sparse.csr_matrix:
    """Return the matrix that makes displacements of edges, (row, col) of each, of the coordinates of numbered nodes."""
    ends = np.array([(number[edge.later], number[edge.earlier]) for edge in edges])
    signs = np.tile((1.0, -1.0), len(edges))
    of_nodes = sparse.csr_matrix((signs, (np.arange(len(edges)).repeat(2), ends.ravel())), (len(edges), len(number)))
    return sparse.kron(of_nodes, np.eye(2), "csr")
