"""Bad input to mosaics by cores, recommendations and batches is one line that says what to do, and exit code 2."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import tifffile

from napari_elsplus.io import write_calibration
from napari_elsplus.processing.images.sectioning import Sectioner
from napari_elsplus.simulation.calibration_scenes import line_volts, standing_line
from napari_elsplus.simulation.model.bundle import Bundle
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.truth import true_calibration
from napari_elsplus.workflows.calibration import calibrate

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from commands import Run

INSTRUMENT = replace(Instrument.of("240hz"), bundle=Bundle(diameter_um=200.0))


@pytest.fixture(scope="module")
def stacks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Images of a bundle whose probe does not move, six of them and two of them."""
    folder = tmp_path_factory.mktemp("stacks")
    renderer = Renderer(INSTRUMENT, scene("fibres", 3))
    sectioner = Sectioner(true_calibration(INSTRUMENT), INSTRUMENT.frame_shape)
    images = np.stack([sectioner.ls(renderer.render(k)) for k in range(6)])
    tifffile.imwrite(folder / "still.tif", images)
    tifffile.imwrite(folder / "two.tif", images[:2])
    return folder


@pytest.mark.parametrize(
    ("stack", "problem"),
    [("still.tif", "needs 1.2 px of motion: move the probe"), ("two.tif", "insertion by cores needs 3, 1.2 px apart")],
)
def test_too_few_or_unmoving_frames(
    elsplus: Callable[..., Run], stacks: Path, tmp_path: Path, stack: str, problem: str
) -> None:
    ended = elsplus("mosaic", stacks / stack, "--finished", "--insertion", "cores", "-o", tmp_path / "out.tif")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert problem in ended.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("plate", "problem"),
    [
        ("no json", "is no JSON file: name the one that `axial` wrote"),
        ("[" * 100_000, "is no JSON file: name the one that `axial` wrote"),
        (json.dumps([1, 2]), "has no depths: name the JSON that `axial` wrote"),
        (json.dumps({"profiles": {"ls": [1.0, 0.5]}}), "no depths or no LS profile"),
        (json.dumps({"depth_um": [0, 9], "profiles": {"ls": [1.0, 0.5]}}), "at 2 depths up to 300 um: 5 are needed"),
        (json.dumps({"depth_um": [0, 9, 20], "profiles": {"ls": [1.0]}}), "no depths or no LS profile at them"),
    ],
)
def test_a_plate_without_depths(elsplus: Callable[..., Run], tmp_path: Path, plate: str, problem: str) -> None:
    instrument = Instrument.of("240hz")
    line = calibrate(line=list(standing_line(instrument, line_volts(instrument))))
    known = true_calibration(instrument).model_copy(update={"offset": line.calibration.offset})
    write_calibration(tmp_path / "cal.json", known)
    (tmp_path / "plate.json").write_text(plate)
    ended = elsplus("recommend", "--depth-um", 60, "-c", tmp_path / "cal.json", "--plate", tmp_path / "plate.json")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert problem in ended.err


@pytest.mark.parametrize(
    ("arguments", "ending"),
    [
        ("process RAW -c CAL -o a.txt", ".ome.tif"),
        ("mosaic RAW -c CAL -o a.txt", ".ome.tif"),
        ("mosaic RAW -c CAL -o m.tif --track a.txt", ".csv"),
        ("compare RAW -c CAL -o a.txt", ".png"),
        ("axial RAW -c CAL -o a.txt", ".json"),
        ("axial RAW -c CAL -o o.json --plot a.txt", ".png"),
        ("recommend --depth-um 100 -c CAL -o a.txt", ".json"),
        ("calibrate --line RAW -o a.txt", ".json"),
        ("calibrate --line RAW -o o.json --report a.txt", ".pdf"),
        ("simulate recording --frames 1 -o a.txt", ".ome.tif"),
        ("acquire --seconds 1 --report a.txt", ".json"),
        ("acquire --seconds 1 --report o.json --track a.txt", ".csv"),
        ("acquire --seconds 1 --report o.json --mosaic a.txt", ".ome.tif"),
        ("rehearse --report a.txt", ".json"),
    ],
)
def test_no_command_writes_a_file_under_a_suffix_of_another_kind(
    elsplus: Callable[..., Run], stacks: Path, tmp_path: Path, arguments: str, ending: str
) -> None:
    places = {"RAW": stacks / "still.tif", "CAL": stacks / "known.json"}
    given = [places.get(word, tmp_path / word if "." in word else word) for word in arguments.split()]
    ended = elsplus(*given)
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "a.txt has a suffix that cannot be written: let it end in " in ended.err
    assert ending in ended.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("here", [".", "/"])
def test_a_folder_where_a_calibration_is_meant(
    elsplus: Callable[..., Run], stacks: Path, tmp_path: Path, here: str
) -> None:
    raw, out = stacks / "still.tif", tmp_path / "out.tif"
    for command in (
        ("process", raw, "-c", here, "-o", out),
        ("mosaic", raw, "-c", here, "-o", out),
        ("compare", raw, "-c", here, "-o", tmp_path / "out.png"),
        ("calibrate", "--line", raw, "-o", here),
    ):
        ended = elsplus(*command)
        assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert list(tmp_path.iterdir()) == []


def test_an_output_folder_that_holds_what_is_read(elsplus: Callable[..., Run], stacks: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.zarr"
    output.mkdir()
    write_calibration(output / "cal.json", true_calibration(INSTRUMENT))
    held = {file: file.read_bytes() for file in output.iterdir()}
    ended = elsplus("process", stacks / "still.tif", "-c", output / "cal.json", "-o", output, "--force")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "out.zarr holds cal.json, which is read" in ended.err
    assert {file: file.read_bytes() for file in output.iterdir()} == held


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows")
@pytest.mark.parametrize(
    ("command", "output"),
    [
        ("process -c loop.tif", "out.tif"),
        ("mosaic -c loop.tif", "out.tif"),
        ("compare -c loop.tif", "out.png"),
        ("axial", "out.json"),
        ("calibrate --line", "out.json"),
        ("recommend --depth-um 30 -c", "out.json"),
    ],
)
def test_a_link_that_leads_to_itself_is_said_in_one_line(
    elsplus: Callable[..., Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, output: str
) -> None:
    """Before: a traceback."""
    loop = tmp_path / "loop.tif"
    loop.symlink_to(loop)
    monkeypatch.chdir(tmp_path)
    run = elsplus(*command.split(), loop, "-o", output)
    assert (run.code, run.err.count("\n"), "loop.tif" in run.err) == (2, 1, True)


@pytest.mark.parametrize(
    ("command", "output"), [("process", "o.tif"), ("mosaic", "o.tif"), ("compare", "o.png"), ("axial", "o.json")]
)
def test_frames_of_another_camera_region(
    elsplus: Callable[..., Run], tmp_path: Path, command: str, output: str
) -> None:
    """Before: `compare` and `axial` preceded the error by numpy's warnings of empty means."""
    write_calibration(tmp_path / "cal.json", true_calibration(Instrument.of("240hz")))
    np.save(tmp_path / "small.npy", np.full((4, 50, 50), 9, np.uint8))
    (tmp_path / "small.depths.csv").write_text("depth_um\n0\n10\n20\n30\n")
    ended = elsplus(command, tmp_path / "small.npy", "-c", tmp_path / "cal.json", "-o", tmp_path / output)
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "has 524 x 1328 pixels, the recording 50 x 50: use the calibration" in ended.err
    assert not (tmp_path / output).exists()


def test_a_comparison_of_frames_without_light(elsplus: Callable[..., Run], tmp_path: Path) -> None:
    """Before: a picture of nothing, and a background of -3,615,071 times white."""
    known = true_calibration(INSTRUMENT)
    background = np.full(INSTRUMENT.frame_shape, 4, np.float32)
    write_calibration(tmp_path / "cal.json", known.model_copy(update={"background": background}))
    np.save(tmp_path / "dark.npy", np.zeros((2, *INSTRUMENT.frame_shape), np.uint8))
    ended = elsplus("compare", tmp_path / "dark.npy", "-c", tmp_path / "cal.json", "-o", tmp_path / "o.png")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "frame 0 shows no light in LS: is the laser on" in ended.err
    assert not (tmp_path / "o.png").exists()


def test_depths_with_decimal_commas(elsplus: Callable[..., Run], tmp_path: Path) -> None:
    write_calibration(tmp_path / "cal.json", true_calibration(INSTRUMENT))
    np.save(tmp_path / "scan.npy", np.zeros((2, *INSTRUMENT.frame_shape), np.uint8))
    (tmp_path / "scan.depths.csv").write_text("depth_um\n0,0\n2,5\n")
    ended = elsplus("axial", tmp_path / "scan.npy", "-c", tmp_path / "cal.json", "-o", tmp_path / "o.json")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "line 2 is '0,0': one finite number per line is expected, its decimals behind a point" in ended.err
