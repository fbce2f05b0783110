from __future__ import annotations

import numpy as np
import pytest

from benchmarks.rigs.simulated import simulated_rig
from benchmarks.studies.acceptance import CONSTRAINED, ROWS, Row, acceptance_table, change_of_view, measure
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.simulation.specimen.scenes import picture


@pytest.mark.parametrize("row", [Row(0, "hand", 20.0), Row(180, "hand", 240.0), Row(180, "jerky", 60.0)], ids=str)
def test_right_registrations_are_kept_and_wrong_ones_rejected(row: Row) -> None:
    """At 20 Hz the mean of two velocities is far from the displacement between them."""
    counts = measure(row, range(2), 24)
    assert counts.wrong == 0
    assert counts.kept > 0.8 * counts.countable > 20
    assert 0.2 < np.sqrt(np.mean(counts.normalised**2) / 2) < 2.5


def test_few_fibres_under_a_fast_hand_are_not_taken_for_a_rotation() -> None:
    """Stretch by acceleration turns a lone fibre as rotation does; with it shifts of 3.5 and 10 px were accepted."""
    assert measure(Row(60, "hand", 20.0), [7], 26).wrong == 0


@pytest.mark.parametrize(
    ("row", "seed"),
    [(Row(60, "hand", 120.0), 752), (Row(60, "jerky", 60.0), 816), (Row(3, "hand", 240.0), 803)],
    ids=("beyond the competitors", "between two competitors", "on and on"),
)
def test_a_fibre_does_not_slide_far_along_itself(row: Row, seed: int) -> None:
    """By 13 pixels of the grid, which the next registrations repeated: no shift near the true one competed."""
    assert measure(row, [seed]).wrong == 0


def test_structure_that_constrains_a_shift_is_distinguished() -> None:
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
    assert changes[1] < CONSTRAINED < changes[2]


def test_the_table_has_counts_and_a_line_for_each_row() -> None:
    counts, _, *lines = acceptance_table([ROWS[0]], [0])
    assert counts.startswith("Wrong are 0 of 39 registrations in the rows of rich tissue (0 between frames")
    assert len(lines) == 3
    assert lines[-1].startswith("| rich, hand, 240 Hz | 39 | 100.0 % | 39 | 0 |")


@pytest.mark.slow
@pytest.mark.parametrize(("row", "kept"), [(ROWS[0], 0.99), (ROWS[3], 0.98), (ROWS[8], 0.97)], ids=str)
def test_whole_recordings_of_held_out_seeds_are_tracked(row: Row, kept: float) -> None:
    counts = measure(row)
    assert counts.wrong == 0
    assert counts.kept > kept * counts.countable
