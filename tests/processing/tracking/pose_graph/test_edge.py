"""What a graph says of the nodes that stay does not change when others are let go."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.tracking.pose_graph.edge import Edge, marginalised_edges, retained_nodes
from napari_elsplus.processing.tracking.pose_graph.least_squares import least_squares
from napari_elsplus.processing.tracking.registration.motion_models import turned_by

NODES = 60
ROUND = 20
TURN = 0.04


def link(earlier: int, later: int, noise: np.ndarray, sigma: float) -> Edge:
    """Rounds of a probe that turns, seen with an error."""
    (row, col), turn = true_place(later) - true_place(earlier), TURN * (later - earlier)
    seen = turned_by(-TURN * later) @ (row, col) + sigma * noise
    return Edge(earlier, later, complex(*seen), sigma**2 * np.eye(2), turn, 1e-3)


def true_place(node: int) -> np.ndarray:
    angle = 2 * np.pi * node / ROUND
    return np.array([200 * np.sin(angle), 200 * (1 - np.cos(angle)) + node])


@pytest.mark.parametrize("sigma", [1e-6, 0.1])
def test_the_nodes_that_stay_lie_where_they_lay(sigma: float) -> None:
    noise = np.random.default_rng(0).normal(size=(2, NODES, 2))
    chain = [link(k, k + 1, noise[0, k], sigma) for k in range(NODES - 1)]
    loops = [link(k, k + ROUND, noise[1, k], sigma) for k in range(NODES - ROUND)]
    path = np.arange(NODES, dtype=float)
    stays = retained_nodes(path, np.zeros(NODES, np.int64), path % 7 > 0, 20)
    assert stays.sum() == 20
    assert stays[::7].all()
    assert stays[[0, -1]].all()
    few_chain, few_loops = marginalised_edges(chain, loops, stays)
    assert len(few_chain) == 19
    assert 0 < len(few_loops) <= len(loops)
    start = np.zeros(NODES, complex), np.zeros(NODES)
    whole, few = least_squares([*chain, *loops], *start), least_squares([*few_chain, *few_loops], *start)
    for values in zip(whole, few, strict=True):
        np.testing.assert_allclose(
            *(one[stays] for one in values), atol=4 * sigma + 1e-3 * (sigma > 1e-3) + 1e-6, rtol=0
        )
    for node in np.flatnonzero(stays):
        assert abs(few[0][node] - complex(*true_place(node))) < 5 * sigma + 1e-3


def test_ends_of_segments_stay_and_what_lies_far_apart_goes_last() -> None:
    segment = np.repeat([0, 3], 10)
    path = np.concatenate([np.arange(10.0), 10 + 5 * np.arange(10.0)])
    stays = retained_nodes(path, segment, np.ones(20, bool), 12)
    assert stays[[0, 9, 10, 19]].all()
    assert stays[10:].all()
    assert not retained_nodes(path, segment, np.ones(20, bool), 2)[[1, 8, 11, 18]].any()
