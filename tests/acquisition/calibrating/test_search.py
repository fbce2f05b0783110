"""The search for the bundle by the line, from the heights of the brightest rows alone."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.acquisition.calibrating.capture import SEARCH_VOLTAGES, lit_voltages

NOISE_OF_ROWS = [
    5.4, 5.8, 5.9, 5.4, 5.3, 4.7, 5.2, 6.3, 5.7, 6.3, 4.3, 6.0, 6.2, 6.0, 4.5, 6.8, 5.1, 5.1, 5.2, 5.9, 5.0, 4.8, 4.9,
    4.9, 6.4, 5.5, 5.8, 5.4, 11.8, 14.9, 17.2, 21.3, 21.7, 20.6, 20.2, 20.4, 17.3, 17.2, 14.5, 10.5, 5.2, 5.3, 6.7, 5.1,
    5.9, 6.7, 6.1, 5.9, 4.9, 5.4, 4.8, 7.3, 5.2, 5.4, 6.8, 5.5, 5.1, 5.6, 6.0, 6.0, 6.3,
]  # fmt: skip
"""Measured on a simulated rig with noise of the rows and a dim line."""


def test_a_dim_line_is_found_above_the_noise_of_the_rows() -> None:
    """Before: the noise counted as a line here and there, and the whole range as that of the bundle, or as none."""
    assert lit_voltages(np.array(NOISE_OF_ROWS)).tolist() == list(range(28, 40))


@pytest.mark.parametrize("lit", [2, 10, 30, 40])
@pytest.mark.parametrize("floor", [0.0, 1.5, 6.0])
@pytest.mark.parametrize("height", [12.0, 100.0])
def test_bundles_of_any_share_of_the_range_are_found(lit: int, floor: float, height: float) -> None:
    rng = np.random.default_rng(lit)
    for _ in range(20):
        heights = floor + 0.1 * floor * rng.standard_normal(SEARCH_VOLTAGES)
        first = int(rng.integers(0, SEARCH_VOLTAGES - lit))
        heights[first : first + lit] += height * rng.uniform(0.7, 1.0, lit)
        assert lit_voltages(heights).tolist() == list(range(first, first + lit))


@pytest.mark.parametrize("sigma", [0.0, 0.3, 3.0])
def test_noise_alone_is_no_bundle(sigma: float) -> None:
    rng = np.random.default_rng(3)
    for _ in range(300):
        noise = rng.gumbel(5.0, sigma, SEARCH_VOLTAGES) if sigma else np.full(SEARCH_VOLTAGES, 5.0)
        assert not len(lit_voltages(noise))


def test_a_range_that_is_lit_nearly_everywhere_is_none() -> None:
    heights = np.full(SEARCH_VOLTAGES, 50.0)
    heights[:9] = 1.0
    assert not len(lit_voltages(heights))
