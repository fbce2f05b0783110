"""The registry of the calibration's steps, and the documentation that is generated from it."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import Calibration, FrameSection
from napari_elsplus.processing.calibration.draft import Draft, Setup
from napari_elsplus.processing.calibration.measurements import Background
from napari_elsplus.processing.calibration.step import REGISTERED, StepState
from napari_elsplus.processing.calibration.steps import calibration_steps, find_step, register_step
from steps_table import steps_table

DOCS = Path(__file__).resolve().parents[3] / "docs"


def test_the_steps_are_in_the_order_in_which_they_are_safe() -> None:
    assert [step.key for step in calibration_steps()] == ["offset", "galvo", "pair", "lag", "background", "flat"]
    first = [step.key for step in calibration_steps(first=("background", "pair"))]
    assert first == ["background", "pair", "offset", "galvo", "lag", "flat"]


@pytest.mark.parametrize("step", calibration_steps(), ids=lambda step: step.key)
def test_a_step_can_be_sent_to_another_process(step) -> None:
    assert pickle.loads(pickle.dumps(step)) == step


def test_a_line_that_scans_needs_galvo_map_and_bundle_pair_only_live() -> None:
    background, known = find_step("background"), Draft()
    assert background.missing(known) == "first the galvo map and the bundle pair"
    assert background.missing(known, live=False) == ""
    assert find_step("flat").missing(known, live=False) == "first the bundle pair"
    assert find_step("offset").missing(known) == ""


def test_a_step_is_done_once_its_section_is_in_the_calibration() -> None:
    draft = Draft(Calibration.parse({"offset": {"rows": -12.03, "uncertainty_rows": 0.01}}))
    assert find_step("offset").state(draft) == (StepState.DONE, "")
    assert find_step("galvo").state(draft) == (StepState.MISSING, "")


def test_a_calibration_is_created_when_its_last_step_is_accepted(monkeypatch) -> None:
    begun = Draft(Calibration(created="2026-01-31T08:00:00Z"))
    monkeypatch.setattr("napari_elsplus.processing.calibration.step.utc_now", lambda: "2026-01-31T12:00:00Z")
    background = Background(np.ones((4, 6), np.float32), 0.0, 2)
    accepted = find_step("background").accept(begun, background, Setup(FrameSection(shape=(4, 6))))
    assert accepted.calibration.created == "2026-01-31T12:00:00Z"
    assert begun.calibration.created == "2026-01-31T08:00:00Z"


def test_unknown_steps_are_refused() -> None:
    with pytest.raises(InputError, match="no calibration step 'focus'"):
        find_step("focus")
    with pytest.raises(InputError, match="needs focus"):
        register_step(replace(find_step("offset"), key="other", needs=("focus",)))
    assert "other" not in REGISTERED


@pytest.mark.checkout
def test_the_documentation_has_the_table_of_the_steps() -> None:
    text = (DOCS / "calibration.md").read_text("utf-8")
    table = text.partition("<!-- steps -->\n\n")[2].partition("\n\n<!-- end -->")[0]
    assert table == steps_table(), "put what steps_table() returns between the marks"
