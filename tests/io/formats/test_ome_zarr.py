"""Stacks and mosaics are written as OME-Zarr 0.5 and read back with scale, settings and calibration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import zarr

from napari_elsplus.io import ImageMetadata, open_recording, write_images, write_mosaic
from pairs import FRAME_PERIOD_S, calibration

RNG = np.random.default_rng(3)


def test_a_stack_is_read_back_with_its_scale_and_calibration(tmp_path: Path) -> None:
    images = RNG.normal(size=(5, 20, 30)).astype(np.float32)
    known = ImageMetadata(calibration=calibration(), settings={"mode": "els"})
    assert write_images(tmp_path / "a.ome.zarr", images, known) == 5
    with open_recording(tmp_path / "a.ome.zarr") as back:
        np.testing.assert_array_equal(back[:], images)
        assert back.metadata["um_per_px"] == pytest.approx(2.0)
        assert back.metadata["frame_period_s"] == pytest.approx(FRAME_PERIOD_S)
        assert back.metadata["settings"]["mode"] == "els"
        assert back.calibration is not None


def test_the_levels_of_a_mosaic_lie_on_each_other(tmp_path: Path) -> None:
    """A linear scene has the same value at the same place, in micrometres, on every level."""
    rows, cols = np.mgrid[:1300, :900].astype(np.float32)
    mosaic = 3 * rows + cols
    known = ImageMetadata(um_per_px=0.5, settings={"mode": "els"})
    assert write_mosaic(tmp_path / "m.ome.zarr", mosaic, known) == tmp_path / "m.ome.zarr"
    group = zarr.open_group(tmp_path / "m.ome.zarr", mode="r")
    image = group.attrs["ome"]["multiscales"][0]
    assert group.attrs["ome"]["version"] == "0.5"
    assert [(axis["name"], axis["unit"]) for axis in image["axes"]] == [("y", "micrometer"), ("x", "micrometer")]
    assert [group[level["path"]].shape for level in image["datasets"]] == [(1300, 900), (650, 450), (325, 225)]
    for level in image["datasets"]:
        steps = {one["type"]: one[one["type"]] for one in level["coordinateTransformations"]}
        first_um = steps.get("translation", [0.0, 0.0])
        place_um = [first + 40 * step for first, step in zip(first_um, steps["scale"], strict=True)]
        expected = (3 * place_um[0] + place_um[1]) / 0.5
        assert float(group[level["path"]][40, 40]) == pytest.approx(expected)
    with open_recording(tmp_path / "m.ome.zarr") as back:
        np.testing.assert_array_equal(back[0], mosaic)
        assert back.metadata["um_per_px"] == pytest.approx(0.5)


def test_a_mosaic_keeps_the_pixel_size_of_its_calibration(tmp_path: Path) -> None:
    write_mosaic(tmp_path / "m.ome.zarr", np.ones((40, 30), np.float32), ImageMetadata(calibration=calibration()))
    with open_recording(tmp_path / "m.ome.zarr") as back:
        assert back.metadata["um_per_px"] == pytest.approx(2.0)
        assert back.calibration is not None


def test_a_frame_whose_chunk_is_lost_is_warned_of(tmp_path: Path) -> None:
    frames = np.random.default_rng(1).integers(1, 9, (5, 24, 32), np.uint8)
    write_images(tmp_path / "a.zarr", frames)
    (tmp_path / "a.zarr" / "0" / "c" / "3" / "0" / "0").unlink()
    with open_recording(tmp_path / "a.zarr") as recording:
        np.testing.assert_array_equal(recording[:3], frames[:3])
        with pytest.warns(UserWarning, match=r"a\.zarr has no file of the pixels of frame 3, .* read as 0: copy it"):
            assert not recording[3].any()


@pytest.mark.parametrize("chunks", [(1, 24, 32), (2, 12, 32)])
def test_frames_that_other_software_left_out_are_warned_of_once(tmp_path: Path, chunks: tuple[int, ...]) -> None:
    for version in (2, 3):
        path = tmp_path / f"{version}.zarr"
        array = zarr.create_array(path, shape=(5, 24, 32), chunks=chunks, dtype="u1", zarr_format=version)
        array[0] = 7
        with open_recording(path) as recording:
            assert recording[0].all()
            with pytest.warns(UserWarning, match="of frame 4"):
                assert not recording[4].any()
            assert not recording[3].any()


def test_black_frames_that_this_software_wrote_are_not_warned_of(tmp_path: Path) -> None:
    write_images(tmp_path / "a.zarr", np.zeros((3, 24, 32), np.uint8))
    with open_recording(tmp_path / "a.zarr") as recording:
        assert not recording[:].any()
