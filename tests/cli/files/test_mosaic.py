from __future__ import annotations

import re
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import tifffile

from napari_elsplus.io import read_track, write_calibration
from recordings import fibres, record, smooth_path

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """A folder with a recording of a fast probe and its calibration, and their truth."""
    folder = tmp_path_factory.mktemp("recording")
    truth = record(fibres(1000, 200, 1), smooth_path(16, 25.0, 1000, 1))
    tifffile.imwrite(folder / "moving.tif", truth.frames)
    write_calibration(folder / "cal.json", truth.calibration)
    return folder, truth


def test_mosaic_and_track_of_a_fast_probe(
    elsplus: Callable[..., Any], recording: tuple[Path, Any], tmp_path: Path
) -> None:
    folder, truth = recording
    out, track = tmp_path / "mosaic.tif", tmp_path / "track.csv"
    run = elsplus("mosaic", folder / "moving.tif", "-c", folder / "cal.json", "-o", out, "--track", track)
    assert run.code == 0, run.err
    rows = read_track(track)
    assert [row.frame for row in rows] == list(range(16))
    assert {row.state for row in rows} == {"tracked"}
    found = np.array([(row.row_px, row.col_px) for row in rows])
    assert np.abs(found - (truth.positions - truth.positions[0])).max() < 0.5
    covered = tifffile.imread(out) != 0
    assert covered.sum() > 1.5 * np.pi / 4 * (0.9 * 212) ** 2


def test_an_output_that_exists_is_kept(
    elsplus: Callable[..., Any], recording: tuple[Path, Any], tmp_path: Path
) -> None:
    folder, _ = recording
    out = tmp_path / "mosaic.tif"
    out.write_text("mine")
    run = elsplus("mosaic", folder / "moving.tif", "-c", folder / "cal.json", "-o", out)
    assert (run.code, out.read_text()) == (2, "mine")
    assert len(run.err.strip().splitlines()) == 1


def test_the_papers_method_can_be_asked_for(
    elsplus: Callable[..., Any], recording: tuple[Path, Any], tmp_path: Path
) -> None:
    folder, _ = recording
    track = tmp_path / "track.csv"
    paper = (
        "mosaic",
        folder / "moving.tif",
        "-c",
        folder / "cal.json",
        "--method",
        "paper",
        "-o",
        tmp_path / "m.tif",
        "--track",
        track,
    )
    assert elsplus(*paper).code == 0
    whole_pixels = np.array([(row.row_px, row.col_px) for row in read_track(track)]) / (214 / 250)
    np.testing.assert_allclose(whole_pixels, np.round(whole_pixels), atol=1e-6)


def test_rows_per_frame_are_estimated_where_they_are_unknown(
    elsplus: Callable[..., Any], recording: tuple[Path, Any], tmp_path: Path
) -> None:
    folder, truth = recording
    write_calibration(tmp_path / "cal.json", truth.calibration.model_copy(update={"optics": None}))
    track = tmp_path / "track.csv"
    run = elsplus(
        "mosaic", folder / "moving.tif", "-c", tmp_path / "cal.json", "-o", tmp_path / "m.tif", "--track", track
    )
    assert run.code == 0, run.err
    assert "rows per frame estimated from the motion: 2" in run.out
    found = np.array([(row.row_px, row.col_px) for row in read_track(track)])
    assert np.abs(found - (truth.positions - truth.positions[0])).max() < 0.5
    assert all(np.isnan(row.row_um) for row in read_track(track))


def test_frames_that_show_nothing_are_said_to_fit_nowhere(
    elsplus: Callable[..., Any], recording: tuple[Path, Any], tmp_path: Path
) -> None:
    folder, _ = recording
    shape = tifffile.imread(folder / "moving.tif", key=0).shape
    np.save(tmp_path / "dark.npy", np.zeros((3, *shape), np.uint8))
    run = elsplus("mosaic", tmp_path / "dark.npy", "-c", folder / "cal.json", "-o", tmp_path / "m.tif")
    assert run.code == 0, run.err
    assert "note: no two frames fit together" in run.out


@pytest.fixture
def finished(tmp_path: Path) -> tuple[Path, np.ndarray]:
    """A stack of finished images that are not square, with a repeated frame, and their positions."""
    scene = np.clip(60 + 20 * fibres(700, 300, 2), 0, 255)
    places = np.array([(90 + 6 * k, 120 + 9 * k) for k in (0, 1, 2, 2, 3, 4, 5, 6)])
    y, x = np.mgrid[:200, :240]
    disc = np.hypot(y - 99.5, x - 119.5) < 99
    images = [np.where(disc, scene[row : row + 200, col : col + 240], 0) for row, col in places]
    tifffile.imwrite(tmp_path / "finished.tif", np.array(images, np.uint8))
    return tmp_path / "finished.tif", places - places[0]


def test_finished_images_need_no_calibration_and_keep_their_resolution(
    elsplus: Callable[..., Any], finished: tuple[Path, np.ndarray], tmp_path: Path
) -> None:
    stack, positions = finished
    out, track = tmp_path / "mosaic.tif", tmp_path / "track.csv"
    run = elsplus("mosaic", stack, "--finished", "-o", out, "--track", track)
    assert run.code == 0, run.err
    rows = read_track(track)
    assert [row.frame for row in rows] == list(range(8))
    assert {(row.state, row.segment) for row in rows} == {("tracked", 0)}
    np.testing.assert_allclose([(row.row_px, row.col_px) for row in rows], positions, atol=0.25)
    assert (rows[2].row_px, rows[2].col_px) == (rows[3].row_px, rows[3].col_px)
    assert all(np.isnan(row.row_um) and np.isnan(row.col_um) for row in rows)
    covered = np.argwhere(tifffile.imread(out) > 0)
    assert np.ptp(covered, axis=0) == pytest.approx(192 + np.ptp(positions, axis=0), abs=5)


@pytest.mark.parametrize("given", [("-c", "cal.json"), ("--mode", "ls")])
def test_finished_images_exclude_a_calibration_and_a_mode(
    elsplus: Callable[..., Any], finished: tuple[Path, np.ndarray], tmp_path: Path, given: tuple[str, str]
) -> None:
    run = elsplus("mosaic", finished[0], "--finished", *given, "-o", tmp_path / "m.tif")
    assert run.code == 2
    assert len(run.err.strip().splitlines()) == 1
    assert f"--finished excludes {given[0]}" in run.err


def test_a_real_video_of_soft_tissue(elsplus: Callable[..., Any], data_folder: Path, tmp_path: Path) -> None:
    video, judge = data_folder / "real-pcle" / "video.tif", data_folder.parent / "tools" / "real_video.py"
    if not (video.is_file() and judge.is_file()):
        pytest.skip("the real video or its judge is absent")
    track = tmp_path / "track.csv"
    assert elsplus("mosaic", video, "--finished", "-o", tmp_path / "m.tif", "--track", track).code == 0
    judged = subprocess.run(
        [sys.executable, str(judge), str(video), str(track)], capture_output=True, text=True, check=False, timeout=600
    )
    visible, _, linked, wrong, unseen, segments = (int(n) for n in re.findall(r"(?<!within )\b\d+\b", judged.stdout))
    assert (wrong, visible) == (0, 44)
    assert linked >= 40
    assert unseen <= 4
    assert segments <= 3
