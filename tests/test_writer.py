"""Layers are saved with their scale, and come back as they were."""

from __future__ import annotations

import shutil

import dask.array as da
import numpy as np
import pytest
import tifffile
import zarr
from napari.layers import Image
from napari.utils import cancelable_progress
from napari.utils.notifications import notification_manager
from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QFileDialog

from napari_elsplus._problems import problems
from napari_elsplus._writer import write_image
from napari_elsplus.errors import CancelledError, InputError
from napari_elsplus.io import ImageMetadata, open_recording, write_calibration, write_images
from napari_elsplus.viewing.common_axes import ADOPTED
from napari_elsplus.viewing.lazy import UnreadablePlane
from napari_elsplus.workflows.sectioning import section
from pairs import FRAME_PERIOD_S, calibration, frames, write_pair
from videos import write_avi

PLUGIN = "napari-elsplus"


@pytest.mark.parametrize("ending", [".ome.tif", ".ome.zarr"])
def test_an_opened_layer_is_saved_and_comes_back(make_napari_viewer_proxy, tmp_path, ending):
    viewer = make_napari_viewer_proxy()
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    target = tmp_path / f"els{ending}"
    assert viewer.layers["scan ELS+"].save(str(target), plugin=PLUGIN) == [str(target)]
    with open_recording(target) as back:
        np.testing.assert_array_equal(back[:], section(frames(), calibration(), "els")[:])
        assert back.metadata["um_per_px"] == pytest.approx(2.0)
        assert back.metadata["frame_period_s"] == pytest.approx(FRAME_PERIOD_S)
    viewer.open(str(target), plugin=PLUGIN)
    assert viewer.layers[-1].name == "els ELS+"
    np.testing.assert_allclose(viewer.layers[-1].scale, viewer.layers["scan ELS+"].scale)


def test_the_calibration_and_the_mode_go_along(make_napari_viewer_proxy, tmp_path):
    viewer = make_napari_viewer_proxy()
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    viewer.layers["scan LS"].save(str(tmp_path / "ls.tif"), plugin=PLUGIN)
    with open_recording(tmp_path / "ls.tif") as back:
        assert back.calibration.offset.rows == -4.0
        assert back.metadata["settings"] == {"layer": "scan LS", "mode": "ls", "recording": "scan.tif"}
    viewer.open(str(tmp_path / "ls.tif"), plugin=PLUGIN)
    assert viewer.layers[-1].name == "ls LS"
    viewer.layers["scan LS"].save(str(tmp_path / "ls.zarr"), plugin=PLUGIN)
    with open_recording(tmp_path / "ls.zarr") as back:
        assert back.calibration.offset.rows == -4.0
        assert "calibration" not in back.metadata["settings"]


def test_frames_that_cannot_be_read_are_displayed_as_empty_and_not_saved(make_napari_viewer_proxy, tmp_path):
    """Before: a traceback, and a layer that napari could not remove."""
    folder = tmp_path / "frames"
    folder.mkdir()
    for k in range(3):
        tifffile.imwrite(folder / f"{k}.tif", np.ones((40 + k // 2, 60), np.uint8))
    viewer = make_napari_viewer_proxy()
    viewer.open(str(folder), plugin=PLUGIN)
    with pytest.warns(UnreadablePlane, match=r"2\.tif has shape"):
        viewer.dims.set_current_step(0, 2)
    layer = viewer.layers[0]
    with pytest.raises(UnreadablePlane, match=r"2\.tif has shape"):
        layer.save(str(tmp_path / "saved.tif"), plugin=PLUGIN)
    assert not (tmp_path / "saved.tif").exists()
    viewer.layers.clear()


def test_an_error_of_saving_is_displayed_by_napari_alone_and_kept_in_the_status_line(
    make_napari_viewer, tmp_path, monkeypatch
):
    """Before: the dialog went on to state that the plugin had returned no paths, above the remedy."""
    (tmp_path / "file").write_text("a folder's name")
    path, attributes = str(tmp_path / "file" / "x.tif"), {"name": "x", "scale": (1, 1), "units": ("um", "um")}
    with pytest.raises(InputError, match="there is no folder"):
        write_image(path, np.zeros((4, 5), np.uint8), attributes)
    viewer, shown = make_napari_viewer(), len(notification_manager.records)
    viewer.add_image(np.zeros((4, 5), np.uint8))

    def chosen(*_, **options):
        return path, next(kind for kind in options["filter"].split(";;") if "OME-TIFF" in kind)

    monkeypatch.setattr(QFileDialog, "getSaveFileName", chosen)
    with pytest.raises(InputError, match="there is no folder"):  # displayed by napari as any exception is
        viewer.window._qt_viewer._save_layers_dialog(selected=True)
    assert len(notification_manager.records) == shown
    assert "there is no folder" in problems.newest
    write_image(str(tmp_path / "x.tif"), np.zeros((4, 5), np.uint8), attributes)
    assert not problems.newest


@pytest.mark.parametrize("ending", [".ome.tif", ".ome.zarr"])
def test_the_window_answers_while_planes_are_saved_and_the_user_may_cancel(make_napari_viewer_proxy, tmp_path, ending):
    """Before: it stood still for minutes while a recording was saved, and the engine took it for frozen."""
    viewer, path, ticks = make_napari_viewer_proxy(), tmp_path / f"x{ending}", []
    ticking = QTimer()
    ticking.timeout.connect(lambda: ticks.append(True))
    ticking.start(0)
    layer = viewer.add_image(np.zeros((20, 4, 5), np.uint8))
    layer.save(str(path), plugin=PLUGIN)
    ticking.stop()
    assert len(ticks) >= 20
    path.unlink() if path.is_file() else shutil.rmtree(path)
    cancels = QTimer()
    cancels.timeout.connect(lambda: [bar.cancel() for bar in list(cancelable_progress._all_instances)])
    cancels.start(0)
    with pytest.raises(CancelledError, match="not saved"):
        layer.save(str(path), plugin=PLUGIN)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ending", [".ome.tif", ".ome.zarr"])
def test_saved_raw_frames_give_the_same_images_again(make_napari_viewer_proxy, tmp_path, ending):
    """The background is in no image file, so the calibration goes beside, and scripts can name it."""
    viewer = make_napari_viewer_proxy()
    known = calibration().model_copy(update={"background": np.full(frames()[0].shape, 2.5, np.float32)})
    path = write_pair(tmp_path)
    write_calibration(tmp_path / "scan.calibration.json", known, force=True)
    viewer.open(str(path), plugin=PLUGIN)
    target, its_calibration = tmp_path / f"copy{ending}", tmp_path / "copy.calibration.json"
    assert viewer.layers["scan raw"].save(str(target), plugin=PLUGIN) == [str(target), str(its_calibration)]
    viewer.open(str(target), plugin=PLUGIN)
    for name in ("LS", "ELS+"):
        np.testing.assert_array_equal(viewer.layers[f"copy {name}"].data, viewer.layers[f"scan {name}"].data)
    assert viewer.layers["copy raw"].metadata["elsplus"]["calibration_path"] == its_calibration


def test_a_single_image_gets_a_pyramid(tmp_path):
    image = np.random.default_rng(0).random((700, 600)).astype(np.float32)
    data, attributes, _ = Image(image, scale=(0.5, 0.5), units=("mm", "mm")).as_layer_data_tuple()
    write_image(str(tmp_path / "m.tif"), data, attributes)
    with tifffile.TiffFile(tmp_path / "m.tif") as file:
        np.testing.assert_array_equal(file.asarray(), image)
        assert len(file.series[0].levels) == 2
        assert 'PhysicalSizeX="500.0"' in file.ome_metadata
    write_image(str(tmp_path / "m.zarr"), data, attributes)
    np.testing.assert_array_equal(zarr.open(tmp_path / "m.zarr")["0"], image)
    assert zarr.open(tmp_path / "m.zarr")["1"].shape == (350, 300)


def test_pixels_are_not_taken_for_micrometres(tmp_path):
    data, attributes, _ = Image(np.zeros((3, 8, 8), np.float32)).as_layer_data_tuple()
    write_image(str(tmp_path / "a.tif"), data, attributes)
    with open_recording(tmp_path / "a.tif") as back:
        assert "um_per_px" not in back.metadata
        assert "frame_period_s" not in back.metadata


@pytest.mark.parametrize("ending", [".ome.tif", ".ome.zarr"])
@pytest.mark.parametrize("period_s", [None, 0.5])
def test_axes_of_other_layers_are_not_saved_as_measured(make_napari_viewer_proxy, tmp_path, ending, period_s):
    """From the file they are adopted once more, or in pixels; what the file itself has stays measured."""
    viewer = make_napari_viewer_proxy()
    (tmp_path / "bare").mkdir()
    bare, copy = tmp_path / "bare" / f"bare{ending}", tmp_path / "bare" / f"copy{ending}"
    write_images(bare, frames().astype(np.float32), ImageMetadata(frame_period_s=period_s))
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    for path in (bare, copy):
        viewer.open(str(path), plugin=PLUGIN)
        layer = viewer.layers[-1]
        np.testing.assert_allclose(layer.scale, [period_s or FRAME_PERIOD_S, 2.0, 2.0])
        assert layer.metadata["elsplus"][ADOPTED] == (period_s is None, True, True)
        if path == bare:
            layer.save(str(copy), plugin=PLUGIN)
    with open_recording(copy) as back:
        assert "um_per_px" not in back.metadata
        assert back.metadata.get("frame_period_s") == period_s
    viewer.layers.clear()
    viewer.open(str(copy), plugin=PLUGIN)
    assert [str(unit) for unit in viewer.layers[-1].units] == ["second" if period_s else "pixel", "pixel", "pixel"]


def test_planes_are_computed_one_at_a_time(tmp_path):
    asked = []

    def plane(block_info=None):
        asked.append(block_info[None]["chunk-location"][0])
        return np.zeros((1, 8, 8), np.float32)

    lazy = da.map_blocks(plane, chunks=((1,) * 5, (8,), (8,)), dtype=np.float32, meta=np.empty((0, 0, 0), np.float32))
    write_image(str(tmp_path / "a.tif"), lazy, {"name": "a"})
    assert asked == [0, 1, 2, 3, 4]


def test_of_a_pyramid_the_full_resolution_is_saved(tmp_path):
    levels = [np.ones((64, 64), np.float32), np.zeros((32, 32), np.float32)]
    data, attributes, _ = Image(levels, multiscale=True).as_layer_data_tuple()
    write_image(str(tmp_path / "a.tif"), data, attributes)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.tif"), levels[0])


@pytest.mark.parametrize("ending", [".tif", ".zarr"])
@pytest.mark.parametrize(
    ("data", "rgb"), [(np.zeros((8, 8, 3), np.uint8), True), (np.zeros((2, 2, 8, 8), np.uint8), False)]
)
def test_colour_and_more_dimensions_are_refused(tmp_path, ending, data, rgb):
    with pytest.raises(InputError, match="grey levels"):
        write_image(str(tmp_path / f"a{ending}"), data, {"name": "a", "rgb": rgb})
    assert list(tmp_path.iterdir()) == []


DROPPED = ("-vf", "select=not(between(n\\,2\\,3))", "-fps_mode", "passthrough", "-c:v", "rawvideo", "-pix_fmt", "gray")
"""Of six frames of a video, the third and the fourth."""
UNEVEN_S = (0.0, 0.004, 0.008, 0.02, 0.024, 0.028)


@pytest.mark.parametrize("ending", [".ome.tif", ".ome.zarr"])
@pytest.mark.parametrize(("layer", "step"), [("raw", 1), ("ELS+", 1), ("ELSA", 2)])
def test_uneven_times_of_the_recording_are_saved(make_napari_viewer_proxy, tmp_path, ending, layer, step):
    write_pair(tmp_path)
    write_images(tmp_path / "scan.ome.tif", frames(), ImageMetadata(frame_period_s=0.004, times_s=UNEVEN_S))
    viewer = make_napari_viewer_proxy()
    viewer.open(str(tmp_path / "scan.ome.tif"), plugin=PLUGIN)
    viewer.layers[f"scan {layer}"].save(str(tmp_path / f"saved{ending}"), plugin=PLUGIN)
    with open_recording(tmp_path / f"saved{ending}") as back:
        np.testing.assert_allclose(back.times_s, UNEVEN_S[::step])


def test_uneven_times_that_are_lost_are_told(make_napari_viewer_proxy, tmp_path):
    """By notifications, since napari's dialog discards warnings. Of some planes of a layer, and where they are lost:

    times of a video without a calibration are those of its playback.
    """
    write_images(tmp_path / "scan.ome.tif", frames(), ImageMetadata(frame_period_s=0.004, times_s=UNEVEN_S))
    write_avi(tmp_path / "video.avi", frames(), *DROPPED)
    viewer = make_napari_viewer_proxy()
    viewer.open([str(tmp_path / "scan.ome.tif"), str(tmp_path / "video.avi")], plugin=PLUGIN)
    of_scan, of_video = (viewer.layers[name].as_layer_data_tuple() for name in ("scan raw", "video raw"))
    write_image(str(tmp_path / "part.tif"), of_scan[0][:3], of_scan[1])
    assert "uneven in time, and these are 3 planes of 6 frames" in notification_manager.records[-1].message
    write_image(str(tmp_path / "video.tif"), *of_video[:2])
    assert "video.avi has the times of its playback, and these are saved" in notification_manager.records[-1].message
    with open_recording(tmp_path / "video.tif") as back:
        np.testing.assert_allclose(back.times_s, [0.0, 0.02, 0.08, 0.1])
