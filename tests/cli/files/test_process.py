from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import RecordingWriter, open_recording, read_calibration, write_calibration
from videos import write_avi

SHAPE = (60, 130)
Cli = Callable[..., Any]


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """A raw stack of five frames and a calibration that fits it."""
    raw, calibration = tmp_path / "raw.tif", tmp_path / "cal.json"
    tifffile.imwrite(raw, np.random.default_rng(0).integers(0, 200, (5, *SHAPE)).astype(np.uint8))
    bundle = {
        "confocal_centre": [30.0, 32.0],
        "residual_centre": [28.0, 96.0],
        "diameter_px": 50,
        "residual_to_confocal": [[1, 0, 2], [0, 1, -64]],
    }
    write_calibration(calibration, Calibration.parse({"bundle": bundle, "optics": {"um_per_px": 2.0}}))
    return raw, calibration


SLOW = """
import signal, sys, time
from napari_elsplus.cli import main
from napari_elsplus.cli.files import process

if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which is ignored where the tests run under `nohup`

def slow(numbers, step):
    for number in numbers:
        if number == 150:  # of 200: the first ones are written
            print("begun", flush=True)
            time.sleep(600)
        yield number

process.progress = slow
main(sys.argv[1:])
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without a signal")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGINT"])
def test_a_command_that_is_ended_leaves_no_unfinished_file(files: tuple[Path, Path], tmp_path: Path, name: str) -> None:
    raw, calibration = files
    tifffile.imwrite(raw, np.zeros((200, *SHAPE), np.uint8))
    words = ["process", str(raw), "-c", str(calibration), "-o", str(tmp_path / "els.ome.tif")]
    running = subprocess.Popen([sys.executable, "-c", SLOW, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert running.stdout is not None
    assert running.stdout.readline() == b"begun\n"
    before = set(tmp_path.iterdir())
    running.send_signal(getattr(signal, name))
    said = running.communicate(timeout=200)[1].decode()
    assert len(before) == 3
    assert set(tmp_path.iterdir()) == {raw, calibration}
    assert running.returncode == 128 + getattr(signal, name)
    assert said.strip() == ("napari-elsplus: interrupted" if name == "SIGINT" else "")


def test_an_output_that_would_become_a_frame_of_the_recording_is_refused(
    elsplus: Cli, files: tuple[Path, Path], tmp_path: Path
) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    for index, frame in enumerate(tifffile.imread(files[0])):
        tifffile.imwrite(frames / f"{index}.tif", frame)
    before = {file.name: file.read_bytes() for file in frames.iterdir()}
    for name in ("3.tif", "els.ome.tif"):
        run = elsplus("process", frames, "-c", files[1], "-o", frames / name, "--force")
        assert run.code == 2
        assert "lies in" in run.err
    assert {file.name: file.read_bytes() for file in frames.iterdir()} == before
    assert elsplus("process", frames, "-c", files[1], "-o", tmp_path / "els.ome.tif").code == 0


def test_els_in_files_is_ls_minus_residual(elsplus: Cli, files: tuple[Path, Path], tmp_path: Path) -> None:
    raw, calibration = files
    result = {}
    for mode in ("ls", "residual", "els", "elsa"):
        out = tmp_path / f"{mode}.tif"
        assert elsplus("process", raw, "-c", calibration, "--mode", mode, "-o", out).code == 0
        result[mode] = tifffile.imread(out)
    assert result["els"].dtype == np.float32
    assert result["els"].shape == (5, 52, 52)
    assert result["elsa"].shape == (2, 52, 52)
    assert np.array_equal(result["els"], result["ls"] - result["residual"])


def test_compare_draws_and_tells(elsplus: Cli, files: tuple[Path, Path], tmp_path: Path) -> None:
    raw, calibration = files
    run = elsplus("compare", raw, "-c", calibration, "--frame", 3, "-o", tmp_path / "c.png")
    assert run.code == 0
    assert [line.split()[0] for line in run.out.splitlines()] == ["LS", "ELSA", "ELS+"]
    assert (tmp_path / "c.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("process", "absent.tif", "-c", "cal.json"), "absent.tif"),
        (("process", "raw.tif", "-c", "absent.json"), "absent.json"),
        (("process", "raw.tif", "-c", "cal.json", "--cores", "interpolate"), "flat field"),
        (("process", "raw.tif", "-c", "cal.json", "--flat-field"), "no flat field"),
        (("process", "one.tif", "-c", "cal.json", "--mode", "elsa"), "elsa needs 2 frames"),
        (("process", "small.tif", "-c", "cal.json"), "outside of the 20 x 30 frame"),
        (("process", "raw.tif", "-c", "raw.tif"), "raw.tif"),
        (("compare", "raw.tif", "-c", "cal.json", "--frame", "4"), "frame 4"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    elsplus: Cli,
    files: tuple[Path, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    word: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    tifffile.imwrite("one.tif", tifffile.imread("raw.tif", key=0))
    tifffile.imwrite("small.tif", np.zeros((4, 20, 30), np.uint8), photometric="minisblack")
    before = set(tmp_path.iterdir())
    run = elsplus(*arguments, "-o", "out.png" if arguments[0] == "compare" else "out.tif")
    assert run.code == 2
    assert word in run.err
    assert len(run.err.splitlines()) == 1
    assert set(tmp_path.iterdir()) == before


def test_an_existing_file_is_kept_unless_forced(elsplus: Cli, files: tuple[Path, Path], tmp_path: Path) -> None:
    raw, calibration = files
    out = tmp_path / "out.tif"
    out.write_text("precious")
    run = elsplus("process", raw, "-c", calibration, "-o", out)
    assert run.code == 2
    assert "--force" in run.err
    assert out.read_text() == "precious"
    assert elsplus("process", raw, "-c", calibration, "-o", out, "--force").code == 0
    assert tifffile.imread(out).shape == (5, 52, 52)


@pytest.mark.parametrize("command", ["process", "mosaic"])
def test_the_suffix_names_the_format(elsplus: Cli, files: tuple[Path, Path], tmp_path: Path, command: str) -> None:
    raw, calibration = files
    for name in ("out.ome.tif", "out.ome.zarr"):
        assert elsplus(command, raw, "-c", calibration, "-o", tmp_path / name).code == 0
    one, other = (open_recording(tmp_path / name) for name in ("out.ome.tif", "out.ome.zarr"))
    np.testing.assert_array_equal(one[:], other[:])
    assert other.metadata["um_per_px"] == pytest.approx(one.metadata["um_per_px"])
    for key in ("mode", "method"):
        assert other.metadata["settings"].get(key) == one.metadata["settings"].get(key)
    run = elsplus(command, raw, "-c", calibration, "-o", tmp_path / "out.png")
    assert (run.code, run.err.count("\n")) == (2, 1)
    assert "out.png has a suffix that cannot be written" in run.err


TIMED = {"line_period_s": 1e-4, "line_periods_per_frame": 100.0}
"""Frames 10 ms apart."""
EVEN_S = 0.02 * np.arange(6)
LOST_S = np.array([0.0, 0.02, 0.04, 0.1, 0.12, 0.14])
"""Times of a camera that is half as fast, and of one that lost two frames meanwhile."""


@pytest.mark.parametrize("ending", [".ome.tif", ".ome.zarr"])
@pytest.mark.parametrize(("mode", "step"), [("els", 1), ("elsa", 2)])
@pytest.mark.parametrize("times_s", [EVEN_S, LOST_S, 1000 + EVEN_S])
def test_images_have_the_times_of_the_frames_they_are_made_of(
    elsplus: Cli, files: tuple[Path, Path], tmp_path: Path, ending: str, mode: str, step: int, times_s: Any
) -> None:
    record = read_calibration(files[1]).with_optics(**TIMED)
    with RecordingWriter(tmp_path / "own.ome.tif", SHAPE, np.uint8, calibration=record) as writer:
        for k, time_s in enumerate(times_s):
            writer.append(np.zeros(SHAPE, np.uint8), float(time_s), k)
    out = tmp_path / f"out{ending}"
    run = elsplus("process", writer.path, "-c", tmp_path / "own.calibration.json", "--mode", mode, "-o", out)
    assert run.code == 0
    with open_recording(out) as back:
        assert back.metadata["frame_period_s"] == pytest.approx(0.02 * step)
        np.testing.assert_allclose(back.times_s, times_s[::step], atol=1e-9)


@pytest.mark.parametrize("timed", [True, False])
def test_the_rate_at_which_a_video_is_played_back_is_not_that_of_its_images(
    elsplus: Cli, files: tuple[Path, Path], tmp_path: Path, timed: bool
) -> None:
    write_avi(tmp_path / "raw.avi", np.zeros((4, *SHAPE), np.uint8), rate_hz="50")
    record = read_calibration(files[1])
    if timed:
        record = record.with_optics(**TIMED)
    write_calibration(files[1], record, force=True)
    assert elsplus("process", tmp_path / "raw.avi", "-c", files[1], "-o", tmp_path / "out.tif").code == 0
    with open_recording(tmp_path / "out.tif") as back:
        assert back.metadata.get("frame_period_s") == (pytest.approx(0.01) if timed else None)


@pytest.mark.filterwarnings("always:.*saved with")
def test_a_calibration_without_its_file_of_arrays_is_a_warning_of_one_line(
    elsplus: Cli, files: tuple[Path, Path], tmp_path: Path
) -> None:
    raw, calibration = files
    known = read_calibration(calibration).model_copy(update={"background": np.zeros(SHAPE, np.float32)})
    write_calibration(calibration, known, force=True)
    calibration.with_suffix(".npz").unlink()
    run = elsplus("process", raw, "-c", calibration, "-o", tmp_path / "out.tif")
    assert (run.code, run.err.count("\n")) == (0, 1)
    assert run.err.startswith("napari-elsplus: warning: cal.json was saved with background, which cal.npz")
    assert "UserWarning" not in run.err


@pytest.mark.parametrize("command", ["process", "compare", "mosaic", "axial"])
def test_what_is_read_is_not_overwritten_even_if_forced(
    elsplus: Cli, files: tuple[Path, Path], tmp_path: Path, command: str
) -> None:
    """Neither the recording, however it is named, nor the calibration nor the file of frames beside it."""
    raw, calibration = files
    link = tmp_path / "link.tif"
    link.symlink_to(raw)
    before = {path: path.read_bytes() for path in files}
    outputs = [raw, tmp_path / "." / "raw.tif", link, calibration, calibration.with_suffix(".npz")]
    for output in outputs:
        run = elsplus(command, raw, "-c", calibration, "-o", output, "--force")
        assert run.code == 2
        assert "is read, and would be overwritten" in run.err
        assert len(run.err.strip().splitlines()) == 1
    assert {path: path.read_bytes() for path in files} == before
