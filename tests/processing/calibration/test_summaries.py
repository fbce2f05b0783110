"""Warnings in the summaries of calibration steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.calibration.draft import Draft
from napari_elsplus.processing.calibration.measurements import measure_pair
from napari_elsplus.processing.calibration.sections import apply_pair
from napari_elsplus.processing.calibration.summaries import summarize_flat_field, summarize_pair


@pytest.mark.parametrize(("edge_seen", "warned"), [(0.3, True), (0.6, False)])
def test_an_edge_that_is_seen_in_part_is_warned_of(edge_seen: float, warned: bool) -> None:
    found = measure_pair(Rig(left=(110.0, 103.0), right=(105.5, 318.3), diameter_px=190.0).bundle(2))
    pair = replace(found, confocal=replace(found.confocal, edge_seen=edge_seen))
    draft = Draft(Calibration())
    summary = summarize_pair(pair, draft.with_calibration(apply_pair(draft, pair)), None)
    assert any("the edge of the confocal view is seen on 30 %" in text for text in summary.warnings) == warned


@pytest.mark.parametrize(("spread", "warned"), [(0.09, False), (0.17, True)])
def test_a_gain_that_varies_as_that_of_a_scanned_target_is_warned_of(spread: float, warned: bool) -> None:
    pair = measure_pair(Rig(left=(110.0, 103.0), right=(105.5, 318.3), diameter_px=190.0).bundle(2))
    draft = Draft(Calibration())
    known = apply_pair(draft, pair)
    gain_map = np.tile(np.float32([1 - spread, 1 + spread]), (192, 96))
    known = known.model_copy(update={"gain_map": gain_map})
    summary = summarize_pair(pair, draft.with_calibration(known), None)
    assert any("varies by" in text and "laser off" in text for text in summary.warnings) == warned


@pytest.mark.parametrize(("depth", "warned"), [(0.1, False), (0.9, True)])
def test_a_flat_field_of_a_structured_target_is_warned_of(depth: float, warned: bool) -> None:
    draft = Draft(Calibration())
    draft = draft.with_calibration(
        apply_pair(draft, measure_pair(Rig(left=(110.0, 103.0), right=(105.5, 318.3), diameter_px=190.0).bundle(2)))
    )
    assert draft.calibration.flat is not None
    row, col = np.indices(draft.calibration.flat.shape)
    squares = np.where(np.sin(row / 7) * np.sin(col / 9) > 0, 1, 1 - depth)
    summary = summarize_flat_field((draft.calibration.flat * squares).astype(np.float32), draft, None)
    assert [text.partition(" by ")[0] for text in summary.warnings] == ["the light varies"] * warned
    assert all("take it on an even target" in text for text in summary.warnings)
