from __future__ import annotations

import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.optics import PRESETS, Optics, preset


def test_slit_of_the_paper_is_whole_rows_at_the_bundle() -> None:
    optics = preset("120hz").optics
    assert [optics.um(rows) for rows in (2, 3, 6)] == pytest.approx([1.9, 2.9, 5.8], abs=0.05)


def test_presets_run_at_their_names_and_hold_two_bundles() -> None:
    for name, rate_hz in (("120hz", 120), ("240hz", 240)):
        mode = PRESETS[name]
        assert mode.optics.frame_rate_hz == pytest.approx(rate_hz)
        assert 2 * mode.optics.rows(620) < mode.frame_shape[1]
        assert mode.frame_shape[0] < mode.optics.line_periods_per_frame


def test_slower_frames_keep_the_line_period() -> None:
    fast = preset("240hz").optics
    slow = fast.at_rate(10)
    assert slow.line_period_s == fast.line_period_s
    assert slow.frame_period_s == pytest.approx(0.1)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_numbers_are_refused_with_their_value(value: float) -> None:
    with pytest.raises(InputError, match=f"um_per_px is {value}"):
        Optics(um_per_px=value)
