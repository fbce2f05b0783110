from __future__ import annotations

import numpy as np

from napari_elsplus.processing.tracking.pose_graph.least_squares import (
    Edge,
    least_squares_places,
    least_squares_positions,
)


def walk(seed: int, frames: int = 40, sigma: float = 0.1) -> tuple[np.ndarray, list[Edge]]:
    rng = np.random.default_rng(seed)
    truth = np.cumsum(rng.normal(0, 5, (frames, 2)), axis=0)
    covariance = sigma**2 * np.eye(2)
    edges = []
    for k in range(frames - 1):
        step = truth[k + 1] - truth[k] + rng.normal(0, sigma, 2)
        edges.append(Edge(k, k + 1, (step[0], step[1]), covariance))
    return truth - truth[0], edges


def closing(truth: np.ndarray, a: int, b: int, error: float = 0.0) -> Edge:
    step = truth[b] - truth[a] + error
    return Edge(a, b, (step[0], step[1]), 1e-4 * np.eye(2))


def test_a_closed_loop_shares_out_what_had_added_up() -> None:
    truth, edges = walk(1)
    open_end = np.array(least_squares_positions(edges)[39]) - truth[39]
    closed = least_squares_positions([*edges, closing(truth, 0, 39)])
    assert np.hypot(*open_end) > 0.3
    assert np.hypot(*(np.array(closed[39]) - truth[39])) < 0.03
    misses = np.array([closed[k] for k in range(40)]) - truth
    assert np.abs(misses).max() < 0.7


def test_one_wrong_link_among_right_ones_moves_nothing() -> None:
    truth, edges = walk(2)
    right = [closing(truth, 0, 30), closing(truth, 3, 35), closing(truth, 0, 39), closing(truth, 6, 33)]
    found = least_squares_positions([*edges, *right, closing(truth, 2, 37, error=12.0)])
    misses = np.array([found[k] for k in range(40)]) - truth
    assert np.hypot(*misses[39]) < 0.05
    assert np.abs(misses).max() < 0.5


def test_loops_of_deformed_tissue_stretch_the_track_and_do_not_tear_it() -> None:
    """Twenty loops are longer than the track by 1 px: its least accurate edge moves by its part of the variance."""
    edges = [Edge(k, k + 1, (10.0, 0.0), (0.1 if k == 9 else 0.05) ** 2 * np.eye(2)) for k in range(20)]
    edges += [Edge(a, b, (10.0 * (b - a) + 1.0, 0.0), 4e-4 * np.eye(2)) for a in range(4) for b in range(16, 21)]
    found = np.array(list(least_squares_positions(edges).values()))
    assert np.abs(np.diff(found[:, 0]) - 10.0).max() < 0.3


def test_frames_that_nothing_connects_are_left_out() -> None:
    _, edges = walk(3)
    found = least_squares_positions([edge for edge in edges if edge.earlier != 20])
    assert set(found) == set(range(21))
    assert least_squares_positions([], fixed=7) == {7: (0.0, 0.0)}


def test_turned_links_are_laid_in_one_orientation_and_a_loop_shares_out_the_angles() -> None:
    """Around a hexagon, 60 degrees a link, each measured 0.01 rad too large; a seventh link closes the loop."""
    side, error, turn = 10.0, 0.01, np.pi / 3
    edges = [Edge(k, k + 1, (0.0, side), np.eye(2), turn + error, 0.01) for k in range(6)]
    edges.append(Edge(0, 6, (0.0, 0.0), 0.01 * np.eye(2), 2 * np.pi, 0.001))
    places = least_squares_places(edges)
    assert abs(places[6].angle - 2 * np.pi) < 0.002
    assert abs(places[3].angle - np.pi) < 0.01
    corners = [np.hypot(places[k + 1].row - places[k].row, places[k + 1].col - places[k].col) for k in range(6)]
    assert np.allclose(corners, side, atol=0.2)
    across = np.hypot(places[3].row - places[0].row, places[3].col - places[0].col)
    assert abs(across - 2 * side) < 0.3
