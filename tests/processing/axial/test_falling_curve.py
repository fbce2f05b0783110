"""Distances of falling curves against known ones: bias by the spacing of the depths; scatter against what is stated."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.axial.curve_noise import means_at_depths
from napari_elsplus.processing.axial.falling_curve import DropOff, FallingCurve

DEPTH_UM = np.r_[0.0, 8, np.arange(16.0, 64, 4), np.arange(68.0, 184, 8), np.arange(220.0, 720, 40)]


def share(depth_um: np.ndarray, half_um: float = 30.0) -> np.ndarray:
    """Share with 3 and 10 dB distances of 30 and 90 um, or of others in that proportion."""
    return np.asarray(1 / (1 + (depth_um / half_um) ** 2))


def drops(depths_um: np.ndarray, signal: np.ndarray) -> list[DropOff]:
    points = means_at_depths(depths_um, signal, np.ones(len(signal)))
    curve = FallingCurve(points, 0.0, np.zeros(len(points.depth)))
    return [curve.drop(level) for level in (0.5, 0.1)]


def test_a_curve_that_bends_between_its_depths_is_not_cut_short_or_long() -> None:
    """Straight lines between depths 12 um apart put the 10 dB distance 0.6 um too far."""
    depths = np.arange(0.0, 400, 12)
    assert drops(depths, share(depths))[1].um == pytest.approx(90, abs=0.05)


def test_neighbouring_depths_are_averaged_and_scatter_as_is_stated() -> None:
    depths, random = np.r_[DEPTH_UM, DEPTH_UM, np.zeros(6)], np.random.default_rng(7401)
    found = [drops(depths, 100 * share(depths, 35.0) * random.normal(1, 0.02, len(depths))) for _ in range(200)]
    for at, each in enumerate(zip(*found, strict=True)):
        off = np.array([drop.um for drop in each]) - (35, 105)[at]
        stated = np.array([drop.uncertainty_um for drop in each])
        assert off.std() < (0.44, 0.66)[at]  # 0.49 and 0.73 by the two depths about the distance
        assert 0.6 < np.mean(np.abs(off) < stated) < 0.85
        assert np.mean(np.abs(off) < 3 * stated) >= 0.98


def test_noise_that_repeated_frames_have_in_common_is_stated() -> None:
    """A ripple with one phase at each depth in all scans: their scatter alone stated a tenth of the error."""
    depths, random = np.tile(DEPTH_UM, 8), np.random.default_rng(7402)
    pulls = []
    for _ in range(100):
        common = np.tile(random.normal(1, 0.02, len(DEPTH_UM)), 8)
        drop = drops(depths, 100 * share(depths) * common * random.normal(1, 0.002, len(depths)))[1]
        pulls.append((drop.um - 90) / drop.uncertainty_um)
    assert np.median(np.abs(pulls)) < 2
