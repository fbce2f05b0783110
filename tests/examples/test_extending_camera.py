"""The drivers of examples/extending are opened from a rig file and drive the engine, from outside the package."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.errors import DeviceError, ElsPlusError, InputError
from napari_elsplus.hardware.daq.output import CardSettings
from napari_elsplus.hardware.parking import ParkStage, ParkState
from napari_elsplus.hardware.protocols import Camera, Region, Scanner
from napari_elsplus.hardware.rigs import open_rig, rig_names
from napari_elsplus.hardware.scan.waveform import GalvoLimits
from napari_elsplus.hardware.takeover import ParkOrder
from napari_elsplus.instrument.optics import PRESETS

pytestmark = pytest.mark.checkout

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "extending"
PRESET = PRESETS["240hz"]


@pytest.fixture
def frames(tmp_path, monkeypatch) -> np.ndarray:
    """The rig file where rigs are looked for, its drivers importable, its recording beside."""
    (tmp_path / "rigs").mkdir()
    text = (EXAMPLE / "playback.toml").read_text("utf-8")
    (tmp_path / "rigs" / "playback.toml").write_text(text.replace("scan.btf", (tmp_path / "scan.npy").as_posix()))
    monkeypatch.setenv("ELSPLUS_CONFIG", str(tmp_path))
    monkeypatch.syspath_prepend(str(EXAMPLE))
    frames = np.random.default_rng(0).integers(0, 200, (3, *PRESET.frame_shape), np.uint8)
    np.save(tmp_path / "scan.npy", frames)
    return frames


def test_the_camera_of_a_rig_file_plays_its_recording(frames) -> None:
    assert "playback" in rig_names()
    with open_rig("playback") as rig:
        assert isinstance(rig.scanner, Scanner)
        rig.camera.configure(Region(*PRESET.sensor_origin, *PRESET.frame_shape), slit_rows=3, frame_rate_hz=100)
        assert isinstance(rig.camera, Camera)
        rig.camera.start()
        buffer = np.empty(PRESET.frame_shape, np.uint8)
        for number in range(5):
            assert rig.camera.read_into(buffer, 5.0).frame_number == number
            np.testing.assert_array_equal(buffer, frames[number % 3])
        with pytest.raises(DeviceError, match="without a galvo"):
            rig.scanner.hold(0.1)


def test_the_engine_runs_it(frames) -> None:
    with Engine(open_rig("playback"), buffer_s=0.5) as engine:
        engine.configure(Settings("240hz", frame_rate_hz=60))
        engine.start()
        np.testing.assert_array_equal(np.sort(engine.fresh_frames(3).sum((1, 2))), np.sort(frames.sum((1, 2))))
        engine.stop()
        assert not engine.status().faults


LINE = """
from pathlib import Path
from napari_elsplus.errors import DeviceError
from scanner import StillScanner

class LineScanner(StillScanner):
    '''A galvo whose position is the content of a file, and stays when the program dies.'''

    def __init__(self, card, limits, *, place):
        super().__init__(card, limits)
        self._place = Path(place)
        if self._place.with_suffix(".busy").exists():
            raise DeviceError("the galvo is busy", "wait")
        self.hold(card.park_v)

    @property
    def park_state(self):
        if self._place.with_suffix(".unread").exists():
            raise RuntimeError("the state cannot be read")
        return super().park_state

    def hold(self, volts):
        self._place.write_text(f"{volts}")

    def park(self):
        self.hold(self.park_v)

    def close(self):
        self.park()
"""
DRIVE = """
import sys, time
sys.path.append(sys.argv[1])
from napari_elsplus.hardware.rigs import open_rig
with open_rig("mine") as rig:
    rig.scanner.hold(0.3)
    print("holds", flush=True)
    time.sleep(60)
"""


def test_a_guardian_goes_on_after_an_error_of_a_driver_of_ones_own(frames, tmp_path, monkeypatch) -> None:
    """Before: it ended with a traceback, the galvo where it was."""
    (tmp_path / "mine.py").write_text(LINE)
    monkeypatch.syspath_prepend(str(tmp_path))
    unread = tmp_path / "place.unread"
    unread.touch()
    order = ParkOrder(CardSettings(-0.7), GalvoLimits(), "mine:LineScanner", {"place": str(tmp_path / "place")})
    stages = []

    def report(state: ParkState) -> None:
        stages.append(state.stage)
        unread.unlink(missing_ok=True)

    assert order.take_over(report).parked
    assert stages == [ParkStage.NOT_PARKED, ParkStage.PARKED]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
@pytest.mark.parametrize("busy", [False, True])
def test_a_scanner_of_ones_own_is_parked_when_its_process_is_killed(frames, tmp_path, busy) -> None:
    place = tmp_path / "place"
    (tmp_path / "mine.py").write_text(LINE)
    text = (tmp_path / "rigs" / "playback.toml").read_text("utf-8").split("[scanner]")[0]
    scanner = (
        f'[scanner]\nkind = "mine:LineScanner"\noptions = {{ place = "{place.as_posix()}" }}\n[card]\npark_v = -0.7\n'
    )
    (tmp_path / "rigs" / "mine.toml").write_text(text + scanner)
    (tmp_path / "drive.py").write_text(DRIVE)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [*sys.path, str(EXAMPLE)]))}
    command = [sys.executable, str(tmp_path / "drive.py"), str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as driver:
        assert driver.stdout is not None
        assert driver.stdout.readline() == "holds\n"
        assert place.read_text() == "0.3"
        if busy:
            place.with_suffix(".busy").touch()
        driver.kill()
    if busy:
        time.sleep(0.5)
        assert place.read_text() == "0.3"
        place.with_suffix(".busy").unlink()
    until_s = time.perf_counter() + 10
    while place.read_text() != "-0.7":
        assert time.perf_counter() < until_s
        time.sleep(0.01)


@pytest.mark.parametrize(
    ("kind", "refusal"),
    [
        ("camera:PlaybackCamera", "cannot open its device"),  # without the recording that it needs
        ("camera:Absent", "cannot be imported"),
        ("no_such_module:Camera", "cannot be imported"),
        ("broken:Camera", "cannot be imported"),
        ("pathlib:PurePath", "lacks .*read_into"),
        ("basler", "flea3, genicam"),
    ],
)
def test_a_driver_that_cannot_be_used_is_refused_in_one_line(frames, tmp_path, monkeypatch, kind, refusal) -> None:
    (tmp_path / "broken.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "rigs" / "mine.toml").write_text(f'[card]\npark_v = -0.7\n[camera]\nkind = "{kind}"\n')
    with pytest.raises(ElsPlusError, match=refusal) as refused:
        open_rig("mine")
    assert "\n" not in str(refused.value)
    assert kind in str(refused.value)


def test_options_for_a_built_in_driver_are_refused(frames, tmp_path) -> None:
    (tmp_path / "rigs" / "mine.toml").write_text('[card]\npark_v = -0.7\n[camera]\noptions = {recording = "scan"}\n')
    with pytest.raises(InputError, match="flea3 takes none"):
        open_rig("mine")
