"""Stated standard deviations are those of repeated measurements, when residuals come in lumps too."""

from __future__ import annotations

import numpy as np

from napari_elsplus.processing.uncertainty import clustered_influence


def test_lumpy_residuals_are_not_taken_for_independent_ones() -> None:
    random = np.random.default_rng(0)
    x = np.linspace(-1, 1, 600)
    jacobian = np.stack([np.ones_like(x), x], axis=1)
    estimates, stated, naive = [], [], []
    for _ in range(300):
        lumps = np.repeat(random.normal(size=100), 6)
        found = np.linalg.lstsq(jacobian, lumps, rcond=None)[0]
        left = lumps - jacobian @ found
        influence = clustered_influence(jacobian, left, np.arange(600) // 15, 40)
        estimates.append(found[0])
        stated.append(np.linalg.norm(influence[:, 0]))
        naive.append(left.std() / np.sqrt(len(x)))
    scatter = np.std(estimates)
    assert abs(np.mean(stated) / scatter - 1) < 0.12
    assert np.mean(naive) < 0.5 * scatter


def test_what_two_fits_share_cancels_in_their_difference() -> None:
    random = np.random.default_rng(1)
    jacobian = np.ones((400, 1))
    clusters = np.arange(400) // 10
    shared = random.normal(size=400)
    one, two = (shared + 0.1 * random.normal(size=400) for _ in range(2))
    influences = [clustered_influence(jacobian, data - data.mean(), clusters, 40)[:, 0] for data in (one, two)]
    assert np.linalg.norm(influences[0] - influences[1]) < 0.3 * np.linalg.norm(influences[0])
