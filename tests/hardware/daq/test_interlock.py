"""Interlocks, on simulated time."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.hardware.daq.interlock import NO_FRAMES_S, Interlock
from napari_elsplus.hardware.daq.output import CardSettings
from napari_elsplus.hardware.scan.waveform import Waveform

CHECK_S = 0.02


def seconds_until_fault(rate_hz: float, samples, frames, longest_s: float = 5.0) -> tuple[float, str]:
    """Time to the fault, and its message; ``samples`` and ``frames`` are functions of time."""
    card = CardSettings(-0.7, hold_limit_s=20.0)
    interlock = Interlock(card)
    interlock.scan(Waveform(np.zeros(100), 1, 25_000.0, 1 / rate_hz), 0.0, frames(0.0))
    for now_s in np.arange(CHECK_S, longest_s, CHECK_S):
        fault = interlock.fault(float(now_s), samples(now_s), frames(now_s))
        if fault is not None:
            return float(now_s), str(fault)
    return longest_s, ""


@pytest.mark.parametrize("rate_hz", [5, 10, 60, 240])
def test_frames_without_a_ramp_are_a_fault_within_half_a_second_and_the_wire_is_named(rate_hz) -> None:
    """Before: the line stood on the bundle until the hold limit, 20 s."""
    took_s, told = seconds_until_fault(rate_hz, lambda _: 0, lambda now_s: int(now_s * rate_hz))
    assert took_s - 1 / rate_hz < 0.45
    assert "no strobe reaches PFI0 of Dev1" in told


@pytest.mark.parametrize("rate_hz", [5, 10, 60, 240])
def test_ramps_that_end_are_a_lost_strobe_within_half_a_second(rate_hz) -> None:
    """Before: 0.6 s at 10 frames per second."""
    took_s, told = seconds_until_fault(
        rate_hz, lambda now_s: 100 * int(min(now_s, 1.0) * rate_hz), lambda now_s: int(now_s * rate_hz)
    )
    assert 1.0 < took_s < 1.45
    assert "no strobe for" in told


def test_ramps_without_frames_are_a_fault() -> None:
    took_s, told = seconds_until_fault(
        240, lambda now_s: 100 * int(now_s * 240), lambda now_s: int(min(now_s, 1) * 240)
    )
    assert 1 + NO_FRAMES_S < took_s < 1.2 + NO_FRAMES_S
    assert "no frame has come" in told


@pytest.mark.parametrize("rate_hz", [3, 10, 240])
def test_a_scan_in_order_is_no_fault_however_late_the_camera_starts(rate_hz) -> None:
    def since_start(now_s: float) -> int:
        return int(max(0.0, now_s - 2.0) * rate_hz)

    assert seconds_until_fault(rate_hz, lambda now_s: 100 * since_start(now_s), since_start)[1] == ""
    assert seconds_until_fault(rate_hz, lambda now_s: 100 * since_start(now_s), lambda _: None)[1] == ""


def test_a_computer_that_stood_still_is_no_fault() -> None:
    card = CardSettings(-0.7)
    interlock = Interlock(card)
    interlock.scan(Waveform(np.zeros(100), 1, 25_000.0, 1 / 240), 0.0, 0)
    assert interlock.fault(0.02, 400, 4) is None
    assert interlock.fault(30.0, 720_000, 4) is None  # the card went on, the frames are still on their way
    assert interlock.fault(30.02, 720_400, 7200) is None
