"""A plate that is tilted about the point of the bundle's rim that touches it, by sums over points of the square."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.axial.axial_notes import axial_notes
from napari_elsplus.processing.axial.axial_response import AxialResponse, axial_response
from napari_elsplus.processing.axial.tilt import SquareHalves

RADIUS_UM, SQUARE_UM = 310.0, 240.0
DEPTH_UM = np.r_[np.arange(0, 60, 3.0), np.arange(60, 200, 10.0), np.arange(200, 700, 30.0)]
TRUTH = {"ls_3db": 60.0, "ls_10db": 540.0, "els_3db": 30.0, "els_10db": 90.0}


def scan(degrees: float, towards_deg: float, seed: int, slant: float = 0.05) -> AxialResponse:
    """Scan with power noise, and light that is uneven over the square in the same way at all depths."""
    random = np.random.default_rng(seed)
    at = (np.arange(24) + 0.5) / 24 * SQUARE_UM - SQUARE_UM / 2
    rows, cols = np.meshgrid(at, at, indexing="ij")
    slope, towards = np.tan(np.deg2rad(degrees)), np.deg2rad(towards_deg)
    height = slope * (RADIUS_UM + rows * np.sin(towards) + cols * np.cos(towards))
    light = 100 * (1 + slant * rows / SQUARE_UM)
    ls, residual, asymmetry = [], [], []
    for depth in DEPTH_UM:
        away = depth + height
        square = random.normal(1, 0.005) * (light / (1 + away / 60) + random.normal(0, 1, away.shape))
        ls.append(square.mean())
        residual.append(ls[-1] - (0.8 * light / (1 + np.square(away / 30))).mean())
        halves = (square[12:].sum() - square[:12].sum(), square[:, 12:].sum() - square[:, :12].sum())
        asymmetry.append(np.array(halves) / square.sum())
    return axial_response(DEPTH_UM, ls, residual, halves=SquareHalves(np.array(asymmetry), SQUARE_UM / 2, RADIUS_UM))


@pytest.mark.parametrize(("degrees", "towards_deg"), [(0.5, 20.0), (1.0, 200.0), (2.0, 90.0), (3.0, 300.0)])
def test_a_tilted_plate_is_noted_and_its_distances_are_uncertain(degrees: float, towards_deg: float) -> None:
    """LS 10 dB at 2 degrees was off by 17 standard deviations, and nothing was noted."""
    for seed in range(5):
        response = scan(degrees, towards_deg, seed)
        assert response.tilt is not None
        assert response.tilt.degrees == pytest.approx(degrees, abs=0.1 + 0.1 * degrees)
        assert any("tilted" in note and "level the plate" in note for note in axial_notes(response))
        for name, truth in TRUTH.items():
            drop = getattr(response, name)
            assert np.isnan(drop.um) or abs(drop.um - truth) < 3 * drop.uncertainty_um
        assert response.content()["tilt_deg"] == response.tilt.degrees


def test_a_level_plate_in_uneven_light_is_not_noted() -> None:
    for seed in range(10):
        response = scan(0.0, 0.0, seed)
        assert response.tilt is not None
        assert response.tilt.degrees < 4 * response.tilt.uncertainty_deg
        assert not any("tilted" in note for note in axial_notes(response))
        assert response.ls_3db.uncertainty_um < 2


def test_a_scan_of_few_depths_states_no_tilt() -> None:
    depth = np.array([0.0, 30, 60, 90])
    ls, els = 1 / (1 + depth / 60), 1 / (1 + np.square(depth / 30))
    halves = SquareHalves(np.zeros((4, 2)), SQUARE_UM / 2, RADIUS_UM)
    response = axial_response(depth, ls, ls - els, halves=halves)
    assert response.tilt is None
    assert response.content()["tilt_deg"] is None
