"""What a slit offset gives and costs: the quick prediction agrees with what rendered frames show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.rigs.random_rigs import Rig
from benchmarks.studies.sectioning import clipped_share
from napari_elsplus.processing.calibration.line.location import locate_line
from napari_elsplus.simulation.model.axial_response import LINE_MODELS, line_response
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.workflows.sectioning_performance import (
    ELECTRONS_PER_DN,
    READ_NOISE_E,
    line_as_seen,
    predict_performance,
)

LINE = LINE_MODELS["a"]


@pytest.mark.parametrize("offset_um", [12.0, 29.0, 77.0])
def test_the_quick_prediction_of_the_clipped_field_agrees_with_rendered_frames(offset_um: float) -> None:
    rendered = clipped_share(Instrument.of("120hz", offset_um=-offset_um))
    assert predict_performance(-offset_um, 2.9, LINE, 80.0).clipped == pytest.approx(rendered, abs=0.008)


def test_the_camera_that_is_assumed_is_the_simulated_one() -> None:
    simulated = Instrument.of("120hz")
    assert (simulated.electrons_per_dn, simulated.read_noise_e) == (ELECTRONS_PER_DN, READ_NOISE_E)


def test_contrast_to_noise_is_signal_over_shot_and_read_noise_of_both_views() -> None:
    kept = predict_performance(29.0, 2.9, LINE, 80.0)
    confocal_e = 80.0 * ELECTRONS_PER_DN
    aside_e = confocal_e * float(line_response(0.0, 29.0, 2.9, LINE) / line_response(0.0, 0.0, 2.9, LINE))
    random = np.random.default_rng(0)
    seen = [random.poisson(e, 100_000) + random.normal(0, READ_NOISE_E, 100_000) for e in (confocal_e, aside_e)]
    difference = seen[0] - seen[1]
    assert kept.contrast_to_noise == pytest.approx(difference.mean() / difference.std(), rel=0.01)


def test_more_light_and_less_gain_for_as_many_grey_levels_mean_less_noise() -> None:
    usual = predict_performance(29.0, 2.9, LINE, 80.0).contrast_to_noise
    assert predict_performance(29.0, 2.9, LINE, 160.0).contrast_to_noise > 1.3 * usual
    assert predict_performance(29.0, 2.9, LINE, 80.0, gain_db=6.0).contrast_to_noise < 0.75 * usual


def test_the_line_is_taken_as_it_is_seen() -> None:
    rig = Rig(left=(100.0, 98.0), right=(91.0, 302.5), diameter_px=180.0, halo_share=0.0)
    for rows in (2.0, 4.0):
        seen = locate_line(replace(rig, line_rows=rows).line(1)[0][:, :200])
        assert line_as_seen(seen, 1, 2.0).core_um == pytest.approx(2 * rows, rel=0.1)
    wide = replace(LINE, core_um=2 * LINE.core_um)
    assert (
        predict_performance(29.0, 2.9, wide, 80.0).drop_10db_um
        > predict_performance(29.0, 2.9, LINE, 80.0).drop_10db_um
    )
