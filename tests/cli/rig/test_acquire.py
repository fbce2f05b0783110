from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import tifffile

from napari_elsplus.acquisition.engine.status import Status
from napari_elsplus.cli.rig.acquire import notes
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.instrument.optics import preset
from napari_elsplus.io import open_recording, read_calibration, read_track, write_calibration

if TYPE_CHECKING:
    from collections.abc import Callable

COMMAND = (sys.executable, str(Path(__file__).parents[2] / "patient_process.py"), "acquire")


@pytest.fixture(scope="module")
def calibration_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rig") / "rig.json"
    with open_rig("simulated") as rig:
        assert rig.bench is not None
        write_calibration(path, rig.bench.optics.calibration(preset("240hz")))
    return path


def test_a_run_is_recorded_tracked_and_reported(calibration_file: Path, tmp_path: Path) -> None:
    files = {name: tmp_path / name for name in ("r.ome.tif", "m.ome.tif", "t.csv", "report.json")}
    done = subprocess.run(
        [
            *COMMAND, "-c", str(calibration_file), "--seconds", "1.5", "--record", str(files["r.ome.tif"]),
            "--rate-hz", "60", "--mosaic", str(files["m.ome.tif"]), "--track", str(files["t.csv"]),
            "--report", str(files["report.json"]),
        ],
        capture_output=True, text=True, timeout=240,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = json.loads(files["report.json"].read_text())
    frames = report["frames"]
    assert 78 < frames["acquired"] < 900  # what comes until a busy machine has stopped it counts, too
    assert set(report["latency_ms"]) == {"p50", "p99", "max"}
    assert report["faults"] == []
    assert {"camera", "processing", "recorder"} <= set(report["cpu_us_per_frame"])
    simulated = {name for name in report["cpu_us_per_frame"] if name.startswith("simulated ")}
    assert simulated >= {"simulated camera", "simulated card", "simulated card's server"}
    assert 10 < sum(report["cpu_us_per_frame"].values()) < 1e6
    assert 0 < report["started_s"] < 600
    assert report["camera_hz"] == pytest.approx(60, rel=0.1)
    with open_recording(files["r.ome.tif"]) as recording:
        assert len(recording) == frames["recorded"]
        assert recording.calibration is not None
        assert recording.metadata["settings"]["preset"] == "240hz"
    assert (tifffile.imread(files["m.ome.tif"]) != 0).sum() > 30_000
    track = read_track(files["t.csv"])
    assert len(track) == frames["processed"]
    assert np.mean([point.state == "tracked" for point in track]) > 0.9
    assert str(frames["acquired"]) in done.stdout


@pytest.mark.skipif(os.name != "posix", reason="interrupts as POSIX does")
@pytest.mark.parametrize("more_after_s", [(), (0.001, 0.02, 0.1)], ids=["once", "impatiently"])
def test_an_interrupt_ends_in_order(calibration_file: Path, tmp_path: Path, more_after_s: tuple[float, ...]) -> None:
    """Before: a second one met the unwinding of the first, after which it recorded without end."""
    running = subprocess.Popen(
        [
            *COMMAND, "-c", str(calibration_file), "--seconds", "200", "--rate-hz", "60",
            "--record", str(tmp_path / "r.ome.tif"), "--report", str(tmp_path / "report.json"),
            "--mosaic", str(tmp_path / "m.ome.tif"), "--track", str(tmp_path / "t.csv"),
        ],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    end_s = time.monotonic() + 100
    while not (tmp_path / "r.ome.tif").exists() or (tmp_path / "r.ome.tif").stat().st_size < 10 * 524 * 1328:
        assert running.poll() is None, running.communicate()
        assert time.monotonic() < end_s
        time.sleep(0.05)
    running.send_signal(signal.SIGINT)
    for pause_s in more_after_s:
        time.sleep(pause_s)
        running.send_signal(signal.SIGINT)
    try:
        _, said = running.communicate(timeout=30)
    finally:
        running.kill()
    assert running.returncode == 130
    assert "Traceback" not in said
    assert f"what was acquired until now is kept in {tmp_path / 'r.ome.tif'}, {tmp_path / 'm.ome.tif'}" in said
    assert len(read_track(tmp_path / "t.csv")) >= 10
    assert tifffile.imread(tmp_path / "m.ome.tif").any()
    recorded = json.loads((tmp_path / "report.json").read_text())["frames"]["recorded"]
    with open_recording(tmp_path / "r.ome.tif") as recording:
        assert len(recording) == recorded >= 10
        assert recording.metadata["settings"]["rig"] == "simulated"


@pytest.mark.parametrize(
    ("lacking", "rate_hz", "said"),
    [
        ("nothing", 240, ""),
        ("lag_s", 60, "scan lag not measured: the image is off the slit"),
        ("galvo", 60, "the galvo stayed parked and frames are"),
        ("speed", 240, "451 rows miss the slit, the galvo is too slow: choose 237 frames per second or fewer"),
    ],
)
def test_what_keeps_the_images_from_being_right_is_noted(
    elsplus: Callable[..., Any], calibration_file: Path, tmp_path: Path, lacking: str, rate_hz: float, said: str
) -> None:
    """Before: dark frames, or frames off the slit, were recorded and tracked without a word."""
    known = read_calibration(calibration_file)
    less = {
        "nothing": known,
        "lag_s": known.with_galvo(lag_s=None),
        "galvo": known.model_copy(update={"galvo": None}),
        "speed": known.with_galvo(rows_off=451, highest_rate_hz=237.0),
    }
    write_calibration(tmp_path / "less.json", less[lacking])
    files = ("--report", tmp_path / "report.json", "--track", tmp_path / "track.csv")
    run = elsplus("acquire", "-c", tmp_path / "less.json", "--seconds", 0.5, "--rate-hz", rate_hz, *files)
    assert run.code == 0, run.err
    assert "frames tracked in" in run.out
    noted = json.loads((tmp_path / "report.json").read_text())["notes"]
    assert any(said in note for note in noted) if said else noted == []
    assert all(f"note: {note}" in run.out for note in noted)


def test_saturation_is_noted_first() -> None:
    unknown = Calibration.parse(
        {"galvo": {"volts_per_row": 1e-3, "volts_at_row_zero": 0.0, "r_squared": 1.0, "rms_rows": 0.0}}
    )
    first, *others = notes(Status(saturated=0.02, stale={"background": "gain changed"}), unknown)
    assert first == "2.0 % of the pixels are saturated: lower the laser power or the gain"
    assert any("gain changed" in note for note in others)
    assert not any("saturated" in note for note in notes(Status(saturated=1e-4), unknown))


def test_a_run_that_did_not_begin_leaves_no_report(
    elsplus: Callable[..., Any], calibration_file: Path, tmp_path: Path
) -> None:
    """Before: the corrected command was refused because of it."""
    known = read_calibration(calibration_file)
    wider = known.model_copy(update={"bundle": known.measured_bundle.model_copy(update={"diameter_px": 523.0})})
    write_calibration(tmp_path / "wider.json", wider)
    run = elsplus("acquire", "-c", tmp_path / "wider.json", "--seconds", 0.5, "--report", tmp_path / "report.json")
    assert run.code == 2
    assert not (tmp_path / "report.json").exists()


def test_the_calibration_is_not_overwritten_by_the_report_even_if_forced(
    elsplus: Callable[..., Any], tmp_path: Path
) -> None:
    """Before: the report took its place after the run."""
    file = tmp_path / "cal.json"
    write_calibration(file, Calibration())
    before = file.read_bytes()
    run = elsplus("acquire", "-c", file, "--seconds", 0.5, "--report", file, "--force")
    assert run.code == 2
    assert "cal.json is read, and would be overwritten" in run.err
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--seconds", "1", "--rig", "none"], "no rig 'none'"),
        (["--seconds", "1", "-c", "absent.json"], "absent.json"),
        (["--seconds", "1", "--record", "/nowhere/r.ome.tif"], "/nowhere"),
        (["--seconds", "1", "--record", "r.npy"], "r.npy has a suffix that cannot be written: let it end in .ome.tif"),
        (["--seconds", "1", "--record", "r.raw"], "r.raw has a suffix that cannot be written: let it end in .ome.tif"),
        (["--seconds", "nan"], "--seconds is nan"),
        (["--seconds", "inf"], "--seconds is inf"),
        (["--seconds", "1e12"], "--seconds is 1e+12: give at most 9.22e+09"),
        (
            ["--seconds", "1e9", "--track", "t.csv"],
            "--seconds 1e+09 at 240 Hz are 2.4e+11 frames: give at most 41667",
        ),
        (["--seconds", "1e8", "--record", "r.ome.tif"], "r.ome.tif: 16700928.0 GB do not fit into the"),
        (["--seconds", "1", "--record", ""], "name of a file or folder is empty"),
    ],
)
def test_bad_input_is_said_in_one_line(
    elsplus: Callable[..., Any], tmp_path: Path, arguments: list[str], said: str
) -> None:
    run = elsplus("acquire", *arguments, "--report", tmp_path / "report.json")
    assert run.code == 2
    assert said in run.err
    assert run.err.count("\n") == 1
    assert not (tmp_path / "report.json").exists()
