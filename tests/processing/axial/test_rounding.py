"""What rounding to whole grey levels does to means, against cameras that round."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.axial.rounding import pixel_noise_dn, rounding_bias_dn


@pytest.mark.parametrize("noise_dn", [0.2, 0.3, 0.4])
def test_the_worst_level_is_shifted_by_as_much_as_is_stated(noise_dn: float) -> None:
    rng = np.random.default_rng(0)
    shifts = [np.round(level + rng.normal(0, noise_dn, 400_000)).mean() - level for level in 7 + np.arange(0, 1, 0.125)]
    assert np.abs(shifts).max() == pytest.approx(rounding_bias_dn(noise_dn, np.full((20, 20), 7.25)), rel=0.1)


def test_half_a_grey_level_of_noise_or_a_pattern_makes_it_harmless() -> None:
    assert rounding_bias_dn(0.6, np.full(100, 3.25)) < 0.001
    assert rounding_bias_dn(0.0, np.linspace(3, 6, 900)) < 0.001


def test_noise_is_told_apart_from_rounding() -> None:
    rng = np.random.default_rng(1)
    levels = np.linspace(20, 60, 200)[:, None]
    for noise_dn in (0.2, 0.5, 2.0):
        one, other = np.round(levels + rng.normal(0, noise_dn, (2, 200, 300))).astype(np.uint8)
        assert pixel_noise_dn(one, other) == pytest.approx(noise_dn, rel=0.15)
    assert pixel_noise_dn(one, one) == 0
