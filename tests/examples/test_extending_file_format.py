"""The example of a file format of one's own, run from outside the package."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.io import calibration_beside, open_recording, write_calibration
from napari_elsplus.io.formats import registry
from napari_elsplus.viewing.layers import open_layers
from pairs import calibration, frames

pytestmark = pytest.mark.checkout

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "extending" / "file_format.py"


def write_raw(folder):
    path = folder / "scan.bin"
    path.write_bytes(frames().tobytes())
    rows, cols = frames().shape[1:]
    path.with_suffix(".hdr").write_text(f"rows = {rows}\ncols = {cols}\nframe_rate_hz = 240\num_per_px = 2\n")
    return path


@pytest.fixture
def registered(monkeypatch):
    monkeypatch.setattr(registry, "_registered", dict(registry._registered))
    spec = importlib.util.spec_from_file_location("example_file_format", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_it_runs_as_a_script(tmp_path):
    command = [sys.executable, str(EXAMPLE), str(write_raw(tmp_path))]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    count, rows, cols = frames().shape
    assert f"<Recording scan.bin: {count} frames of {rows} x {cols}, uint8>" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [((), "usage: python file_format.py NAME.bin"), (("absent.bin",), "there is no file absent.bin")],
)
def test_as_a_script_it_states_in_one_line_what_is_missing(tmp_path, arguments, words):
    command = [sys.executable, str(EXAMPLE), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert words in line


@pytest.mark.usefixtures("registered")
def test_recordings_help_dialogs_and_names_beside_use_it(tmp_path):
    path = write_raw(tmp_path)
    written = write_calibration(tmp_path / "scan.calibration.json", calibration())
    assert calibration_beside(path) == written
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording[:], frames())
        np.testing.assert_allclose(np.diff(recording.times_s), 1 / 240)
        assert recording.metadata["um_per_px"] == 2.0
    assert "raw binary (.bin)" in registry.supported_recordings()
    assert "*.bin" in registry.recordings_filter()
    assert len(open_layers(path).layers) == 5


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize(
    ("header", "size", "message"),
    [
        ("rows = 4\ncols = 5\n", 39, "1 frames and 19 bytes"),
        ("rows = x\ncols = 5\n", 40, "line 1"),
        ("rows = 4\n", 40, "rows and cols"),
        (None, 40, "there is no file"),
        ("rows = 1e30\ncols = 1e30\n", 40, "0 frames"),
    ],
)
def test_a_damaged_recording_is_refused_in_one_line(tmp_path, header, size, message):
    (tmp_path / "a.bin").write_bytes(bytes(size))
    if header is not None:
        (tmp_path / "a.hdr").write_text(header)
    with pytest.raises(InputError, match=message) as caught:
        open_recording(tmp_path / "a.bin")
    assert "\n" not in str(caught.value)
