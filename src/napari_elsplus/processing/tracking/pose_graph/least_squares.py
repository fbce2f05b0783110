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

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy import sparse
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
    frames = _connected(edges, fixed)
    edges = [edge for edge in edges if edge.earlier in frames]
    number = {frame: k for k, frame in enumerate(sorted(frames))}
    if len(number) == 1:
        return {fixed: (0.0, 0.0)}
    from_, to = (
        np.array([number[frame] for frame in ends]) for ends in zip(*((e[0], e[1]) for e in edges), strict=True)
    )
    measured = np.array([edge.displacement for edge in edges])
    information = np.linalg.inv(np.stack([edge.covariance for edge in edges]))
    root = np.linalg.cholesky(information).transpose(0, 2, 1).astype(np.float64, copy=False)
    free = [k for k in range(2 * len(number)) if k // 2 != number[fixed]]
    closing = _closing(edges)
    weight = np.where(closing, _FIRST_WEIGHT, 1.0)
    places = np.zeros((len(number), 2))
    for _ in range(_ROUNDS):
        scaled = root * np.sqrt(weight)[:, None, None]
        design = _design(scaled, from_, to, len(number))[:, free]
        right = np.einsum("eij,ej->ei", scaled, measured).ravel()
        places.ravel()[free] = spsolve((design.T @ design).tocsc(), design.T @ right)
        miss = np.einsum("eij,ej->ei", root, places[to] - places[from_] - measured)
        tails = np.hypot(*miss.T) / _TAIL
        weight = np.where(closing, 1 / (1 + tails**2), 1 / np.maximum(tails, 1.0))
    return {frame: (float(places[k, 0]), float(places[k, 1])) for frame, k in number.items()}


def _closing(edges: Sequence[Edge]) -> list[bool]:
    """Return for each edge True if it closes a loop of edges before it."""
    root: dict[int, int] = {}

    def find(frame: int) -> int:
        while root.setdefault(frame, frame) != frame:
            frame = root[frame] = root[root[frame]]
        return frame

    closing = []
    for edge in edges:
        a, b = find(edge.earlier), find(edge.later)
        closing.append(a == b)
        root[b] = a
    return closing


def _connected(edges: Sequence[Edge], start: int) -> set[int]:
    neighbours: dict[int, list[int]] = {}
    for edge in edges:
        neighbours.setdefault(edge.earlier, []).append(edge.later)
        neighbours.setdefault(edge.later, []).append(edge.earlier)
    found, ahead = {start}, [start]
    while ahead:
        for frame in neighbours.get(ahead.pop(), ()):
            if frame not in found:
                found.add(frame)
                ahead.append(frame)
    return found


def _design(
    scaled: NDArray[np.float64], from_: NDArray[np.int_], to: NDArray[np.int_], frames: int
) -> sparse.csc_matrix:
    """Return the design matrix: rows 2 e and 2 e + 1 are edge e in units of its standard deviations."""
    links = len(scaled)
    rows = np.broadcast_to(np.arange(2 * links).reshape(links, 2, 1), scaled.shape)
    later = np.broadcast_to((2 * to[:, None] + np.arange(2))[:, None, :], scaled.shape)
    earlier = np.broadcast_to((2 * from_[:, None] + np.arange(2))[:, None, :], scaled.shape)
    values = np.concatenate([scaled.ravel(), -scaled.ravel()])
    places = (np.concatenate([rows.ravel(), rows.ravel()]), np.concatenate([later.ravel(), earlier.ravel()]))
    return sparse.csc_matrix((values, places), shape=(2 * links, 2 * frames))
