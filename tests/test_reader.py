"""What happens when a file is dropped on napari."""

from __future__ import annotations

import json
import logging
import threading

import numpy as np
import pytest
import tifffile
from napari.utils.notifications import notification_manager
from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QLabel

from napari_elsplus._view import FILLED, SETTLED_MS, TWO_DIMENSIONS
from napari_elsplus.io import open_recording, settings, write_calibration
from napari_elsplus.workflows.sectioning import SectionedImages, section
from pairs import FRAME_PERIOD_S, calibration, frames, write_pair

PLUGIN = "napari-elsplus"


@pytest.fixture
def said():
    """What napari was told to show, as (severity, message)."""
    before = len(notification_manager.records)
    return lambda: [(r.severity.value, r.message) for r in notification_manager.records[before:]]


def test_a_recording_is_shown_and_scrolled(make_napari_viewer_proxy, tmp_path):
    viewer = make_napari_viewer_proxy()
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    assert [layer.name for layer in viewer.layers] == ["scan raw", "scan LS", "scan residual", "scan ELSA", "scan ELS+"]
    layer = viewer.layers["scan ELS+"]
    els = section(frames(), calibration(), "els")[:]
    for step in (0, 4, 2):
        viewer.dims.set_current_step(0, step)
        shown = np.asarray(layer.get_value((step * layer.scale[0], 64.0, 62.0), world=True))
        side = els.shape[1]
        assert shown == els[step, side // 2, side // 2] or shown == els[step, (side - 1) // 2, (side - 1) // 2]
    assert [str(unit) for unit in layer.units] == ["second", "micrometer", "micrometer"]


def test_what_is_opened_first_fills_the_canvas_above_a_scale_bar_and_what_follows_leaves_the_view(
    make_napari_viewer_proxy, tmp_path, qtbot
):
    """Before: the only visible image lay at the edge, cut, since hidden raw frames beside it were fitted, too."""
    viewer = make_napari_viewer_proxy()
    camera, bar = viewer.scene.camera, viewer.canvas.overlays.scale_bar
    path = str(write_pair(tmp_path))
    viewer.open(path, plugin=PLUGIN)
    corners = viewer.layers["scan ELS+"].extent.world[:, -2:]
    qtbot.waitUntil(lambda: bar.visible)
    assert camera.center[-2:] == pytest.approx(corners.mean(axis=0))
    assert camera.zoom == pytest.approx(FILLED * (viewer.canvas.size / np.diff(corners, axis=0)[0]).min())
    camera.zoom, bar.visible = 2 * camera.zoom, False
    view = camera.center, camera.zoom
    viewer.open(path, plugin=PLUGIN)
    qtbot.wait(3 * SETTLED_MS)
    assert (camera.center, camera.zoom, bar.visible) == (*view, False)


def test_the_first_frame_of_what_is_opened_first_is_displayed_and_what_follows_leaves_the_slider(
    make_napari_viewer_proxy, tmp_path
):
    """Before: the middle one, which is dark in an axial scan, with the contrast of the first."""
    viewer = make_napari_viewer_proxy()
    path = str(write_pair(tmp_path))
    viewer.open(path, plugin=PLUGIN)
    assert viewer.dims.current_step[0] == 0
    viewer.dims.set_current_step(0, 3)
    viewer.open(path, plugin=PLUGIN)
    assert viewer.dims.current_step[0] == 3


@pytest.mark.parametrize("moved", [False, True])
def test_what_is_opened_first_fills_a_canvas_that_the_layers_controls_make_narrower(
    make_napari_viewer_proxy, tmp_path, qtbot, moved
):
    """Before: where a layer took longer than others are waited for, they were fitted before all were there."""
    viewer = make_napari_viewer_proxy(show=True)
    camera = viewer.scene.camera
    viewer.window.resize(800, 600)
    viewer.window.add_dock_widget(QLabel("a panel of some width, beside the canvas"), area="right")
    qtbot.wait(3 * SETTLED_MS)
    before = viewer.canvas.size
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    if moved:
        camera.center = (7, 8)
    qtbot.wait(3 * SETTLED_MS)
    assert viewer.canvas.size != before
    corners = viewer.layers["scan ELS+"].extent.world[:, -2:]
    fitted = camera.center[-2:] == pytest.approx(corners.mean(axis=0))
    assert fitted != moved


def test_the_window_answers_between_the_layers_of_a_recording(make_napari_viewer_proxy, tmp_path):
    """Before: live images stood still, and heartbeats ceased, until the last was there: seconds on a busy computer."""
    viewer = make_napari_viewer_proxy()
    path, seen = str(write_pair(tmp_path)), []
    ticking = QTimer()
    ticking.timeout.connect(lambda: seen.append(len(viewer.layers)))
    ticking.start(0)
    opened = viewer.open(path, plugin="napari-elsplus")
    ticking.stop()
    assert set(seen) >= set(range(1, len(opened) + 1))
    seen.clear()
    ticking.start(0)
    viewer.add_image(np.zeros((8, 8)))
    assert seen == [], "layers of others are added as ever"
    ticking.stop()


def test_a_recording_stays_in_two_dimensions_and_is_never_computed_whole(
    make_napari_viewer, tmp_path, said, monkeypatch
):
    """Before: napari's button for three dimensions computed every frame at once."""
    read, frame = [], SectionedImages.__getitem__
    monkeypatch.setattr(SectionedImages, "__getitem__", lambda self, k: (read.append(k), frame(self, k))[1])
    viewer = make_napari_viewer()
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    button = viewer.window._qt_viewer.viewerButtons.ndisplayButton
    read.clear()
    viewer.dims.ndisplay = 3
    assert viewer.dims.ndisplay == 2
    assert not button.isChecked()
    assert len(set(read)) <= 1
    assert said()[-1] == ("warning", TWO_DIMENSIONS)
    viewer.layers["scan ELS+"].visible = False
    viewer.dims.ndisplay = 3
    assert viewer.dims.ndisplay == 3, "other layers are displayed as the user wants"
    read.clear()
    viewer.open(str(tmp_path / "scan.tif"), plugin=PLUGIN)
    assert viewer.dims.ndisplay == 2
    assert set(read) <= {0}


def test_an_axial_scan_is_displayed_in_three_dimensions(make_napari_viewer_proxy, tmp_path):
    viewer = make_napari_viewer_proxy()
    write_pair(tmp_path)
    (tmp_path / "scan.depths.csv").write_text("depth_um\n" + "\n".join(str(5 * k) for k in range(6)))
    viewer.open(str(tmp_path / "scan.tif"), plugin=PLUGIN)
    viewer.dims.ndisplay = 3
    assert viewer.dims.ndisplay == 3


def test_what_is_opened_last_is_selected_where_it_is_displayed(make_napari_viewer_proxy, tmp_path):
    """Before: a hidden layer was selected, and the controls of contrast changed nothing that is seen."""
    viewer = make_napari_viewer_proxy()
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    assert viewer.layers.selection.active.name == "scan ELS+"
    assert [layer.name for layer in viewer.layers if layer.visible] == ["scan ELS+"]


def test_a_recording_is_not_displayed_under_the_titles_of_a_sample(make_napari_viewer_proxy, tmp_path, qtbot):
    """Before: it lay over the first image of the sample, under its title, at the edge of the view."""
    viewer = make_napari_viewer_proxy()
    viewer.open_sample(PLUGIN, "recording")
    qtbot.wait(3 * SETTLED_MS)
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    assert [layer.name for layer in viewer.layers if layer.visible] == ["scan ELS+"]
    qtbot.wait(3 * SETTLED_MS)
    corners = viewer.layers["scan ELS+"].extent.world[:, -2:]
    assert viewer.scene.camera.center[-2:] == pytest.approx(corners.mean(axis=0))
    viewer.open_sample(PLUGIN, "recording")
    assert "fibres LS [1]" in viewer.layers
    assert not viewer.layers["fibres LS"].visible


def test_a_view_that_a_script_sets_after_opening_stays(make_napari_viewer_proxy, tmp_path, qtbot):
    """Before: layers that were opened were fitted a moment later, whatever the script had done by then."""
    viewer = make_napari_viewer_proxy()
    camera, bar = viewer.scene.camera, viewer.canvas.overlays.scale_bar
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    camera.zoom = 3 * camera.zoom
    view = camera.center, camera.zoom
    qtbot.waitUntil(lambda: bar.visible)
    assert (camera.center, camera.zoom) == view


def test_raw_frames_of_unknown_scale_have_no_scale_bar(make_napari_viewer_proxy, tmp_path, qtbot):
    viewer = make_napari_viewer_proxy()
    tifffile.imwrite(tmp_path / "bare.tif", frames())
    viewer.open(str(tmp_path / "bare.tif"), plugin=PLUGIN)
    qtbot.wait(3 * SETTLED_MS)
    assert not viewer.canvas.overlays.scale_bar.visible


def test_a_calibration_is_shown_and_becomes_the_active_one(make_napari_viewer_proxy, tmp_path, said):
    viewer = make_napari_viewer_proxy()
    path = write_calibration(tmp_path / "c.json", calibration())
    (tmp_path / "stacks").mkdir()
    tifffile.imwrite(tmp_path / "stacks" / "bare.tif", frames())
    viewer.open(str(path), plugin=PLUGIN)
    (outline,) = viewer.layers
    assert outline.features["view"].tolist() == ["confocal", "residual"]
    assert settings.active_calibration() == path
    viewer.open(str(tmp_path / "stacks" / "bare.tif"), plugin=PLUGIN)
    assert "bare ELS+" in viewer.layers
    assert [severity for severity, _ in said()] == ["info", "warning"]


def test_the_window_answers_while_the_outlines_of_a_calibration_are_prepared(
    make_napari_viewer_proxy, tmp_path, monkeypatch
):
    """Before: it stood still for 11 s at the first one after an installation, and the engine took it for frozen."""
    viewer, waited, ticks = make_napari_viewer_proxy(), threading.Event(), []
    monkeypatch.setattr("napari_elsplus._reader.prepare_shapes", lambda: waited.wait(60))
    ticking = QTimer()
    ticking.timeout.connect(lambda: (ticks.append(True), waited.set() if len(ticks) == 5 else None))
    ticking.start(0)
    viewer.open(str(write_calibration(tmp_path / "c.json", calibration())), plugin=PLUGIN)
    ticking.stop()
    assert waited.is_set()
    assert len(viewer.layers) == 1


def damaged(tmp_path):
    path = tmp_path / "cut.tif"
    tifffile.imwrite(path, frames(), compression="zlib")
    path.write_bytes(path.read_bytes()[:400])
    return path


def foreign(tmp_path):
    path = tmp_path / "text.tif"
    path.write_text("not a tiff")
    return path


def colour(tmp_path):
    tifffile.imwrite(tmp_path / "rgb.tif", np.zeros((2, 20, 20, 3), np.uint8), photometric="rgb")
    return tmp_path / "rgb.tif"


def newer(tmp_path):
    (tmp_path / "new.json").write_text(json.dumps({"format": "napari-elsplus/calibration", "version": 9}))
    return tmp_path / "new.json"


@pytest.mark.parametrize("make", [damaged, foreign, colour, newer])
def test_bad_files_give_one_notification_and_no_layer(make_napari_viewer_proxy, tmp_path, said, make):
    viewer = make_napari_viewer_proxy()
    viewer.open(str(make(tmp_path)), plugin=PLUGIN)
    assert len(viewer.layers) == 0
    ((severity, message),) = said()
    assert severity == "error"
    assert ": " in message
    assert settings.active_calibration() is None


def test_a_calibration_that_does_not_fit_is_a_warning_and_the_raw_frames(make_napari_viewer_proxy, tmp_path, said):
    viewer = make_napari_viewer_proxy()
    path = write_pair(tmp_path)
    tifffile.imwrite(path, frames()[:, :50])
    viewer.open(str(path), plugin=PLUGIN)
    assert [layer.name for layer in viewer.layers] == ["scan raw"]
    ((severity, message),) = said()
    assert severity == "warning"
    assert "64 x 128" in message


def test_a_file_that_is_not_ours_is_named_with_what_is(make_napari_viewer_proxy, tmp_path, said):
    """Before: a traceback, since no other reader takes it."""
    (tmp_path / "other.json").write_text('{"a": 1}')
    viewer = make_napari_viewer_proxy()
    viewer.open(str(tmp_path / "other.json"), plugin=PLUGIN)
    ((severity, message),) = said()
    assert severity == "error"
    assert message.startswith("other.json is neither a recording nor a calibration: recordings are TIFF")
    assert not viewer.layers


def test_files_that_are_opened_as_a_stack_are_the_recording_of_their_folder(make_napari_viewer_proxy, tmp_path, said):
    """Before: napari displayed a traceback, by which the reader had refused the files."""
    viewer = make_napari_viewer_proxy()
    for k, frame in enumerate(frames()):
        tifffile.imwrite(tmp_path / f"f{k}.tif", frame)
    files = [str(tmp_path / f"f{k}.tif") for k in range(len(frames()))]
    viewer.open(files, stack=True, plugin=PLUGIN)
    (layer,) = viewer.layers
    np.testing.assert_array_equal(layer.data, frames())
    viewer.layers.clear()
    viewer.open(files[:3], stack=True, plugin=PLUGIN)
    assert len(viewer.layers) == 0
    assert said()[-1][0] == "error"
    assert "these 3 files are not all TIFFs of one folder: open the folder itself" in said()[-1][1]


def test_a_closed_viewer_lets_the_recording_go(make_napari_viewer_proxy, tmp_path, caplog):
    import gc
    import weakref

    from qtpy.QtCore import QEvent
    from qtpy.QtWidgets import QApplication

    viewer = make_napari_viewer_proxy()
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    recording = weakref.ref(viewer.layers[0].metadata["elsplus"]["stack"].recording)
    assert recording() is not None
    with caplog.at_level(logging.CRITICAL):
        viewer.layers.clear()
        QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete.value)  # PySide6 keeps the rows until then
    gc.collect()
    assert recording() is None


def test_a_recording_without_calibration_leaves_scale_bar_and_slider_of_the_others(
    make_napari_viewer_proxy, tmp_path, said
):
    viewer = make_napari_viewer_proxy()
    (tmp_path / "bare").mkdir()
    tifffile.imwrite(tmp_path / "bare" / "bare.tif", frames())
    write_pair(tmp_path)
    for order in (("scan.tif", "bare/bare.tif"), ("bare/bare.tif", "scan.tif")):
        viewer.layers.clear()
        for name in order:
            viewer.open(str(tmp_path / name), plugin=PLUGIN)
        units = {tuple(str(unit) for unit in layer.units) for layer in viewer.layers}
        assert units == {("second", "micrometer", "micrometer")}
        assert viewer.dims.nsteps[0] <= len(frames())
        assert viewer.layers["bare raw"].metadata["elsplus"]["calibration"] is None
    assert any("bare raw has no calibration" in words for _, words in said())


@pytest.mark.parametrize("names", [("scan.tif", "plate.tif"), ("plate.tif", "scan.tif")])
@pytest.mark.parametrize("power", [1, 2])
def test_a_scan_beside_recordings_is_displayed_frame_by_frame(make_napari_viewer_proxy, tmp_path, said, names, power):
    """Before: napari warned of inconsistent units, drew no scale bar, and had tens of thousands of slider steps."""
    viewer = make_napari_viewer_proxy()
    write_pair(tmp_path)
    for file in (".tif", ".calibration.json"):
        (tmp_path / f"plate{file}").write_bytes((tmp_path / f"scan{file}").read_bytes())
    (tmp_path / "plate.depths.csv").write_text("depth_um\n" + "\n".join(str(5 * k**power) for k in range(6)))
    for name in names:
        viewer.open(str(tmp_path / name), plugin=PLUGIN)
    assert said() == []
    assert viewer.dims.nsteps[0] == 6
    viewer.layers["scan ELS+"].visible = False
    viewer.layers["plate ELS+"].visible = True
    viewer.dims.set_current_step(0, 3)
    assert viewer.canvas.overlays.text.text == f"depth {5 * 3**power:.1f} µm"
    layers = [viewer.layers[f"scan {title}"] for title in ("LS", "ELSA")]
    assert layers[1].scale[0] == 2 * layers[0].scale[0]
    for layer in layers:
        layer.save(str(tmp_path / "saved.tif"), plugin=PLUGIN)
        with open_recording(tmp_path / "saved.tif") as back:
            frames_each = layers.index(layer) + 1
            assert back.metadata["frame_period_s"] == pytest.approx(frames_each * FRAME_PERIOD_S)


def test_the_depth_of_an_axial_scan_is_on_the_canvas_in_micrometres(make_napari_viewer_proxy, tmp_path):
    viewer = make_napari_viewer_proxy()
    write_pair(tmp_path)
    (tmp_path / "scan.depths.csv").write_text("depth_um\n" + "\n".join(str(d) for d in (0, 5, 20, 40, 80, 160)))
    viewer.open(str(tmp_path / "scan.tif"), plugin=PLUGIN)
    viewer.dims.set_current_step(0, 3)
    assert viewer.canvas.overlays.text.text == "depth 40.0 µm"
    assert viewer.canvas.overlays.text.visible
    viewer.layers.clear()
    assert not viewer.canvas.overlays.text.visible
