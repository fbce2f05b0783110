"""What a slit offset gives and costs: the quick prediction agrees with what rendered frames show."""

from __future__ import annotations

from dataclasses import replace

import pytest

from napari_elsplus.evaluation.random_rigs import Rig
from napari_elsplus.evaluation.sectioning import weigh_offset
from napari_elsplus.evaluation.trade import line_as_seen, weigh
from napari_elsplus.processing.calibration.line import locate_line
from napari_elsplus.simulation.axial_response import LINE_MODELS

LINE = LINE_MODELS["a"]


@pytest.mark.parametrize("offset_um", [12.0, 29.0, 77.0])
def test_the_quick_prediction_agrees_with_rendered_frames(offset_um: float) -> None:
    quick, slow = weigh(-offset_um, 2.9, LINE, 80.0), weigh_offset(offset_um)
    assert quick.drop_10db_um == pytest.approx(slow.drop_10db_um)
    assert quick.signal_kept == pytest.approx(slow.signal_kept)
    assert quick.contrast_to_noise == pytest.approx(slow.contrast_to_noise, rel=0.02)
    assert quick.clipped == pytest.approx(slow.clipped, abs=0.008)


def test_more_light_and_less_gain_for_as_many_grey_levels_mean_less_noise() -> None:
    usual = weigh(29.0, 2.9, LINE, 80.0).contrast_to_noise
    assert weigh(29.0, 2.9, LINE, 160.0).contrast_to_noise > 1.3 * usual
    assert weigh(29.0, 2.9, LINE, 80.0, gain_db=6.0).contrast_to_noise < 0.75 * usual


def test_the_line_is_taken_as_it_is_seen() -> None:
    rig = Rig(left=(100.0, 98.0), right=(91.0, 302.5), diameter_px=180.0, halo_share=0.0)
    for rows in (2.0, 4.0):
        seen = locate_line(replace(rig, line_rows=rows).line(1)[0][:, :200])
        assert line_as_seen(seen, 1, 2.0).core_um == pytest.approx(2 * rows, rel=0.1)
    wide = replace(LINE, core_um=2 * LINE.core_um)
    assert weigh(29.0, 2.9, wide, 80.0).drop_10db_um > weigh(29.0, 2.9, LINE, 80.0).drop_10db_um
