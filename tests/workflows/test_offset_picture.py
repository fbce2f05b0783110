"""The offset step predicts sectioning for the line that was calibrated, with the present offset marked."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.calibration.draft import Draft, setup_of
from napari_elsplus.processing.calibration.sections import apply_offset
from napari_elsplus.processing.calibration.slit_offset import OffsetFollower, SlitOffset
from napari_elsplus.processing.calibration.step import StepInputs
from napari_elsplus.processing.calibration.steps import find_step
from napari_elsplus.simulation.calibration_scenes import line_volts, standing_line
from napari_elsplus.simulation.model.axial_response import LINE_MODELS, signal_kept
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.workflows.calibration_report.picture import Picture
from napari_elsplus.workflows.calibration_report.plots import picture


def instrument(state: str) -> Instrument:
    return replace(Instrument.of("240hz"), line=LINE_MODELS[state])


def frames(state: str) -> list[np.ndarray]:
    return list(standing_line(instrument(state), line_volts(instrument(state)), seed=5))


def drawn(found: SlitOffset, state: str, draft: Draft) -> Picture:
    setup = replace(setup_of(frames(state)), um_per_px=instrument(state).optics.um_per_px)
    return picture(find_step("offset"), found, draft, setup)


def kept(shown: Picture) -> float:
    (line,) = [line for line in shown.lines if "signal kept" in line]
    return float(re.findall(r"signal kept (\d+) %", line)[0]) / 100


@pytest.mark.parametrize("state", ["a", "b"])
def test_the_prediction_is_that_of_the_line_itself_measured_followed_or_calibrated_before(state: str) -> None:
    taken, simulated = frames(state), instrument(state)
    step, draft = find_step("offset"), Draft(Calibration())
    true = signal_kept(offset_um=simulated.offset_um, slit_um=simulated.slit_um, line=simulated.line)
    measured = step.estimate(StepInputs(taken, setup_of(taken)), draft)
    assert kept(drawn(measured, state, draft)) == pytest.approx(true, abs=0.01)
    follower = OffsetFollower()
    for frame in taken[:3]:
        assert kept(drawn(follower.measure(frame), state, draft)) == pytest.approx(true, abs=0.01)
    known = draft.with_calibration(apply_offset(draft, measured))
    assert kept(drawn(replace(measured, parts=None), state, known)) == pytest.approx(true, abs=0.01)


def test_the_present_offset_is_marked_on_the_sectioning_against_the_offset() -> None:
    draft = Draft(Calibration())
    taken = frames("b")
    found = find_step("offset").estimate(StepInputs(taken, setup_of(taken)), draft)
    shown = drawn(found, "b", draft)
    (place_um, _, words) = shown.plots[1].marks[0]
    curve = shown.plots[1].curves[0]
    assert words == "now"
    assert place_um == pytest.approx(abs(found.rows) * instrument("b").optics.um_per_px)
    assert np.interp(place_um, curve.x, curve.y) == pytest.approx(100 * kept(shown), abs=1.0)
