"""The calibration beside a recording comes before the one in it, and that before the active one."""

from __future__ import annotations

import json

import numpy as np
import pytest

from napari_elsplus.errors import CalibrationError
from napari_elsplus.io import (
    ImageMetadata,
    beside,
    calibration_beside,
    open_recording,
    settings,
    write_calibration,
    write_images,
)
from napari_elsplus.io.calibration_lookup import active_calibration_for_rig
from pairs import calibration

FULL = calibration().content()


def with_tilt(degrees):
    """Return the calibration with another tilt, by which the tests tell one from another."""
    known = calibration()
    return known.model_copy(update={"offset": known.offset.model_copy(update={"tilt_deg": degrees})})


def test_beside_comes_before_inside_and_that_before_the_active(tmp_path):
    (tmp_path / "rig").mkdir()
    active = write_calibration(tmp_path / "rig" / "c.json", with_tilt(3.0))
    own, bare = tmp_path / "own.tif", tmp_path / "bare.npy"
    write_images(own, [np.zeros((4, 6), np.uint8)], ImageMetadata(calibration=with_tilt(2.0)))
    np.save(bare, np.zeros((2, 4, 6), np.uint8))
    with open_recording(bare) as recording:
        assert recording.calibration is None
        assert recording.find_calibration() == (None, None)
        found, file = recording.find_calibration(active)
        assert (found.offset.tilt_deg, file) == (3.0, active)
    with open_recording(own) as recording:
        found, file = recording.find_calibration(active)
        assert (found.offset.tilt_deg, file) == (2.0, None)
        path = write_calibration(tmp_path / "own.calibration.json", with_tilt(1.0))
        found, file = recording.find_calibration(active)
        assert (found.offset.tilt_deg, file) == (1.0, path)
        path.write_text(path.read_text()[:-20])
        with pytest.raises(CalibrationError):
            recording.find_calibration(active)


def test_the_active_calibration_is_for_the_rig_that_it_was_acquired_with(tmp_path):
    assert active_calibration_for_rig("bench") == (None, None)
    for rig, fits in (("bench", True), ("other", False), (None, True)):
        content = FULL if rig is None else FULL | {"acquired_with": {"rig": rig}}
        path = tmp_path / f"{rig}.json"
        path.write_text(json.dumps(content))
        settings.set_active_calibration(path)
        assert (active_calibration_for_rig("bench")[1] == path) == fits


@pytest.mark.parametrize("name", ["scan.calibration.json", "scan.json", "calibration.json"])
def test_the_calibration_beside_a_recording_is_found(tmp_path, name):
    (tmp_path / "scan.json").write_text('{"positions": []}')
    (tmp_path / name).write_text(json.dumps(FULL))
    assert calibration_beside(tmp_path / "scan.ome.tif") == tmp_path / name


def test_no_calibration_beside(tmp_path):
    (tmp_path / "truth.json").write_text("{}")
    assert calibration_beside(tmp_path / "scan.tif") is None


@pytest.mark.parametrize(
    ("name", "stem"),
    [("a.ome.tif", "a"), ("a.tiff", "a"), ("a.b.npy", "a.b"), ("a.ome.zarr", "a"), ("folder", "folder")],
)
def test_names_beside(name, stem):
    assert beside(name, ".depths.csv").name == f"{stem}.depths.csv"


def test_a_recording_whose_name_has_no_room_for_that_of_a_calibration_has_none(tmp_path):
    assert calibration_beside(tmp_path / ("a" * 247 + ".ome.tif")) is None
