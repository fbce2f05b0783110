from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from benchmarks.documents.mosaicing import (
    PAGE,
    draw_errors,
    draw_mosaics,
    drift_table,
    make,
    pairs_table,
    table,
    turning_table,
)
from benchmarks.parsimony.turning import Turned, Walk
from benchmarks.stability.pairs import Statistics
from benchmarks.studies.drift import Drift
from benchmarks.studies.mosaicing import METHODS, Outcome, Scenario
from napari_elsplus.errors import InputError
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel
from napari_elsplus.simulation.accuracy import TrackErrors

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure


def made() -> dict[str, Outcome]:
    image = np.random.default_rng(0).random((50, 400)).astype(np.float32)
    errors = TrackErrors(10, 9, 1, 0.0123, 2, 0.0456, 100.0)
    return {method: Outcome(errors, np.linspace(0, 2, 10), image, image, 0.987, 0.954) for method in METHODS}


@pytest.mark.parametrize(
    "figure",
    [
        draw_mosaics(made()),
        draw_errors(made()),
    ],
)
def test_pictures_are_drawn(figure: Figure, tmp_path: Path) -> None:
    figure.savefig(tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 5000


def test_table_has_a_line_for_every_method() -> None:
    lines = table({Scenario("fibres", "spiral", 16_000.0, 80): made()})
    assert len(lines) == 2 + len(METHODS)
    assert lines[-1] == "| fibres, spiral, 16 mm/s | ours | 0.012 | 0.046 | 2 | 9 of 10 | 0.987 | 0.954 |"


def test_tables_of_pairs_and_turns() -> None:
    many = {"link": {"fibres": Statistics(334, 0.0345, 0.3, 0.0), "nuclei": Statistics(334, 0.0234, 0.0, 0.0)}}
    assert pairs_table(many)[-1] == "| link | 668 | 0.3 %, 0.0 %; 0.035 | 0.0 %, 0.0 %; 0.023 |"
    errors = TrackErrors(10, 9, 1, 0.0123, 2, 0.0456, 100.0)
    walk = Walk("fibres", "hand", 1500.0, 10.0, 120)
    lines = turning_table({walk: Turned(MotionModel.RIGID, 8, 4.8, 0.031, errors, (2.344, 0.811, 0.7))})
    assert lines[-1] == (
        "| fibres, hand, 1.5 mm/s | 10 | 4.80 | rigid | 8 | 0.031 | 0.012 | 0.046 | 2 | 2.34; 0.81; 0.70 |"
    )


def test_a_page_without_a_place_for_the_table_is_refused_before_anything_is_measured(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no"):
        make(tmp_path)
    (tmp_path / PAGE).write_text("# Tracking")
    with pytest.raises(InputError, match="no place for"):
        make(tmp_path)


def test_drift_is_told_alone_live_and_after_the_graph() -> None:
    lines = drift_table({("fibres", True): Drift(5930.2, 0.0288, 0.00094, 0.00108, 1.0)})
    assert lines[-1] == "| fibres, rounds | 5930 | 100 % | 0.0288 | 0.0009 | 0.0011 |"
