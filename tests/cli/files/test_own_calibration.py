"""Commands that need a calibration find the one beside or in the recording, print which it is, and never replace it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

import napari_elsplus as elsplus_module
from napari_elsplus.io import ImageMetadata, write_images

Cli = Callable[..., Any]
OUTPUT = {"process": "out.ome.tif", "compare": "out.png", "mosaic": "out.ome.tif"}


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("simulated") / "moving.ome.tif"
    elsplus_module.simulate_recording(frames=3).save(path)
    return path


@pytest.fixture
def raw(simulated: Path, tmp_path: Path) -> Path:
    shutil.copytree(simulated.parent, tmp_path / "recorded")
    return tmp_path / "recorded" / simulated.name


@pytest.mark.parametrize("command", OUTPUT)
def test_the_one_beside_the_recording_is_used_and_named(elsplus: Cli, raw: Path, tmp_path: Path, command: str) -> None:
    file = raw.with_name("moving.calibration.json")
    run = elsplus(command, raw, "-o", tmp_path / OUTPUT[command])
    assert run.code == 0, run.err
    assert f"calibration: {file}" in run.out.splitlines()
    named = elsplus(command, raw, "-c", file, "-o", tmp_path / f"named-{OUTPUT[command]}")
    assert named.code == 0, named.err
    assert "calibration:" not in named.out
    if command != "compare":
        one, other = (tifffile.imread(tmp_path / name) for name in (OUTPUT[command], f"named-{OUTPUT[command]}"))
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("command", OUTPUT)
def test_else_the_one_in_the_recording(elsplus: Cli, raw: Path, tmp_path: Path, command: str) -> None:
    for file in raw.parent.glob("moving.calibration.*"):
        file.unlink()
    run = elsplus(command, raw, "-o", tmp_path / OUTPUT[command])
    assert run.code == 0, run.err
    assert f"calibration: the one in {raw}" in run.out.splitlines()


@pytest.mark.parametrize("command", OUTPUT)
def test_without_any_one_line_names_the_option(elsplus: Cli, tmp_path: Path, command: str) -> None:
    tifffile.imwrite(tmp_path / "bare.tif", np.zeros((3, 60, 130), np.uint8), photometric="minisblack")
    run = elsplus(command, tmp_path / "bare.tif", "-o", tmp_path / OUTPUT[command])
    assert run.code != 0
    (line,) = run.err.strip().splitlines()
    assert "no calibration in or beside bare.tif: name one with -c" in line
    assert ("--finished" in line) == (command == "mosaic")


def test_the_one_that_was_found_is_not_overwritten(elsplus: Cli, raw: Path) -> None:
    file = raw.with_name("moving.calibration.json")
    run = elsplus("mosaic", raw, "-o", raw.with_name("m.ome.tif"), "--track", file, "--force")
    assert run.code != 0
    assert "is read, and would be overwritten" in run.err


def test_raw_frames_are_refused_as_finished_images(elsplus: Cli, raw: Path, tmp_path: Path) -> None:
    run = elsplus("mosaic", raw, "--finished", "-o", tmp_path / "m.ome.tif")
    assert run.code != 0
    (line,) = run.err.strip().splitlines()
    assert "moving.ome.tif contains raw frames" in line
    assert "leave out" in line
    with elsplus_module.open_recording(raw) as recording:
        assert recording.holds_raw_frames
        layer = ImageMetadata(settings={"mode": "raw"}, calibration=recording.calibration)
        write_images(tmp_path / "raw-layer.ome.tif", recording, layer)
        elsplus_module.section(recording, recording.calibration).save(tmp_path / "els.ome.tif")
    with elsplus_module.open_recording(tmp_path / "raw-layer.ome.tif") as saved:
        assert saved.holds_raw_frames, "as napari saves the layer"
    with elsplus_module.open_recording(tmp_path / "els.ome.tif") as images:
        assert not images.holds_raw_frames, "a calibration is kept in images, too"
        assert images.image_type == "els"
    assert elsplus("mosaic", tmp_path / "els.ome.tif", "--finished", "-o", tmp_path / "m.ome.tif").code == 0


@pytest.mark.parametrize("command", sorted(OUTPUT))
def test_finished_images_are_refused_as_raw_frames(elsplus: Cli, raw: Path, tmp_path: Path, command: str) -> None:
    """Before: the user was told to give the calibration of another camera region."""
    with elsplus_module.open_recording(raw) as recording:
        elsplus_module.section(recording, recording.calibration).save(tmp_path / "els.ome.tif")
    run = elsplus(command, tmp_path / "els.ome.tif", "-o", tmp_path / OUTPUT[command])
    assert run.code != 0
    (line,) = run.err.strip().splitlines()
    assert "els.ome.tif contains images that were made of raw frames (els): name the recording of raw frames" in line
    assert ("--finished" in line) == (command == "mosaic")
