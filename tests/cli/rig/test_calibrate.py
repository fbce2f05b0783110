"""``calibrate`` on a recording with known truth, and on everything that a user may get wrong."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import tifffile

from napari_elsplus.acquisition.calibrating import live
from napari_elsplus.acquisition.calibrating.simulated import QUICK_VOLTAGES
from napari_elsplus.io import read_calibration, write_column
from napari_elsplus.processing.calibration.steps import calibration_steps
from napari_elsplus.simulation.accuracy import calibration_errors
from napari_elsplus.simulation.model.instrument import Instrument

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Elsplus = Callable[..., Any]


def all_inputs(folder: Path) -> list[object]:
    return [
        *("--line", folder / "line.tif", "--sweep", folder / "sweep.tif", "--volts", folder / "sweep_volts.csv"),
        *("--bundle", folder / "transmission.tif", "--background", folder / "background.tif", "--bundle-um", 620),
    ]


def test_a_whole_calibration_is_true(elsplus: Elsplus, open_recording: Path, tmp_path: Path) -> None:
    ran = elsplus("calibrate", *all_inputs(open_recording), "-o", tmp_path / "cal.json")
    assert ran.code == 0, ran.err
    truth = json.loads((open_recording / "truth.json").read_text())
    found = read_calibration(tmp_path / "cal.json")
    assert found.bundle is not None
    assert found.offset is not None
    assert found.galvo is not None
    assert found.optics is not None
    assert np.hypot(*np.subtract(found.bundle.confocal_centre, truth["left"])) < 0.15
    assert np.hypot(*np.subtract(found.bundle.residual_centre, truth["right"])) < 0.15
    assert found.bundle.diameter_px == pytest.approx(truth["diameter_px"] + 2, rel=0.005)
    assert np.allclose(np.array(found.bundle.residual_to_confocal) @ (*truth["right"], 1), truth["left"], atol=0.05)
    assert found.bundle.residual_gain == pytest.approx(1, abs=0.005)
    assert found.offset.rows == pytest.approx(truth["offset_rows"], abs=0.03)
    assert found.galvo.volts_per_row == pytest.approx(truth["volt_per_row"], rel=5e-4)
    assert found.galvo.row(truth["volt_0"]) == pytest.approx(0, abs=0.1)
    assert found.galvo.r_squared > 0.9999
    assert found.optics.um_per_px == pytest.approx(truth["um_per_px"], rel=0.01)
    assert found.background is not None
    assert found.flat is not None
    assert found.flat.shape[0] == found.flat.shape[1]
    assert "+-" in ran.out


def test_the_report_is_written_beside_the_calibration(elsplus: Elsplus, open_recording: Path, tmp_path: Path) -> None:
    line = ("calibrate", "--line", open_recording / "line.tif", "-o", tmp_path / "cal.json", "--report")
    assert elsplus(*line, tmp_path / "cal.txt").code == 2
    assert not list(tmp_path.iterdir())
    ran = elsplus(*line, tmp_path / "cal.pdf")
    assert ran.code == 0, ran.err
    assert "cal.pdf: 2 pages" in ran.out
    assert (tmp_path / "cal.pdf").read_bytes().startswith(b"%PDF")
    assert elsplus(*line, tmp_path / "cal.pdf").code == 2


def test_a_sweep_without_its_voltages_given_takes_the_table_beside_it(
    elsplus: Elsplus, open_recording: Path, tmp_path: Path
) -> None:
    ran = elsplus("calibrate", "--sweep", open_recording / "sweep.tif", "-o", tmp_path / "cal.json")
    assert ran.code == 0, ran.err
    galvo = read_calibration(tmp_path / "cal.json").galvo
    assert galvo is not None
    assert galvo.r_squared > 0.999


def test_the_parked_line_clears_the_bundle(elsplus: Elsplus, open_recording: Path, tmp_path: Path) -> None:
    assert elsplus("calibrate", *all_inputs(open_recording), "-o", tmp_path / "cal.json").code == 0
    found = read_calibration(tmp_path / "cal.json")
    assert found.bundle is not None
    assert found.galvo is not None
    assert found.optics is not None
    row = found.galvo.row(found.galvo.park_v)
    away_px = abs(row - found.bundle.confocal_centre[0]) - found.bundle.diameter_px / 2
    assert away_px * found.optics.um_per_px >= 100


def test_an_existing_file_is_refused_before_work(elsplus: Elsplus, open_recording: Path, tmp_path: Path) -> None:
    target = tmp_path / "cal.json"
    target.write_text("mine")
    ran = elsplus("calibrate", "--line", open_recording / "line.tif", "-o", target)
    assert ran.code == 2
    assert "--force" in ran.err
    assert target.read_text() == "mine"
    assert elsplus("calibrate", "--line", open_recording / "line.tif", "-o", target, "--force").code == 0
    assert read_calibration(target).offset is not None


@pytest.fixture
def bad(tmp_path: Path, open_recording: Path) -> Path:
    """Files that no calibration can be made of."""
    folder = tmp_path / "bad"
    folder.mkdir()
    whole = tifffile.imread(open_recording / "transmission.tif").reshape(300, 600)
    one = whole.copy()
    one[:, 300:] = one[:, 295:300].mean()
    tifffile.imwrite(folder / "one.tif", one)
    tifffile.imwrite(folder / "black.tif", np.zeros((4, 300, 600), np.uint8), photometric="minisblack")
    tifffile.imwrite(folder / "white.tif", np.full((4, 300, 600), 255, np.uint8), photometric="minisblack")
    tifffile.imwrite(folder / "small.tif", np.zeros((4, 40, 60), np.uint8), photometric="minisblack")
    tifffile.imwrite(folder / "rgb.tif", np.zeros((3, 40, 60, 3), np.uint8), photometric="rgb")
    tifffile.imwrite(folder / "nan.tif", np.full((4, 300, 600), np.nan, np.float32), photometric="minisblack")
    (folder / "empty.tif").write_bytes(b"")
    (folder / "text.csv").write_text("volts\n0.1\nmuch\n")
    write_column(folder / "three.csv", "volts", [1.0, 2.0, 3.0])
    write_column(folder / "four.csv", "volts", [1.0, 2.0, 3.0, 4.0])
    return folder


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ("--bundle one.tif", "two bundle images expected, 1 found (threshold"),
        ("--bundle black.tif", "all pixels are 0"),
        ("--bundle white.tif", "100 % of the image of the bundle is saturated"),
        ("--line black.tif", "confocal view: no laser line"),
        ("--line white.tif", "saturated"),
        ("--line nan.tif", "NaN"),
        ("--line rgb.tif", "rgb.tif"),
        ("--line empty.tif", "empty.tif"),
        ("--line absent.tif", "absent.tif"),
        ("--sweep black.tif --volts four.csv", "a line is visible in 0 of 4 frames"),
        ("--sweep black.tif --volts three.csv", "3 voltages for 4 frames"),
        ("--sweep black.tif --volts text.csv", "much"),
        ("--sweep black.tif", "without voltages"),
        ("--volts four.csv", "nothing to measure"),
        ("--line black.tif --background small.tif", "line has 300 x 600 pixels, background 40 x 60"),
        ("--line black.tif --bundle-um 620", "--um-per-px"),
        ("--line black.tif --flat black.tif", "--bundle"),
        ("", "nothing to measure"),
        ("--rig nowhere", "nowhere"),
        ("--rig simulated --line one.tif", "both --rig and --line"),
        ("--rig simulated --um-per-px 1.3", "--um-per-px 1.3 with --rig"),
        ("--rig simulated --line-period-s 1e-5", "line-period-s"),
        ("--rig simulated --rows-per-frame 600", "rows-per-frame"),
        ("--rig simulated --volts four.csv", "volts"),
        ("--line one.tif --preset 120hz", "--preset"),
        ("--line one.tif --rate-hz 60", "--rate-hz"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(elsplus: Elsplus, bad: Path, arguments: str, word: str) -> None:
    given = [bad / part if part.endswith((".tif", ".csv")) else part for part in arguments.split()]
    before = sorted(bad.iterdir())
    ran = elsplus("calibrate", *given, "-o", bad / "out.json")
    assert ran.code == 2
    assert word in ran.err
    assert len(ran.err.splitlines()) == 1
    assert sorted(bad.iterdir()) == before


@pytest.mark.parametrize("left_out", ["lag", pytest.param("", marks=pytest.mark.slow)])
def test_the_simulated_rig_is_calibrated_live(
    elsplus: Elsplus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, left_out: str
) -> None:
    """All steps and voltages are those of ../../acquisition/calibrating/test_live.py, which compares with the truth."""
    steps = [step for step in calibration_steps(first=live.MEASURED_FIRST) if step.key != left_out]
    monkeypatch.setattr(live, "calibration_steps", lambda first: steps)
    voltages = 24 if left_out else QUICK_VOLTAGES  # the camera is no faster than a real one
    monkeypatch.setattr(live, "SWEEP_VOLTAGES", voltages)
    out = tmp_path / "live.json"
    run = elsplus("calibrate", "--rig", "simulated", "-o", out)
    assert run.code == 0, run.err
    assert ("scan lag" in run.out) != bool(left_out)
    calibration = read_calibration(out)
    calibration.require("frame", "acquired_with", "offset", "galvo", "bundle", "optics", "quality")
    errors = calibration_errors(calibration, Instrument.of("240hz"))
    assert abs(errors.offset_rows) < 0.05
    assert abs(errors.galvo_slope_percent) < 0.1
    assert calibration.background is not None


@pytest.mark.slow
def test_the_bundles_diameter_is_that_which_is_given_for_the_simulated_rig(
    elsplus: Elsplus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before: it was ignored, and all micrometres were those of another bundle."""
    monkeypatch.setattr("napari_elsplus.acquisition.calibrating.live.SWEEP_VOLTAGES", 24)
    ran = elsplus("calibrate", "--rig", "simulated", "--bundle-um", 240, "-o", tmp_path / "cal.json")
    assert ran.code == 0, ran.err
    found = read_calibration(tmp_path / "cal.json")
    assert found.um_per_px == pytest.approx(240 / found.measured_bundle.diameter_px)


def test_what_is_read_is_not_overwritten_even_if_forced(elsplus: Elsplus, tmp_path: Path) -> None:
    frames = tmp_path / "bundle.json"
    frames.write_bytes(b"II*\x00 frames under an odd name")
    run = elsplus("calibrate", "--bundle", frames, "-o", frames, "--force")
    assert run.code == 2
    assert "bundle.json is read, and would be overwritten" in run.err
    assert frames.read_bytes().startswith(b"II")
