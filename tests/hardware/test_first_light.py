"""The checks of the first hour find on the virtual rig what is known of it."""

from __future__ import annotations

import re
import subprocess
import sys
from contextlib import nullcontext
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from napari_elsplus.acquisition.calibrating.simulated import place_target
from napari_elsplus.diagnosis import first_light, first_light_scan
from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.hardware.protocols import FrameInfo
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.scan.timing import StrobePhase
from napari_elsplus.hardware.u3v.discovery import choose_camera
from napari_elsplus.hardware.virtual.bench import Simulation
from napari_elsplus.instrument.optics import PRESETS
from napari_elsplus.processing.calibration.step import Target
from napari_elsplus.simulation.specimen.scenes import empty
from napari_elsplus.simulation.specimen.trajectories import Still
from sfnc_camera import StandardRegisters


@pytest.fixture(scope="module")
def rig():
    with open_rig(simulation=Simulation(scene=empty(), trajectory=Still())) as opened:
        yield opened


def test_the_camera_is_examined_and_its_line_period_found_from_its_limits(cameras) -> None:
    bench = cameras()
    said = "\n".join(first_light.examine_camera(choose_camera("", bench.bus)))
    assert "1e10:3300" in said
    assert "control 0x01 and 0x81, stream 0x82" in said
    assert "serial 4711" in said
    assert f"{130751:#010x}" in said
    assert "sensor 1048 x 1328, in steps of 4 x 16" in said
    assert "units of 1 ns" in said
    # the virtual camera's shortest frame is 240 Hz at 524 rows and in proportion, idle rows included
    assert "524 rows: at most 240.0" in said


def test_a_camera_of_any_make_is_examined_by_its_own_limits(cameras) -> None:
    pytest.importorskip("genicam", reason="EMVA's reader of descriptions (the extra genicam) is not installed")
    bench = cameras(make=StandardRegisters)
    bench.plug.camera.faults.tick_ns = 8.0
    said = "\n".join(first_light.examine_camera(choose_camera("", bench.bus), "genicam"))
    assert "model virtual SFNC camera" in said
    assert "sensor 960 x 1280, in steps of 2 x 8" in said
    assert float(re.search(r"units of (\S+) ns", said)[1]) == pytest.approx(8, rel=0.01)
    assert "480 rows: at most" in said
    assert "line frequency" not in said


def test_streaming_is_measured(rig) -> None:
    said = list(first_light.stream(rig, "240hz", 0.5))
    assert said[0] == "streaming 240hz for 0.5 s"
    assert said[1].startswith("120 frames")
    assert "4.16667 ms" in said[-1]
    with pytest.raises(InputError, match=r"0\.01 s"):
        list(first_light.stream(rig, "240hz", 0.01))


def test_parking_is_read_back_and_the_effect_of_a_reset_reported(rig) -> None:
    found = list(first_light.parking(rig))
    assert f"read back {rig.scanner.park_v:.3f} V" in found[0]
    assert "left the output at 0.000 V" in found[1]
    assert "none" in found[2]
    assert rig.scanner.park_state.parked
    assert rig.bench.card.last_volts == rig.scanner.park_v


def test_every_strobe_is_heard_and_the_mirror_never_leaves_its_parking_position(rig) -> None:
    before = len(rig.bench.card.programs())
    said = list(first_light.strobe(rig, "120hz", 1.0))
    assert "one ramp for every frame" in said[-1]
    for program in rig.bench.card.programs()[before:]:
        assert {*program.samples, program.resting_v} == {rig.scanner.park_v}


class LateComputer:
    """A camera at 100 Hz, a card of which some strobes start no ramp, and a computer that reads the last frames late.

    It is its own camera, scanner and module of time.
    """

    period_s = 0.01
    frame_shape = (2, 2)
    line_period_s, line_periods_per_frame = 1e-5, 1000.0
    limits = SimpleNamespace()
    park_v = 0.0

    def __init__(self, late_s: float, unheard: int) -> None:
        self.now_s, self.frames, self._late_s, self._unheard = 0.0, 0, late_s, unheard
        self.camera = self.scanner = self
        self.check_guarded = self.check = self.start = self.stop = self.park = lambda: None

    def scan(self, waveform) -> None:
        pass

    def read_into(self, buffer, timeout_s):
        self.frames += 1
        ended_s = self.frames * self.period_s
        self.now_s = max(self.now_s, ended_s + (self._late_s if self.frames > 60 else 0.0))
        return FrameInfo(self.frames, ended_s + 1e-4, ended_s + 77.0)

    @property
    def ramps_begun(self) -> int:
        return 1 + int(self.now_s / self.period_s) - (self._unheard if self.frames > 60 else 0)

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds

    def perf_counter(self) -> float:
        return self.now_s


@pytest.mark.parametrize("late_s", [0.0, 0.004, 0.013, 0.07])
@pytest.mark.parametrize("unheard", [0, 1, 3])
def test_unheard_strobes_are_counted_however_late_frames_are_read(late_s, unheard, monkeypatch) -> None:
    """Before: a computer that was busy at the end of the check was told of ramps without a frame."""
    late = LateComputer(late_s, unheard)
    monkeypatch.setattr(first_light, "time", late)
    monkeypatch.setattr(first_light, "_configure", lambda rig, preset, seconds: 100)
    monkeypatch.setattr(first_light, "parked_waveform", lambda *_: None)
    said = list(first_light.strobe(late, "120hz", 1.0))[-1]
    assert said.startswith(f"{unheard} strobe(s) started no ramp" if unheard else "one ramp for every frame")


def test_a_strobe_that_starts_two_ramps_is_not_called_unheard(rig, monkeypatch) -> None:
    """Before: -120 strobes unheard, and the remedy of a counter that is too slow."""
    ramps = count(step=2)
    monkeypatch.setattr(type(rig.scanner), "ramps_begun", property(lambda _: next(ramps)))
    said = list(first_light.strobe(rig, "120hz", 1.0))
    assert re.fullmatch(r"\d\d+ ramp\(s\) without a frame: .*", said[-1])


def second_order(times_s, natural_hz: float = 1000.0, damping: float = 0.7):
    """Step response of the simulated galvo, by the textbook's formula."""
    turns, ring = 2 * np.pi * natural_hz * np.maximum(times_s, 0), np.sqrt(1 - damping**2)
    return 1 - np.exp(-damping * turns) * (np.cos(ring * turns) + damping / ring * np.sin(ring * turns))


def test_numbers_of_a_step_response_are_those_of_the_formula() -> None:
    times_s = np.arange(-50e-6, 3e-3, 10e-6)
    response = first_light_scan.StepResponse(times_s, second_order(times_s), 64.0)
    fine_s = np.arange(0, 1e-3, 1e-7)
    begin_s, end_s = (fine_s[np.argmax(second_order(fine_s) >= part)] for part in (0.1, 0.9))
    assert response.reached_s(0.1) == pytest.approx(begin_s, abs=1e-6)
    assert response.reached_s(0.9) == pytest.approx(end_s, abs=1e-6)
    assert response.overshoot == pytest.approx(np.exp(-np.pi * 0.7 / np.sqrt(1 - 0.49)), abs=1e-3)
    assert abs(second_order(response.settled_s) - 1) * 64 <= 1
    with pytest.raises(MeasurementError, match="pass 90%"):
        first_light_scan.StepResponse(times_s, np.zeros(len(times_s)), 64.0).reached_s(0.9)


@pytest.fixture
def lit(rig):
    """The rig with its true calibration, an even target before the probe."""
    place_target(rig, Target.FLUORESCENT)
    yield rig, rig.bench.optics.calibration(PRESETS["120hz"])
    rig.bench.optics.show(empty(), Still())
    rig.strobe = StrobePhase.EXPOSURE


def test_the_step_of_the_mirror_is_seen_as_it_moves(lit, monkeypatch) -> None:
    monkeypatch.setattr(first_light_scan, "STEP_TIMES_S", np.array([300e-6, 500e-6]))
    monkeypatch.setattr(first_light_scan, "FRAMES", 1)
    calibration = lit[0].bench.optics.calibration(PRESETS["240hz"])
    response = first_light_scan.measure_step(lit[0], calibration, "240hz")
    assert 0.2 < response.moved.min() < response.moved.max() < 0.95
    np.testing.assert_allclose(response.moved, second_order(response.times_s), atol=0.02)
    assert lit[0].scanner.park_state.parked


@pytest.mark.slow
def test_the_step_response_is_reported_with_its_numbers(lit) -> None:
    said = list(first_light.mirror_step(*lit, "120hz"))
    rise_us, overshoot = map(float, re.search(r"90 % in (\d+) us, overshoot ([\d.]+)%", said[1]).groups())
    assert rise_us == pytest.approx(338, rel=0.05)
    assert overshoot == pytest.approx(4.6, abs=0.6)
    points = np.array([[float(word) for word in line.replace("us", "").split()] for line in said[3:]])
    np.testing.assert_allclose(points[:, 1], second_order(points[:, 0] * 1e-6), atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("stated", list(StrobePhase))
def test_the_strobes_phase_is_told_from_two_exposures(lit, stated) -> None:
    lit[0].strobe = stated
    said = list(first_light.strobe_phase(*lit, "120hz"))
    right = stated is StrobePhase.EXPOSURE
    difference = float(re.search(r"difference (\S+) line periods", said[2])[1])
    assert difference == pytest.approx(0 if right else -10, abs=0.5)
    assert said[3] == ('strobe = "exposure" is right' if right else said[3])
    assert ('write strobe = "exposure"' in said[3]) != right


def test_a_real_rig_needs_a_calibration_for_the_checks_with_light(monkeypatch) -> None:
    monkeypatch.setattr(first_light_scan, "open_rig", lambda name: nullcontext(SimpleNamespace(bench=None)))
    done = CliRunner().invoke(first_light.first_light, ["step", "--rig", "mine"])
    assert isinstance(done.exception, InputError)
    assert "the rig mine needs a calibration" in str(done.exception)


def test_findings_are_appended_to_a_report(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(first_light, "choose_camera", lambda serial: None)
    findings = lambda device, kind: iter([f"kind {kind}", "line period 7.6 us"])  # noqa: E731 - a stand-in
    monkeypatch.setattr(first_light, "examine_camera", findings)
    report = tmp_path / "report.txt"
    for _ in range(2):
        done = CliRunner().invoke(first_light.first_light, ["--report", str(report), "camera"])
        assert done.exit_code == 0
    lines = report.read_text("utf-8").splitlines()
    assert len(lines) == 6
    assert lines[0].startswith("camera, 2")
    assert lines[1:3] == ["kind flea3", "line period 7.6 us"] == done.output.splitlines()[1:]


@pytest.mark.slow
def test_a_rig_whose_program_is_killed_streams_again() -> None:
    done = run_check("reopen", "--rig", "simulated")
    assert done.returncode == 0
    said = done.stdout.splitlines()
    assert said[1] == "a program that streamed was killed"
    assert said[2].startswith("frames 2 to ")


@pytest.mark.parametrize("check", ["stream", "reopen", "card"])
def test_a_check_of_a_rig_that_does_not_exist_fails_in_one_line(check: str) -> None:
    done = run_check(check, "--rig", "nobodys")
    assert done.returncode == 2
    assert done.stderr.strip().splitlines() == [done.stderr.strip()]
    assert "there is no rig 'nobodys'" in done.stderr


def test_a_simulated_rig_has_no_card_to_check() -> None:
    done = CliRunner().invoke(first_light.first_light, ["card", "--rig", "simulated"])
    assert str(done.exception) == "the rig simulated is simulated: name one whose file has a card"


def test_a_report_that_cannot_be_written_is_said_in_one_line(tmp_path) -> None:
    done = run_check("--report", str(tmp_path / "missing" / "report.txt"), "stream")
    assert done.returncode == 2
    assert done.stderr.startswith("first_light: ")
    assert "Traceback" not in done.stderr


def run_check(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the checks as the documentation does."""
    command = [sys.executable, "-m", "napari_elsplus.diagnosis.first_light", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
