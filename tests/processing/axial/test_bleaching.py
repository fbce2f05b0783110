from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.axial.axial_notes import axial_notes
from napari_elsplus.processing.axial.axial_response import AxialResponse, axial_response
from napari_elsplus.processing.axial.bleaching import light_loss

ONE_WAY_UM = np.r_[np.arange(0, 60, 6.0), np.arange(60, 200, 20.0), np.arange(200, 700, 60.0)]
DEPTH_UM = np.r_[ONE_WAY_UM, ONE_WAY_UM[::-1]]
TRUTH = {"ls_3db": 60.0, "ls_10db": 540.0, "els_3db": 30.0, "els_10db": 90.0}


def scans(lost: float, backlash_um: float, drift_um: float) -> list[AxialResponse]:
    """Scans there and back of a plate that loses a share of its light, on a stage with backlash or drift."""
    time = np.linspace(0, 1, len(DEPTH_UM))
    true_um = np.maximum(DEPTH_UM + backlash_um * (time > 0.5) + drift_um * time, 0)
    found = []
    for seed in range(20):
        power = (1 - lost) ** time * np.random.default_rng(9500 + seed).normal(1, 0.003, len(time))
        ls, els = power / (1 + true_um / 60), 0.8 * power / (1 + np.square(true_um / 30))
        found.append(axial_response(DEPTH_UM, ls, ls - els))
    return found


@pytest.mark.parametrize("lost", [0.0, 0.15])
@pytest.mark.parametrize(("backlash_um", "drift_um"), [(2.0, 0.0), (5.0, 0.0), (-3.0, 0.0), (0.0, 8.0)])
def test_a_plate_that_is_displaced_is_not_taken_for_one_that_bleaches(
    lost: float, backlash_um: float, drift_um: float
) -> None:
    """Backlash was made up for as a loss of light, stated to 0.3 %: LS 10 dB off by 9 standard deviations."""
    found = scans(lost, backlash_um, drift_um)
    for name, truth in TRUTH.items():
        pulls = [(getattr(each, name).um - truth) / getattr(each, name).uncertainty_um for each in found]
        assert np.abs(pulls).max() < 3
    for each in found:
        assert each.loss is not None
        assert each.loss.significant == (lost > 0)
        assert any("approach each depth from the same side" in note for note in axial_notes(each))
    assert np.median([each.displaced_um for each in found]) == pytest.approx(abs(backlash_um + drift_um), rel=0.5)


@pytest.mark.parametrize("lost", [0.0, 0.15])
def test_a_plate_that_stays_is_not_noted_as_displaced(lost: float) -> None:
    for each in scans(lost, 0.0, 0.0):
        assert not any("moved" in note for note in axial_notes(each))
        assert each.ls_10db.uncertainty_um < 6


@pytest.mark.parametrize("law", ["even", "second order"])
def test_what_is_stated_contains_that_the_law_by_which_light_falls_is_unknown(law: str) -> None:
    time, lost, pulls = np.linspace(0, 1, len(DEPTH_UM)), 0.3, []
    light = 1 - lost * time if law == "even" else 1 / (1 + time * lost / (1 - lost))
    for seed in range(20):
        power = light * np.random.default_rng(9600 + seed).normal(1, 0.003, len(time))
        ls, els = power / (1 + DEPTH_UM / 60), 0.8 * power / (1 + np.square(DEPTH_UM / 30))
        found = axial_response(DEPTH_UM, ls, ls - els)
        assert found.loss is not None
        assert found.loss.share == pytest.approx(lost, abs=0.03)
        drops = {name: getattr(found, name) for name in TRUTH}
        pulls.append([(drops[name].um - truth) / drops[name].uncertainty_um for name, truth in TRUTH.items()])
    assert np.sqrt(np.square(pulls).mean()) < 1.4
    assert np.abs(pulls).max() < 4


def test_frames_too_dim_in_els_state_a_loss_by_ls_alone() -> None:
    ls = 0.99 ** np.arange(20) / (1 + np.r_[np.arange(10), np.arange(10)[::-1]] / 5)
    els = np.r_[1.0, np.zeros(19)]
    loss = light_loss(np.r_[np.arange(10), np.arange(10)[::-1]], ls, els)
    assert loss is not None
    assert loss.share == pytest.approx(0.174, abs=1e-3)
    assert loss.by_distance == 0
