"""Finished images come back as they were, with everything that was known of them."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import ImageMetadata, open_recording, write_images, write_mosaic

IMAGES = np.random.default_rng(3).normal(size=(6, 33, 33)).astype(np.float32)
CALIBRATION = Calibration.parse({"optics": {"um_per_px": 0.96, "line_period_s": 1e-5, "rows_per_frame": 500.0}})


def test_signed_floats_come_back_exactly(tmp_path):
    assert write_images(tmp_path / "els.tif", iter(IMAGES), ImageMetadata(um_per_px=0.96)) == 6
    read = tifffile.imread(tmp_path / "els.tif")
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, IMAGES)
    np.testing.assert_array_equal(tifffile.memmap(tmp_path / "els.tif", mode="r"), IMAGES)


@pytest.mark.parametrize("images", [IMAGES[:1], iter(IMAGES[:1]), [IMAGES[0]]])
def test_one_image_comes_back_too(tmp_path, images):
    write_images(tmp_path / "els.tif", images)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "els.tif").squeeze(), IMAGES[0])


def test_scale_interval_calibration_and_notes_are_kept(tmp_path):
    write_images(tmp_path / "els.tif", IMAGES, ImageMetadata(calibration=CALIBRATION, settings={"mode": "els"}))
    with open_recording(tmp_path / "els.tif") as recording:
        assert recording.metadata["um_per_px"] == 0.96
        assert recording.metadata["frame_period_s"] == pytest.approx(5e-3)
        assert recording.metadata["settings"] == {"mode": "els"}
        assert recording.calibration == CALIBRATION
    with tifffile.TiffFile(tmp_path / "els.tif") as file:
        assert file.series[0].axes == "TYX"


def test_only_one_image_is_held_at_a_time(tmp_path):
    alive = 0

    class Counted(np.ndarray):
        def __array_finalize__(self, _):
            nonlocal alive
            alive += 1

        def __del__(self):
            nonlocal alive
            alive -= 1

    def images():
        for k in range(50):
            assert alive <= 6
            yield np.full((20, 20), k, np.float32).view(Counted)

    assert write_images(tmp_path / "a.tif", images(), count=50) == 50
    assert tifffile.imread(tmp_path / "a.tif")[:, 3, 3].tolist() == list(range(50))


@pytest.mark.parametrize(
    ("images", "said"),
    [
        ([], "no image"),
        ([IMAGES], r"shape \(6, 33, 33\)"),
        ([IMAGES[0], IMAGES[0], IMAGES[0][1:]], r"image 2 is \(32, 33\)"),
    ],
)
def test_what_is_no_stack_is_refused_and_nothing_is_left(tmp_path, images, said):
    with pytest.raises(InputError, match=said):
        write_images(tmp_path / "a.tif", images)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_refused_before_any_work(tmp_path):
    (tmp_path / "a.tif").write_text("mine")

    def images():
        raise AssertionError("work was done")
        yield

    with pytest.raises(InputError, match="--force"):
        write_images(tmp_path / "a.tif", images())
    write_images(tmp_path / "a.tif", IMAGES, force=True)
    assert tifffile.imread(tmp_path / "a.tif").shape == IMAGES.shape


def test_a_mosaic_has_a_pyramid_and_its_scale(tmp_path):
    mosaic = np.random.default_rng(4).random((1300, 900)).astype(np.float32)
    assert write_mosaic(tmp_path / "m.ome.tif", mosaic, ImageMetadata(um_per_px=0.96)) == tmp_path / "m.ome.tif"
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "m.ome.tif"), mosaic)
    with tifffile.TiffFile(tmp_path / "m.ome.tif") as file:
        levels = file.series[0].levels
        assert [level.shape for level in levels] == [(1300, 900), (650, 450), (325, 225)]
        corner = levels[1].asarray()[0, 0]
        assert corner == pytest.approx(mosaic[:2, :2].mean())
        assert 'PhysicalSizeX="0.96"' in file.ome_metadata
    with pytest.raises(InputError, match="suffix that cannot be written"):
        write_mosaic(tmp_path / "m.png", mosaic)
    with pytest.raises(InputError, match="mosaic has shape"):
        write_mosaic(tmp_path / "n.ome.tif", mosaic[None])


def test_images_that_do_not_fit_on_the_disk_are_refused_before_they_are_written(tmp_path):
    with pytest.raises(OSError, match=r"43560.0 GB do not fit into the .* GB that are free on its disk") as refused:
        write_images(tmp_path / "els.tif", iter(IMAGES), count=10**10)
    assert refused.value.filename == str(tmp_path / "els.tif")
    assert not list(tmp_path.iterdir())


def with_planes(path, planes):
    """Write three frames whose planes have these times and places, as other microscopes' software does."""
    xml = tifffile.OmeXml()
    xml.addimage("uint8", (3, 33, 33), (3, 1, 1, 33, 33, 1), axes="TYX")
    written = "".join(f'<Plane TheC="0" TheZ="0" TheT="{t}" DeltaT="{time}"/>' for t, time in planes)
    document = xml.tostring().replace("</Pixels>", f"{written}</Pixels>")
    with tifffile.TiffWriter(path) as writer:
        for k in range(3):
            description = {"description": document.encode()} if k == 0 else {}
            writer.write(np.full((33, 33), k, np.uint8), metadata=None, contiguous=False, **description)


def test_planes_in_another_order_than_their_frames_have_their_own_times(tmp_path):
    with_planes(tmp_path / "r.ome.tif", [(0, 0.0), (2, 0.9), (1, 0.4)])
    with open_recording(tmp_path / "r.ome.tif") as recording:
        assert recording.times_s.tolist() == [0.0, 0.4, 0.9]


@pytest.mark.parametrize(
    ("planes", "problem"),
    [
        ([(0, 0.0), (1, 0.9), (2, 0.4)], "frame 2 is 0.5 s before frame 1"),
        ([(0, 0.0), (1, 0.9)], "it has 2 for 3 frames"),
        ([(0, 0.0), (1, "nan"), (2, "late")], "2 of 3 frames have none"),
    ],
)
def test_times_that_cannot_be_used_are_warned_of(tmp_path, planes, problem):
    with_planes(tmp_path / "r.ome.tif", planes)
    with pytest.warns(UserWarning, match=rf"the frames' times in r\.ome\.tif are not used, as {problem}: save"):
        recording = open_recording(tmp_path / "r.ome.tif")
    with recording:
        assert recording.times_s is None
