"""The camera's rate is that of its clock and numbers, not that at which frames happen to arrive."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.acquisition.streaming.tally import Tally
from napari_elsplus.hardware.protocols import FrameInfo


@pytest.mark.parametrize("lost", [1, 3], ids=["no frame lost", "two of three lost"])
def test_frames_that_arrive_in_a_burst_do_not_change_the_rate_of_the_camera(lost: int) -> None:
    tally = Tally()
    received_s = np.r_[np.arange(100) / 240, 0.6 + 1e-3 * np.arange(100)]
    for number, time_s in zip(range(0, 200 * lost, lost), received_s, strict=True):
        tally.arrived(FrameInfo(number, float(time_s), 7.0 + number / 240))
    assert tally.camera_hz == pytest.approx(240)
    assert tally.acquired == 200


def test_the_rate_is_that_of_the_last_frames() -> None:
    tally = Tally()
    time_s = 0.0
    for number in range(300):
        time_s += 1 / 240 if number < 150 else 1 / 100
        tally.arrived(FrameInfo(number, time_s, time_s))
    assert tally.camera_hz == pytest.approx(100)


def test_of_one_frame_there_is_no_rate() -> None:
    tally = Tally()
    assert np.isnan(tally.camera_hz)
    tally.arrived(FrameInfo(5, 1.0, 1.0))
    assert np.isnan(tally.camera_hz)


def test_saturation_is_that_of_the_run_not_of_its_last_frames() -> None:
    """After parking they are dark."""
    tally = Tally()
    assert np.isnan(tally.saturated)
    for saturated in (0.03, 0.03, 0.0):
        tally.displayed(saturated)
    assert tally.saturated == pytest.approx(0.02)


def test_a_cause_that_turns_out_to_have_lost_no_frame_is_not_kept() -> None:
    """Before: it stayed in the report."""
    tally = Tally()
    tally.lost_by_camera({"bad leader": 1}, 0)
    assert tally.dropped == {"camera: bad leader": 1}
    tally.lost_by_camera({"bad leader": 0}, 0)
    assert not tally.dropped
