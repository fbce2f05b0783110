"""Cameras whose numbers or times do not go on as they should."""

from __future__ import annotations

import time
from dataclasses import replace
from threading import Timer

import numpy as np
import pytest

from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.io import open_recording

JUMPS_S = {
    "an hour ahead": {40: 3600.0},
    "an hour back": {40: -3600.0},
    "a single wrong time": {40: 3600.0, 41: 0.0},
    "back to zero": {40: -0.4},
}


def disturb(rig, jumps_s: dict[int, float]) -> None:
    """Add seconds to the times of the frames from some numbers on."""
    read = rig.camera.read_into

    def read_disturbed(buffer, timeout_s):
        info = read(buffer, timeout_s)
        begun = [number for number in jumps_s if number <= info.frame_number]
        return replace(info, readout_start_s=info.readout_start_s + (jumps_s[max(begun)] if begun else 0.0))

    rig.camera.read_into = read_disturbed


def start_with_old_frames(engine: Engine) -> None:
    engine.start()
    while not engine.status().acquired:
        time.sleep(0.01)
    engine._run._camera_worker.camera_clock_s -= 3600.0


@pytest.mark.parametrize("jumps_s", JUMPS_S.values(), ids=JUMPS_S)
def test_a_clock_that_jumps_leaves_times_even_and_frames_fresh(engine: Engine, rig, tmp_path, jumps_s) -> None:
    """Before: no frame counted as fresh any more, for as long as the jump, and procedures waited."""
    disturb(rig, jumps_s)
    engine.start()
    engine.record(RecordingPlan(tmp_path / "frames.ome.tif", seconds=1.0))
    while engine.status().acquired < 60:
        time.sleep(0.01)
    asked_s = time.perf_counter()
    assert len(engine.fresh_frames(2, asked_s)) == 2
    assert time.perf_counter() - asked_s < 1.0
    engine.stop()
    engine.finish_recording()
    with open_recording(tmp_path / "frames.ome.tif") as recording:
        assert np.diff(recording.times_s) == pytest.approx(1 / 100, abs=1e-6)
    (fault,) = engine.status().faults
    assert "clock of the camera jumped" in fault.problem


def test_numbers_that_fall_end_the_stream_with_the_galvo_parked(engine: Engine, rig) -> None:
    """Before: nobody could say how many frames were missing, and nobody was told."""
    read = rig.camera.read_into

    def read_anew(buffer, timeout_s):
        info = read(buffer, timeout_s)
        return replace(info, frame_number=info.frame_number % 40)

    rig.camera.read_into = read_anew
    engine.start()
    end_s = time.monotonic() + 10
    while not engine.status().faults:
        assert time.monotonic() < end_s
        time.sleep(0.01)
    assert "counts its frames anew" in engine.status().faults[0].problem
    while engine.status().live:
        assert time.monotonic() < end_s
        time.sleep(0.01)
    assert rig.scanner.park_state.parked


def test_frames_that_are_never_fresh_are_not_awaited_without_end(engine: Engine) -> None:
    """Before: it waited as long as frames came."""
    start_with_old_frames(engine)
    begun_s = time.perf_counter()
    with pytest.raises(DeviceError, match="0 of 3 frames"):
        engine.fresh_frames(3, begun_s)
    assert time.perf_counter() - begun_s < 4.0


def test_slow_frames_are_awaited_by_their_own_period(engine: Engine) -> None:
    """Before: "0 of 1 frames came: check the camera", of a camera that was only slow."""
    engine.configure(Settings("240hz", frame_rate_hz=0.9))
    engine.start()
    assert engine.fresh_frames(1).shape == (1, 524, 1328)


def test_parking_ends_whoever_waits_for_frames(engine: Engine) -> None:
    """Before: the operation went on to its time limit."""
    start_with_old_frames(engine)
    park = Timer(0.3, engine.park)
    park.start()
    begun_s = time.perf_counter()
    with engine.operations.alone("a sweep", long=True), pytest.raises(InputError, match="was parked"):
        engine.fresh_frames(3, begun_s)
    assert time.perf_counter() - begun_s < 1.0
    park.join()
