"""Evidence for distortion from the shifts that an affine fit leaves over: found where it is, and not in noise."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.processing.calibration.bundle import view_alignment
from napari_elsplus.processing.calibration.bundle.distortion_evidence import TileShifts, distortion_evidence
from napari_elsplus.processing.calibration.bundle.location import locate_pair
from napari_elsplus.processing.calibration.bundle.view_maps import ViewModel

RADIUS_PX = 140.0


def shifts(seed: int, rim_px: float, centre: tuple[float, float] = (0.0, 0.0), noise_px: float = 0.02) -> TileShifts:
    """Shifts of 8 x 8 tiles by a radial distortion about a centre (share of the radius), with noise."""
    random = np.random.default_rng(seed)
    axis = (np.arange(8) - 3.5) / 4 * 0.9 * RADIUS_PX
    rows, cols = (grid.ravel() for grid in np.meshgrid(axis, axis, indexing="ij"))
    inside = np.hypot(rows, cols) < 0.9 * RADIUS_PX
    rows, cols = rows[inside], cols[inside]
    away = np.stack([rows / RADIUS_PX - centre[0], cols / RADIUS_PX - centre[1]], axis=1)
    shift = rim_px * away * np.square(away).sum(axis=1, keepdims=True)
    skewed = random.normal(size=(len(rows), 2, 2))
    curvature = (np.eye(2) + 0.1 * skewed @ np.swapaxes(skewed, 1, 2)) / noise_px**2
    noise = np.linalg.cholesky(curvature) @ random.normal(size=(len(rows), 2, 1))
    return TileShifts(rows, cols, (curvature @ shift[..., None] + noise)[..., 0], curvature)


def test_noise_is_not_taken_for_distortion() -> None:
    found = [distortion_evidence(shifts(seed, 0.0), RADIUS_PX) for seed in range(200)]
    assert sum(evidence.needs_distortion for evidence in found) <= 2
    assert np.median([evidence.left_over_px for evidence in found]) == 0


@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.8, -2.0)])
def test_radial_distortion_about_any_centre_is_found(centre: tuple[float, float]) -> None:
    for seed in range(20):
        evidence = distortion_evidence(shifts(seed, 0.4, centre), RADIUS_PX)
        assert evidence.needs_distortion
        assert min(evidence.criterion, key=lambda model: evidence.criterion[model]) is ViewModel.RADIAL


def test_little_distortion_is_not_modelled_but_left_over() -> None:
    evidence = distortion_evidence(shifts(1, 0.08, noise_px=0.002), RADIUS_PX)
    assert not evidence.needs_distortion
    assert 0 < evidence.left_over_px < 0.02


def test_too_few_tiles_give_no_evidence() -> None:
    few = shifts(0, 1.0)
    few = TileShifts(few.rows[:20], few.cols[:20], few.scores[:20], few.curvature[:20])
    assert not distortion_evidence(few, RADIUS_PX).needs_distortion


@pytest.mark.parametrize("seed", [3, 4])
def test_views_without_distortion_are_not_fitted_again(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    image = Rig.draw(seed).with_photons(600.0).bundle()[0]
    monkeypatch.setattr(view_alignment, "_distorted_alignment", None)
    assert view_alignment.align_views(image, *locate_pair(image)).distortion is None
