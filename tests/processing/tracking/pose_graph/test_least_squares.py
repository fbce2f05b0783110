from __future__ import annotations

import numpy as np

from napari_elsplus.processing.tracking.pose_graph.edge import Edge
from napari_elsplus.processing.tracking.pose_graph.least_squares import least_squares, least_squares_positions


def solved(edges: list[Edge], nodes: int) -> np.ndarray:
    """Return positions (nodes, 2) of nodes, the first of which is at (0, 0)."""
    at = least_squares_positions(edges, np.zeros(nodes, complex), np.zeros(nodes))
    return np.stack([at.real, at.imag], 1)


def walk(seed: int, frames: int = 40, sigma: float = 0.1) -> tuple[np.ndarray, list[Edge]]:
    rng = np.random.default_rng(seed)
    truth = np.cumsum(rng.normal(0, 5, (frames, 2)), axis=0)
    covariance = sigma**2 * np.eye(2)
    edges = []
    for k in range(frames - 1):
        step = truth[k + 1] - truth[k] + rng.normal(0, sigma, 2)
        edges.append(Edge(k, k + 1, complex(*step), covariance))
    return truth - truth[0], edges


def closing(truth: np.ndarray, a: int, b: int, error: float = 0.0) -> Edge:
    step = truth[b] - truth[a] + error
    return Edge(a, b, complex(*step), 1e-4 * np.eye(2))


def test_a_closed_loop_shares_out_what_had_added_up() -> None:
    truth, edges = walk(1)
    open_end = solved(edges, 40)[39] - truth[39]
    closed = solved([*edges, closing(truth, 0, 39)], 40)
    assert np.hypot(*open_end) > 0.3
    assert np.hypot(*(closed[39] - truth[39])) < 0.03
    misses = closed - truth
    assert np.abs(misses).max() < 0.7


def test_one_wrong_link_among_right_ones_moves_nothing() -> None:
    truth, edges = walk(2)
    right = [closing(truth, 0, 30), closing(truth, 3, 35), closing(truth, 0, 39), closing(truth, 6, 33)]
    found = solved([*edges, *right, closing(truth, 2, 37, error=12.0)], 40)
    misses = found - truth
    assert np.hypot(*misses[39]) < 0.05
    assert np.abs(misses).max() < 0.5


def test_loops_of_deformed_tissue_stretch_the_track_and_do_not_tear_it() -> None:
    """Twenty loops are longer than the track by 1 px: its least accurate edge moves by its part of the variance."""
    edges = [Edge(k, k + 1, 10.0, (0.1 if k == 9 else 0.05) ** 2 * np.eye(2)) for k in range(20)]
    edges += [Edge(a, b, 10.0 * (b - a) + 1.0, 4e-4 * np.eye(2)) for a in range(4) for b in range(16, 21)]
    found = solved(edges, 21)
    assert np.abs(np.diff(found[:, 0]) - 10.0).max() < 0.3


def test_each_set_of_connected_nodes_is_solved_about_its_first_one() -> None:
    _, edges = walk(3)
    start = np.full(40, 5 + 7j)
    found = least_squares_positions([edge for edge in edges if edge.earlier != 20], start, np.zeros(40))
    whole = solved(edges, 40) @ (1, 1j)
    np.testing.assert_allclose(found[:21], whole[:21] + 5 + 7j)
    np.testing.assert_allclose(found[21:], whole[21:] - whole[21] + 5 + 7j)
    assert least_squares_positions([], start, np.zeros(40)) is start


def test_nodes_before_the_first_that_is_solved_for_stay_and_hold_the_others() -> None:
    truth, edges = walk(4)
    start, held = truth @ (1, 1j), 10 + 5j
    start[:25] += held
    right = [closing(truth, a, b) for a, b in ((0, 39), (3, 35), (1, 37))]
    later = [edge for edge in [*edges, *right, closing(truth, 2, 38, error=12.0)] if edge.later >= 25]
    found = least_squares_positions(later, start, np.zeros(40), 25)
    np.testing.assert_array_equal(found[:25], start[:25])
    misses = found[25:] - truth[25:] @ (1, 1j) - held
    assert abs(misses).max() < 0.5
    assert abs(misses[-1]) < 0.05, "a wrong edge to a node that stays is let go"


def test_turned_links_are_laid_in_one_orientation_and_a_loop_shares_out_the_angles() -> None:
    """Around a hexagon, 60 degrees a link, each measured 0.01 rad too large; a seventh link closes the loop."""
    side, error, turn = 10.0, 0.01, np.pi / 3
    edges = [Edge(k, k + 1, side * 1j, np.eye(2), turn + error, 0.01) for k in range(6)]
    edges.append(Edge(0, 6, 0.0, 0.01 * np.eye(2), 2 * np.pi, 0.001))
    at, angle = least_squares(edges, np.zeros(7, complex), np.zeros(7))
    assert abs(angle[6] - 2 * np.pi) < 0.002
    assert abs(angle[3] - np.pi) < 0.01
    corners = abs(np.diff(at))
    assert np.allclose(corners, side, atol=0.2)
    assert abs(abs(at[3] - at[0]) - 2 * side) < 0.3
