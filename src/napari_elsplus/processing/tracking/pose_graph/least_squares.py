"""All links of a track at once: positions by least squares, wrong links weighed down.

Every link says how far two frames lie apart, with its covariance. Links that close a loop say it of frames that many
others lie between; the positions that agree best with all of them share out what had added up.
"""

from __future__ import annotations

from math import exp, log
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from napari_elsplus.processing.tracking.registration.motion_models import MotionModel, turned_by

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_ROUNDS: Final = 8
_SIGMAS: Final = (1e-4, 1.0)
"""Limits of what an angle is trusted to; the last where it was not asked for."""
_UNPROVEN: Final = 1e-6
"""First weight of links that close loops: they are judged by where the others put the frames."""
_TAIL: Final = 3.0
"""Residual, in standard deviations, at which a link loses half of its weight."""


class Edge(NamedTuple):
    """Displacement between two frames.

    Parameters
    ----------
    earlier, later : int
        The frames.
    displacement : tuple of float
        (row, col) of the later frame relative to the earlier one, in the later one's orientation.
    covariance : numpy.ndarray
        (2, 2), pixels squared.
    turn : float
        Angle of the later frame less that of the earlier one, radians.
    zoom : float
        Scale of the later frame over that of the earlier one.
    turn_sigma : float
        One standard deviation of the angle, and of the scale.
    """

    earlier: int
    later: int
    displacement: tuple[float, float]
    covariance: NDArray[np.float64]
    turn: float = 0.0
    zoom: float = 1.0
    turn_sigma: float = 1.0


class Place(NamedTuple):
    """Where a frame lies: pixels, radians, and pixels of the fixed frame per pixel of this one."""

    row: float
    col: float
    angle: float = 0.0
    scale: float = 1.0


def least_squares(edges: Sequence[Edge], fixed: int, rung: MotionModel) -> dict[int, Place]:
    """Where frames lie by what is modelled: :func:`least_squares_positions`, or with angles and scales."""
    if rung is MotionModel.TRANSLATION:
        return {frame: Place(*where) for frame, where in least_squares_positions(edges, fixed).items()}
    return least_squares_places(edges, fixed)


def least_squares_places(edges: Sequence[Edge], fixed: int = 0) -> dict[int, Place]:
    """Positions, angles and scales of all frames that links connect to one.

    Angles and scales are solved for first, from what the links say of them; displacements are then laid into the
    orientation of the fixed frame, and positions solved for.

    Parameters
    ----------
    edges : sequence of Edge
        As for :func:`least_squares_positions`.
    fixed : int
        Frame at (0, 0), upright.

    Examples
    --------
    >>> edges = [Edge(0, 1, (0.0, 10.0), np.eye(2), turn=np.pi / 2, turn_sigma=1e-3)]
    >>> place = least_squares_places(edges)[1]
    >>> round(place.row, 6), round(abs(place.col), 6)
    (-10.0, 0.0)
    """
    rotations = [
        Edge(e.earlier, e.later, (e.turn, log(e.zoom)), float(np.clip(e.turn_sigma, *_SIGMAS)) ** 2 * np.eye(2))
        for e in edges
    ]
    forms = least_squares_positions(rotations, fixed)
    laid = []
    for edge in edges:
        angle, zoom = forms.get(edge.later, (0.0, 0.0))
        row, col = turned_by(angle, exp(zoom)) @ edge.displacement
        laid.append(edge._replace(displacement=(float(row), float(col))))
    places = least_squares_positions(laid, fixed)
    return {frame: Place(*where, forms[frame][0], exp(forms[frame][1])) for frame, where in places.items()}


def least_squares_positions(edges: Sequence[Edge], fixed: int = 0) -> dict[int, tuple[float, float]]:
    """Positions of all frames that links connect to one.

    Parameters
    ----------
    edges : sequence of Edge
        Links, those that are trusted most first: they judge those that close loops with them. Frames that no chain of
        them connects to `fixed` are left out.
    fixed : int
        Frame at (0, 0).

    Returns
    -------
    dict of int to tuple of float
        (row, col) of each frame.

    Examples
    --------
    A loop that does not close by 0.3 px, its three links equally sure:

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
    weight = np.where(_closing(edges), _UNPROVEN, 1.0)
    places = np.zeros((len(number), 2))
    for _ in range(_ROUNDS):
        scaled = root * np.sqrt(weight)[:, None, None]
        design = _design(scaled, from_, to, len(number))[:, free]
        right = np.einsum("eij,ej->ei", scaled, measured).ravel()
        places.ravel()[free] = spsolve((design.T @ design).tocsc(), design.T @ right)
        miss = np.einsum("eij,ej->ei", root, places[to] - places[from_] - measured)
        weight = 1 / (1 + (miss**2).sum(axis=1) / _TAIL**2)
    return {frame: (float(places[k, 0]), float(places[k, 1])) for frame, k in number.items()}


def _closing(edges: Sequence[Edge]) -> list[bool]:
    """Whether each link closes a loop of links before it."""
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
    """Rows 2 e and 2 e + 1 say what link e says of the positions, in units of its standard deviation."""
    links = len(scaled)
    rows = np.broadcast_to(np.arange(2 * links).reshape(links, 2, 1), scaled.shape)
    later = np.broadcast_to((2 * to[:, None] + np.arange(2))[:, None, :], scaled.shape)
    earlier = np.broadcast_to((2 * from_[:, None] + np.arange(2))[:, None, :], scaled.shape)
    values = np.concatenate([scaled.ravel(), -scaled.ravel()])
    places = (np.concatenate([rows.ravel(), rows.ravel()]), np.concatenate([later.ravel(), earlier.ravel()]))
    return sparse.csc_matrix((values, places), shape=(2 * links, 2 * frames))
