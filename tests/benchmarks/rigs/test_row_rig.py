"""Twins of an independent rig: what the disturbances of a rough one cost calibration and ELS+."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from benchmarks.rigs.row_rig import ROUGH, RowRecording, RowRig
from napari_elsplus.cli.files.process import command as process
from napari_elsplus.cli.rig.calibrate import command as calibrate
from napari_elsplus.processing.calibration.measurements import measure_pair
from napari_elsplus.processing.calibration.slit_offset import measure_offset
from tests.commands import runner

SMALL = RowRig(shape=(120, 240), left=(60.0, 59.0), right=(53.0, 180.5), diameter=106.0, seed=31)


@pytest.mark.parametrize("bow", [0.0, 2.2])
def test_the_slit_offset_of_an_independent_rig_is_measured(bow: float) -> None:
    recording = RowRecording(RowRig(**{**vars(SMALL), "bow": bow}))
    frames = [recording.expose(recording.standing(60.4)) for _ in range(5)]
    found = measure_offset(frames)
    assert found.rows == pytest.approx(-7.0, abs=0.03)
    assert 106**2 / 4 * found.confocal.bend == pytest.approx(bow, abs=0.15)


@pytest.mark.parametrize("turn", [0.5, -5.0])
def test_views_of_an_independent_rig_are_aligned_however_they_are_rotated(turn: float) -> None:
    rig = RowRig(**{**vars(SMALL), "bundle_um": 250.0, "right_turn": turn})
    recording = RowRecording(rig)
    alignment = measure_pair(recording.expose(recording.lit())[None]).alignment
    assert alignment.residual_to_confocal[:, :2] == pytest.approx(rig.right_to_bundle, abs=4e-4)
    at_centre = alignment.residual_to_confocal @ (*rig.right, 1)
    assert at_centre == pytest.approx(rig.left, abs=0.02)
    assert alignment.uncertainty_px < 0.02


def correlation(folder: Path, els: np.ndarray) -> float:
    """Return the correlation of an ELS+ image with the focal plane, both smoothed, in the 90 % disc."""
    truth = json.loads((folder / "truth.json").read_text())
    side = els.shape[0]
    focal = np.asarray(tifffile.imread(folder / "still_infocus.tif"), np.float32)
    focal = cv2.getRectSubPix(focal, (side, side), tuple(reversed(truth["left"])))
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    disc = np.hypot(y, x) < 0.45 * truth["diameter_px"]
    first, second = (cv2.GaussianBlur(image, (0, 0), 1.5)[disc] for image in (els, focal))
    return float(np.corrcoef(first, second)[0, 1])


@pytest.mark.slow
@pytest.mark.parametrize(
    "rig",
    [
        RowRig(frames=0, seed=101),
        RowRig(
            frames=0, seed=102, shape=(320, 640), left=(158, 160), right=(170, 478), diameter=280, volt_per_row=-0.0011
        ),
        RowRig(frames=0, seed=103, scene="vessels", right=(161, 451), right_turn=0.5, gain=0.95, signal=55),
    ],
    ids=["seed 101", "falling volts, seed 102", "rotated and dim, seed 103"],
)
def test_els_of_a_rough_rig_is_that_of_the_clean_one(
    rig: RowRig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Bow, distortion, hot pixels, row noise, flicker and uneven light cost less than 0.01 of the correlation."""
    found = []
    for name, disturbances in (("clean", {}), ("rough", ROUGH)):
        folder = tmp_path / name
        RowRecording(RowRig(**{**vars(rig), **disturbances})).write(folder)
        files = {"line": "line.tif", "sweep": "sweep.tif", "volts": "sweep_volts.csv", "bundle": "transmission.tif"}
        inputs = [part for option, file in files.items() for part in (f"--{option}", folder / file)]
        inputs += ["--background", folder / "background.tif", "--bundle-um", 620, "--rows-per-frame", rig.shape[0]]
        assert runner(calibrate, "calibrate", capsys)(*inputs, "-o", folder / "cal.json").code == 0
        run = runner(process, "process", capsys)
        arguments = (folder / "still.tif", "-c", folder / "cal.json", "--mode", "els", "-o", folder / "els.tif")
        assert run(*arguments).code == 0
        found.append(correlation(folder, tifffile.imread(folder / "els.tif").mean(axis=0)))
        calibration = json.loads((folder / "cal.json").read_text())
        truth = json.loads((folder / "truth.json").read_text())
        rows = (calibration["galvo"]["volts_at_row_zero"] - truth["volt_0"]) / truth["volt_per_row"]
        assert abs(rows) < 0.02
        assert abs(calibration["offset"]["rows"] - truth["offset_rows"]) < 0.03
        assert abs(calibration["bundle"]["residual_gain"] / truth["gain"] - 1) < 0.003
    clean, rough = found
    assert clean > 0.97
    assert rough > clean - 0.01
