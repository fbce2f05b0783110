"""Stated standard deviations are those of repeated measurements, when residuals come in lumps too."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.analysis.uncertainty import clustered_influence, newey_west_sigma, overlapping_influence


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


def wavy(random: np.random.Generator, share: float, samples: int = 400) -> np.ndarray:
    """Noise in which each run of ten gives a share to the next; a negative share takes it back there."""
    runs = random.normal(size=samples // 10 + 1)
    return np.repeat(runs[1:] + share * runs[:-1], 10)


@pytest.mark.parametrize("share", [-0.3, 0.0, 0.3])
def test_runs_that_give_to_their_neighbours_or_take_from_them_are_seen_through(share: float) -> None:
    random = np.random.default_rng(2)
    x = np.linspace(-1, 1, 400)
    jacobian = np.stack([np.ones_like(x), x], axis=1)
    runs = np.arange(400) // 10
    found, stated, plain, rows = [], [], [], []
    for _ in range(400):
        data = wavy(random, share)
        found.append(np.linalg.lstsq(jacobian, data, rcond=None)[0])
        left = data - jacobian @ found[-1]
        stated.append(np.linalg.norm(overlapping_influence(jacobian, left, runs, 40, 4), axis=0))
        influence = clustered_influence(jacobian, left, runs, 40)
        plain.append(np.linalg.norm(influence, axis=0))
        rows.append(newey_west_sigma(influence[:, 0], 4))
    scatter = np.std(found, axis=0)
    assert np.sqrt(np.mean(np.square(stated), axis=0)) / scatter == pytest.approx([1, 1], abs=0.2)
    assert np.sqrt(np.mean(np.square(rows))) / scatter[0] == pytest.approx(1, abs=0.2)
    if share:
        assert abs(np.log(np.mean(plain, axis=0) / scatter)).min() > 0.15
