from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.axial.axial_notes import axial_notes
from napari_elsplus.processing.axial.axial_response import AxialResponse, axial_response
from napari_elsplus.processing.axial.light_beat import light_beat

ONE_WAY_UM = np.linspace(0.0, 700.0, 90)
SCANS_UM = {
    "one way": ONE_WAY_UM,
    "there and back": np.r_[ONE_WAY_UM, ONE_WAY_UM[::-1]],
    "twice": np.repeat(ONE_WAY_UM, 2),
    "finer near contact": np.geomspace(6.0, 706.0, 90) - 6.0,
    "pressed at first": ONE_WAY_UM - 60.0,
}
TRUTH = {"ls_3db": 60.0, "ls_10db": 540.0, "els_3db": 30.0, "els_10db": 90.0}


def scan(depths_um: np.ndarray, light: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depths, LS and residual of a plate in a light whose frames vary by 0.2 %, too."""
    random, beyond_um = np.random.default_rng(seed), np.maximum(depths_um, 0.0)
    power = light * random.normal(1, 0.002, len(depths_um))
    ls, els = 150 * power / (1 + beyond_um / 60), 120 * power / (1 + np.square(beyond_um / 30))
    return depths_um, *(each + random.normal(0, 0.02, len(depths_um)) for each in (ls, ls - els))


def beating(kind: str, seed: int) -> AxialResponse:
    depths_um, random = SCANS_UM[kind], np.random.default_rng(1000 + seed)
    turns = np.arange(len(depths_um)) / random.uniform(8, 25) + random.uniform()
    return axial_response(*scan(depths_um, 1 + random.uniform(0.01, 0.05) * np.sin(2 * np.pi * turns), seed))


@pytest.mark.parametrize("kind", ["one way", "there and back", "twice"])
def test_light_that_beats_with_the_frame_rate_is_told_from_the_response_and_corrected(kind: str) -> None:
    """Errors were 4 to 14 times what was stated."""
    found = [beating(kind, seed) for seed in range(12)]
    pulls = [
        (getattr(each, name).um - um) / getattr(each, name).uncertainty_um
        for each in found
        for name, um in TRUTH.items()
    ]
    assert np.sqrt(np.mean(np.square(pulls))) < 2
    for each in found:
        assert any("beats with the frame rate: corrected" in note for note in axial_notes(each))


@pytest.mark.parametrize("kind", SCANS_UM)
def test_light_that_is_steady_or_fades_does_not_beat(kind: str) -> None:
    depths_um = SCANS_UM[kind]
    for seed, lost in enumerate((0.0, 0.0, 0.1, 0.3)):
        fading = (1 - lost) ** np.linspace(0, 1, len(depths_um))
        assert light_beat(*scan(depths_um, fading, seed)[:2]) is None
    assert light_beat(depths_um, 150 / (1 + np.maximum(depths_um, 0.0) / 60)) is None


def test_light_that_varies_too_slowly_to_be_told_is_in_the_uncertainty_there_and_back() -> None:
    """What differs before and after the turn shows how much is alike; errors were 2.5 times what is stated."""
    depths_um, pulls = SCANS_UM["there and back"], []
    for seed in range(24):
        random = np.random.default_rng(2000 + seed)
        turns = random.uniform(1, 3) * np.linspace(0, 1, len(depths_um)) + random.uniform()
        found = axial_response(*scan(depths_um, 1 + random.uniform(0.01, 0.05) * np.sin(2 * np.pi * turns), seed))
        pulls += [(getattr(found, name).um - um) / getattr(found, name).uncertainty_um for name, um in TRUTH.items()]
    assert np.sqrt(np.mean(np.square(pulls))) < 2


def test_a_slow_beat_one_way_is_in_the_uncertainty_where_frames_show_one() -> None:
    """Errors were 4.4 times what was stated: a faster beat was taken for it."""
    pulls, quiet = [], 0
    for seed in range(40):
        random = np.random.default_rng(3000 + seed)
        turns = random.uniform(1.2, 3) * np.linspace(0, 1, len(ONE_WAY_UM)) + random.uniform()
        found = axial_response(*scan(ONE_WAY_UM, 1 + random.uniform(0.02, 0.05) * np.sin(2 * np.pi * turns), seed))
        quiet += found.beat is None
        if found.beat is not None:
            pulls += [
                (getattr(found, name).um - um) / getattr(found, name).uncertainty_um for name, um in TRUTH.items()
            ]
    assert quiet <= 20
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 1.4


def test_a_beat_that_a_slower_one_would_explain_as_well_is_said_to_be_uncertain() -> None:
    notes = []
    for phase in np.linspace(0, 1, 8, endpoint=False):
        light = 1 + 0.045 * np.sin(2 * np.pi * (1.6 * np.linspace(0, 1, len(ONE_WAY_UM)) + phase))
        found = axial_response(*scan(ONE_WAY_UM, light, 3))
        notes += [note for note in axial_notes(found) if "the light varies" in note]
    assert notes
    assert all("or more slowly" in note for note in notes)
