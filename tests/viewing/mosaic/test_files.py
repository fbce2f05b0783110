from __future__ import annotations

import json
import runpy
from functools import cache

import numpy as np
import pytest
import tifffile
from matplotlib.image import imread

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.io import RecordingWriter, open_recording, read_track
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.viewing.mosaic.files import mosaic_script, save_mosaics
from napari_elsplus.viewing.mosaic.recorded import StackMosaics
from napari_elsplus.viewing.stack import Stack
from napari_elsplus.workflows.mosaic_plan import MosaicPlan
from recordings import Truth, record, smooth_path, texture

PLAN = MosaicPlan((Mode.LS, Mode.ELS))


@cache
def truth() -> Truth:
    return record(texture(600, 3), smooth_path(12, 9.0, 600, 4))


@cache
def made() -> StackMosaics:
    mosaics = StackMosaics(truth().frames, truth().calibration, PLAN)
    mosaics.run()
    return mosaics


def test_mosaics_pictures_and_track_are_saved(tmp_path) -> None:
    paths = save_mosaics(made(), tmp_path / "m.ome.tif", PLAN, truth().calibration)
    names = {"m-ls.ome.tif", "m-ls.png", "m-els.ome.tif", "m-els.png", "m.track.csv"}
    assert {path.name for path in paths} == names == {path.name for path in tmp_path.iterdir()}
    mosaic = made().canvases[Mode.ELS][0]
    with tifffile.TiffFile(tmp_path / "m-els.ome.tif") as file:
        np.testing.assert_array_equal(file.asarray(), mosaic.read()[0])
        assert f'PhysicalSizeX="{made().scale.um_per_px}"' in file.ome_metadata
        assert json.dumps([-mosaic.extent.top, -mosaic.extent.left]) in file.ome_metadata.replace("&quot;", '"')
    rows, cols, _ = imread(tmp_path / "m-els.png").shape
    assert rows / cols == pytest.approx(mosaic.extent.shape[0] / mosaic.extent.shape[1], rel=0.02)
    assert [repr(row) for row in read_track(tmp_path / "m.track.csv")] == [repr(row) for row in made().rows]


def test_nothing_is_replaced_unasked_and_nothing_half_written(tmp_path) -> None:
    (tmp_path / "m-els.png").write_text("mine")
    with pytest.raises(InputError, match=r"m-els\.png"):
        save_mosaics(made(), tmp_path / "m.ome.tif", PLAN)
    assert [path.name for path in tmp_path.iterdir()] == ["m-els.png"]
    save_mosaics(made(), tmp_path / "m.ome.tif", PLAN, force=True)
    assert len(list(tmp_path.iterdir())) == 5


def test_the_script_does_the_same(tmp_path, monkeypatch) -> None:
    path = tmp_path / "scan.tif"
    kept = np.r_[0:5, 8:12]  # the camera lost three frames
    with RecordingWriter(path, truth().frames.shape[1:], np.uint8, calibration=truth().calibration) as writer:
        for number in kept:
            writer.append(truth().frames[number], number / 240, int(number))
    calibration_file = tmp_path / "scan.calibration.json"
    with open_recording(path) as recording:
        stack = Stack.of(recording)
        script = tmp_path / "script.py"
        script.write_text(mosaic_script(stack, calibration_file, PLAN), encoding="utf-8")
    with pytest.raises(CalibrationError, match="no file of its own"):
        mosaic_script(stack, None, PLAN)
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script))
    mosaics = StackMosaics(truth().frames[kept], truth().calibration, PLAN, kept / 240, kept)
    mosaics.run()
    np.testing.assert_array_equal(
        tifffile.imread(tmp_path / "scan-mosaic-els.ome.tif"), mosaics.canvases[Mode.ELS][0].read()[0]
    )
