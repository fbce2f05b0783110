"""``simulate`` writes what other commands read, with the truth beside it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
import tifffile

from napari_elsplus.errors import InputError
from napari_elsplus.io import open_recording, read_volts
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.workflows.sectioning import section
from napari_elsplus.workflows.simulated import simulate_recording

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Elsplus = Callable[..., Any]


def test_a_recording_opens_with_its_calibration_and_truth(elsplus: Elsplus, tmp_path: Path) -> None:
    path = tmp_path / "moving.ome.tif"
    run = elsplus(
        "simulate", "recording", "--preset", "240hz", "--scene", "nuclei", "--path", "straight", "--frames", 3,
        "--rate-hz", 120, "-o", path,
    )  # fmt: skip
    assert run.code == 0, run.err
    truth = json.loads((tmp_path / "moving.truth.json").read_text())
    with open_recording(path) as recording:
        assert recording.shape == (3, 524, 1328)
        known = recording.calibration
        assert known is not None
        assert known.background is not None
        els = np.array(section(recording, known, Mode.ELS)[0])
    assert known.optics is not None
    assert (
        known.optics.line_periods_per_frame
        == pytest.approx(truth["rows_per_frame"])
        == pytest.approx(1089.588, rel=1e-5)
    )
    steps = np.diff(truth["positions_mid"], axis=0) * truth["um_per_px"]
    assert np.hypot(*steps.T) == pytest.approx([2000 / 120] * 2)
    assert len(truth["positions"]) == 4
    assert els.mean() > 5


def test_same_seed_same_bytes_other_seed_others(elsplus: Elsplus, tmp_path: Path) -> None:
    frames = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        elsplus("simulate", "recording", "--frames", 1, "--seed", seed, "-o", tmp_path / f"{name}.ome.tif")
        with open_recording(tmp_path / f"{name}.ome.tif") as recording:
            frames.append(np.array(recording[0]))
    assert np.array_equal(frames[0], frames[1])
    assert not np.array_equal(frames[0], frames[2])


def test_a_calibration_set_is_what_calibrate_asks_for(elsplus: Elsplus, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    assert elsplus("simulate", "calibration", "-o", folder).code == 0
    truth = json.loads((folder / "truth.json").read_text())
    volts = read_volts(folder / "sweep_volts.csv")
    with open_recording(folder / "sweep.tif") as sweep:
        assert len(sweep) == len(volts) == 400
        k = 210
        left = sweep[k][:, : sweep.shape[2] // 2].astype(float)
    row = (volts[k] - truth["volt_0"]) / truth["volt_per_row"]
    assert left.mean(1).argmax() == pytest.approx(row, abs=3)
    again = elsplus("simulate", "calibration", "-o", folder)
    assert again.code == 2
    assert "line.tif exists" in again.err


def test_any_image_is_a_scene_and_a_csv_file_a_path(elsplus: Elsplus, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    cv2.imwrite(str(tmp_path / "tissue.png"), rng.integers(0, 255, (900, 900)).astype(np.uint8))
    (tmp_path / "path.csv").write_text("time_s,row_um,col_um\n0,0,0\n1,240,0\n")
    arguments = ("simulate", "recording", "--scene", tmp_path / "tissue.png", "--path", tmp_path / "path.csv")
    run = elsplus(*arguments, "--frames", 2, "-o", tmp_path / "r.ome.tif")
    assert run.code == 0, run.err
    truth = json.loads((tmp_path / "r.truth.json").read_text())
    assert np.diff(truth["positions"], axis=0)[:, 0] * truth["um_per_px"] == pytest.approx([1, 1])
    run = elsplus(*arguments, "--scene-um-per-px", 0.5, "--frames", 2, "-o", tmp_path / "s.ome.tif")
    assert run.code == 2
    assert "beyond the edge of the scene of 450 x 450 um" in run.err


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("recording", "--scene", "moon"), "no scene 'moon'"),
        (("recording", "--scene", "absent.png"), "absent.png is no image"),
        (("recording", "--scene", "plate:far"), "depth is 'far'"),
        (("recording", "--path", "orbit"), "no path 'orbit'"),
        (("recording", "--path", "absent.csv"), "no file absent.csv"),
        (("recording", "--speed-um-s", "nan"), "--speed-um-s is nan"),
        (("recording", "--slit-um", "inf"), "--slit-um is inf: give a positive"),
        (("recording", "--slit-um", "-1"), "--slit-um is -1.0: give a positive"),
        (("recording", "--scene", "uniform", "--scene-um-per-px", 2), "the scene uniform has no pixels"),
        (("recording", "--rate-hz", 500), "500.0 frames per second"),
        (("recording", "--rate-hz", 1e-9), "asked of the 240hz preset: give at most 240, more than 0.00013"),
        (("recording", "--frames", 99999999999), "out.ome.tif: 69587200.0 GB do not fit into the"),
        (("recording", "--offset-um", 900), "offset is 900.0 um, beyond the bundle"),
        (("recording", "--offset-um", -300), "do not fit a frame of 524 x 1328"),
        (
            ("recording", "--imperfect", "galvo=800"),
            "no imperfection is called 'galvo': the imperfections are galvo-re",
        ),
        (("axial", "--imperfect", "row-noise=300"), "row-noise is 300, outside of 0 to 20 grey levels"),
        (("axial", "--slit-um", 700), "slit is 700.4 um wide"),
        (("axial", "--offset-um", "nan"), "--offset-um is nan"),
    ],
)
def test_impossible_wishes_end_in_one_line_and_leave_nothing(
    elsplus: Elsplus, tmp_path: Path, arguments: tuple[object, ...], word: str
) -> None:
    run = elsplus("simulate", *arguments, "-o", tmp_path / "out.ome.tif")
    assert run.code == 2
    assert word in run.err
    assert len(run.err.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_plate_may_lie_at_a_broken_number_of_micrometres(elsplus: Elsplus, tmp_path: Path) -> None:
    run = elsplus("simulate", "recording", "--scene", "plate:50.5", "--frames", 1, "-o", tmp_path / "r.ome.tif")
    assert run.code == 0, run.err


@pytest.mark.parametrize("seed", [-1, 1 << 80])
def test_a_seed_that_is_none_is_told_as_a_wrong_option(elsplus: Elsplus, tmp_path: Path, seed: int) -> None:
    run = elsplus("simulate", "axial", "--seed", seed, "-o", tmp_path / "out.ome.tif")
    assert run.code == 2
    assert "--seed" in run.err


def test_an_existing_file_is_not_replaced_unasked(elsplus: Elsplus, tmp_path: Path) -> None:
    truth = tmp_path / "r.truth.json"
    truth.write_text("mine")
    run = elsplus("simulate", "recording", "--frames", 1, "-o", tmp_path / "r.ome.tif")
    assert run.code == 2
    assert "r.truth.json exists" in run.err
    assert [path.name for path in tmp_path.iterdir()] == ["r.truth.json"]
    assert elsplus("simulate", "recording", "--frames", 1, "--force", "-o", tmp_path / "r.ome.tif").code == 0
    assert truth.read_text() != "mine"


@pytest.mark.parametrize(
    ("kind", "arguments"), [("recording", ("--frames", 2)), ("axial", ("--slit-um", 3.0))], ids=["recording", "axial"]
)
def test_the_suffix_names_the_format(
    elsplus: Elsplus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, arguments: tuple[object, ...]
) -> None:
    monkeypatch.setattr("napari_elsplus.workflows.simulated.scan_depths_um", lambda: np.array([0.0, 10.0, 90.0]))
    for name in ("a.ome.tif", "b.ome.zarr"):
        run = elsplus("simulate", kind, *arguments, "-o", tmp_path / name)
        assert run.code == 0, run.err
    with open_recording(tmp_path / "a.ome.tif") as one, open_recording(tmp_path / "b.ome.zarr") as other:
        np.testing.assert_array_equal(one[:], other[:])
        assert other.calibration.bundle == one.calibration.bundle
        assert other.metadata["axes"] == ("zyx" if kind == "axial" else "tyx")
    with tifffile.TiffFile(tmp_path / "a.ome.tif") as file:
        assert file.series[0].axes == ("ZYX" if kind == "axial" else "TYX")


@pytest.mark.parametrize("kind", ["recording", "axial"])
@pytest.mark.parametrize("name", ["r.npy", "r.avi", "r.png", "r"])
def test_a_suffix_that_no_format_writes_is_refused_before_the_work(
    elsplus: Elsplus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, name: str
) -> None:
    monkeypatch.setattr("napari_elsplus.simulation.rendering.renderer.Renderer.__init__", None)
    monkeypatch.setattr("napari_elsplus.workflows.simulated.axial_scan", None)
    run = elsplus("simulate", kind, "-o", tmp_path / name)
    assert (run.code, run.err.count("\n")) == (2, 1)
    assert f"{name} has a suffix that cannot be written" in run.err
    assert not list(tmp_path.iterdir())


def test_a_scene_or_a_path_that_is_read_is_not_overwritten(elsplus: Elsplus, tmp_path: Path) -> None:
    scene = tmp_path / "tissue.tif"
    cv2.imwrite(str(scene), np.random.default_rng(0).integers(0, 255, (900, 900)).astype(np.uint8))
    before = scene.read_bytes()
    run = elsplus("simulate", "recording", "--scene", scene, "--frames", 1, "-o", scene, "--force")
    assert run.code == 2
    assert "is read, and would be overwritten" in run.err
    assert scene.read_bytes() == before


@pytest.mark.parametrize("frames", [0, 99999999999])
def test_a_number_of_frames_that_cannot_be_read_is_refused(frames: int) -> None:
    with pytest.raises(InputError, match=f"a recording of {frames} frames: give 1 to 10000000"):
        simulate_recording(frames=frames)
