"""Which frames were exposed after a moment: by the camera's own clock, whatever happened at its start."""

from __future__ import annotations

import time

import numpy as np
import pytest

from faulty_camera import FaultyCamera
from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.virtual.bench import Simulation
from napari_elsplus.instrument.optics import PRESETS
from napari_elsplus.simulation.specimen.scenes import uniform
from napari_elsplus.simulation.specimen.trajectories import Still

PRESET = PRESETS["240hz"]


@pytest.fixture
def engine(monkeypatch):
    monkeypatch.setattr("napari_elsplus.hardware.virtual.simulated_rig.VirtualCamera", FaultyCamera)
    rig = open_rig("simulated", Simulation(scene=uniform(), trajectory=Still()))
    with rig, Engine(rig) as engine:
        engine.configure(Settings("240hz"))
        yield engine


def brightest_row(frame: np.ndarray) -> int:
    view = frame[:, : frame.shape[1] // 2].mean(1, dtype=float)
    return int(np.convolve(view, np.ones(9), "same").argmax())


def test_after_a_lost_acknowledgement_standing_frames_show_the_line_where_it_is(engine) -> None:
    camera, faults = engine._rig.camera, engine._rig.bench.plug.camera.faults
    start = camera._features.start
    camera._control._timeout_ms = 100

    def start_unheard() -> None:
        faults.lose_acks = 1
        start()

    camera._features.start = start_unheard
    engine.start(scan=False)
    optics = engine._rig.bench.optics.instrument(PRESET)
    for row in (180, 300, 180, 300):
        engine.hold(optics.volts_at_row_zero + row * optics.volts_per_row)
        frames = engine.fresh_frames(4, time.perf_counter() + 4e-3)  # the mirror settles meanwhile
        assert [brightest_row(frame) for frame in frames] == pytest.approx([row] * 4, abs=4)


def test_a_recording_of_frames_without_timestamps_ends(engine, tmp_path) -> None:
    engine._rig.bench.plug.camera.faults.blank_timestamps = True
    engine.start(scan=False)
    begin_s = time.monotonic()
    engine.record(RecordingPlan(tmp_path / "frames.ome.tif", seconds=0.2))
    while engine.status().recording.running:
        assert time.monotonic() - begin_s < 5
        time.sleep(0.01)
    assert engine.status().recorded == pytest.approx(0.2 * 240, abs=2)
