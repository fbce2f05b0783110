from __future__ import annotations

import numpy as np
import pytest

from benchmarks.rigs.simulated import simulated_rig
from benchmarks.studies.gate import TOLD, change_of_view, gate, judged_links
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.simulation.specimen.scenes import picture


@pytest.mark.parametrize("jerks", [False, True], ids=["smooth", "jerky"])
def test_links_of_sparse_scenes_that_are_wrong_are_refused(jerks: bool) -> None:
    found = gate(judged_links(10, 2, jerks=jerks))
    assert found.right > 15
    assert found.kept_percent > 95
    assert found.wrong == 0 or found.caught_percent == 100


def test_what_tells_a_shift_is_told_from_what_does_not() -> None:
    """A view with one dot outside, a fibre from rim to rim, and one with an end in view."""
    grid = Grid.of(simulated_rig().calibration)
    whole = np.zeros((1200, 1200), np.float32)
    whole[598:602] = 1.0
    ended = whole.copy()
    ended[:, 620:] = 0
    dot = np.zeros_like(whole)
    dot[0, 0] = 1.0
    places = np.zeros((2, 2))
    changes = [change_of_view(picture(image, 2.0), places, grid, 4.0)[0] for image in (dot, whole, ended)]
    assert changes[0] == 0
    assert changes[1] < TOLD < changes[2]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fibres", "jerks", "caught", "kept"),
    [(180, False, 99, 95), (180, True, 99, 95), (60, False, 99, 95), (60, True, 99, 80)],
)
def test_wrong_links_are_caught_where_little_is_in_view(fibres: int, jerks: bool, caught: float, kept: float) -> None:
    found = gate(judged_links(40, range(12), fibres, jerks=jerks))
    assert found.wrong == 0 or found.caught_percent > caught
    assert found.kept_percent > kept
