"""The checks of the first hour find on the virtual rig what is known of it."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from click.testing import CliRunner

from napari_elsplus.diagnosis import first_light
from napari_elsplus.errors import InputError
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.u3v.discovery import choose_camera
from napari_elsplus.hardware.virtual.bench import Simulation
from napari_elsplus.hardware.virtual.camera.sfnc import StandardRegisters
from napari_elsplus.simulation.specimen.scenes import empty
from napari_elsplus.simulation.specimen.trajectories import Still


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
    said = list(first_light.reopen("simulated", "240hz"))
    assert said[0] == "a program that streamed was killed"
    assert said[1].startswith("frames 2 to ")


def test_a_check_fails_in_one_line() -> None:
    command = [sys.executable, "-m", "napari_elsplus.diagnosis.first_light", "stream", "--rig", "nobodys"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stderr.strip().splitlines() == [done.stderr.strip()]
    assert "there is no rig 'nobodys'" in done.stderr
