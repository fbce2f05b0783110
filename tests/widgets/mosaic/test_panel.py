"""The Mosaic panel, driven as a user drives it."""

from __future__ import annotations

import gc
import subprocess
import sys
import weakref
from functools import cache
from threading import Event

import numpy as np
import pytest
import tifffile
from napari.layers import Image
from napari.layers._layer_actions import _duplicate_layer as duplicate_layers
from qtpy.QtCore import Qt
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication, QPushButton

from napari_elsplus._view import FILLED
from napari_elsplus.io import open_recording, read_track, write_calibration, write_images
from napari_elsplus.io.settings import recall
from napari_elsplus.viewing.mosaic.files import save_mosaics
from napari_elsplus.viewing.mosaic.recorded import StackMosaics
from napari_elsplus.widgets.mosaic.panel import MosaicPanel
from napari_elsplus.widgets.shared.work import Work
from recordings import Truth, record, smooth_path, texture

PLUGIN = "napari-elsplus"
FRAMES = 30
OURS = {f"mosaic {what}" for what in ("LS", "ELSA", "ELS+", "track", "track marks", "coverage", "quality")}


@cache
def truth() -> Truth:
    return record(texture(800, 3), smooth_path(FRAMES, 12.0, 800, 4))


@pytest.fixture
def scan(tmp_path):
    path = tmp_path / "scan.tif"
    tifffile.imwrite(path, truth().frames)
    write_calibration(tmp_path / "scan.calibration.json", truth().calibration)
    return path


@pytest.fixture
def panel(viewer, scan):
    viewer.open(str(scan), plugin=PLUGIN)
    _, widget = viewer.window.add_plugin_dock_widget(PLUGIN, "Mosaic")
    return widget


def make(panel, qtbot):
    panel.form.start.native.click()
    assert panel.work.busy
    qtbot.waitUntil(lambda: not panel.work.busy and not panel.layers.behind, timeout=60_000)


def mosaics(viewer):
    return {layer.name for layer in viewer.layers if layer.name.startswith("mosaic")}


def drawn_corners(layer):
    """Return the world positions of the first and the last pixel of a mosaic."""
    drawn = np.argwhere(np.isfinite(np.asarray(layer.data[0])))
    return np.array([layer.data_to_world(corner) for corner in (drawn.min(axis=0), drawn.max(axis=0))])


def test_layers_are_created_one_in_each_update_so_that_the_window_answers_between_them(
    viewer, panel, qtbot, monkeypatch
):
    """Before: all at once took five seconds on a slow computer, after which the engine parks the galvo."""
    created, update = [], panel.layers.update

    def counted(*, whole):
        before = len(viewer.layers)
        new = update(whole=whole)
        created.append(len(viewer.layers) - before)
        return new

    monkeypatch.setattr(panel.layers, "update", counted)
    make(panel, qtbot)
    wanted = {f"mosaic {what}" for what in ("ELS+", "track", "track marks", "coverage", "quality")}
    qtbot.waitUntil(lambda: mosaics(viewer) == wanted)
    assert max(created) == 1


def test_three_mosaics_grow_side_by_side_with_their_track(viewer, panel, qtbot, monkeypatch):
    for box in panel.form.modes.values():
        box.value = True
    progress, displayed = panel.work.progress, Event()

    def until_displayed(steps, name):
        for number, step in enumerate(progress(steps, name)):
            if number == FRAMES // 2:
                assert displayed.wait(100)
            yield step

    monkeypatch.setattr(panel.work, "progress", until_displayed)
    panel.form.start.native.click()
    grown = set()

    def ended():
        if "mosaic ELS+" in viewer.layers:
            grown.add(np.isfinite(viewer.layers["mosaic ELS+"].data[-1]).sum())
            displayed.set()
        return not panel.work.busy

    qtbot.waitUntil(ended, timeout=200_000)
    assert len(grown) > 1
    qtbot.waitUntil(lambda: mosaics(viewer) == OURS | {"mosaic titles"})  # they are created one by one
    images = {"mosaic LS", "mosaic ELSA", "mosaic ELS+"}
    assert {layer.name for layer in viewer.layers[-8:-5]} == images
    assert [layer.name for layer in viewer.layers[-2:]] == ["mosaic track", "mosaic track marks"]
    assert not viewer.layers["mosaic coverage"].visible
    assert not any(layer.visible for layer in viewer.layers if layer.name.startswith("scan"))
    ls, elsa, els = (viewer.layers[f"mosaic {title}"] for title in ("LS", "ELSA", "ELS+"))
    assert np.all(np.diff([layer.extent.world[0, 1] for layer in (ls, elsa, els)]) > 0)
    assert els.extent.world[0, 1] > elsa.extent.world[1, 1] > ls.extent.world[1, 1]
    titles = viewer.layers["mosaic titles"]
    lefts = {layer.name: drawn_corners(layer)[0, 1] for layer in (ls, elsa, els)}
    assert {f"mosaic {title}" for title in titles.text.values} == set(lefts)
    for title, corner in zip(titles.text.values, titles.data, strict=True):
        assert titles.data_to_world(corner)[-1] == pytest.approx(lefts[f"mosaic {title}"], abs=4 * 2.3)
    um = 2.3 * 1
    assert els.scale == pytest.approx([um, um])
    assert [str(unit) for unit in els.units] == ["micrometer"] * 2
    track = viewer.layers["mosaic track"]
    corners = track.data_to_world((0, *track.data[0, 0])[-2:])
    assert els.extent.world[0, 1] < corners[1] < els.extent.world[1, 1]
    way = track.data[:, 1].sum(axis=0)
    expected = truth().positions[-1] - truth().positions[0]
    np.testing.assert_allclose(way, expected, atol=0.5)
    assert f"<b>{FRAMES}</b> of {FRAMES} frames tracked" in panel.form.status.text()
    assert "mm/s (limit" in panel.form.speed.text


def test_what_is_drawn_fills_the_view(viewer, panel, qtbot):
    """Before: the view showed the layer's extent, whose edges are multiples of 256 pixels."""
    make(panel, qtbot)
    layer, camera = viewer.layers["mosaic ELS+"], viewer.scene.camera
    corners = drawn_corners(layer)
    np.testing.assert_allclose(camera.center[-2:], corners.mean(axis=0), atol=4 * np.max(layer.scale))
    filled = np.ptp(corners, axis=0) * camera.zoom / viewer.canvas.size
    assert filled.max() == pytest.approx(FILLED, abs=0.03)


def test_mosaics_are_cleared_with_one_collection_of_garbage(viewer, panel, qtbot, monkeypatch):
    """Before: napari searched all memory after each of their layers, for five seconds on a busy computer."""
    make(panel, qtbot)
    collections, collect = [], gc.collect
    monkeypatch.setattr(gc, "collect", lambda *generation: (collections.append(generation), collect(*generation))[1])
    panel.form.clearing.native.click()
    assert mosaics(viewer) == set()
    assert len(collections) == 1


def test_maps_are_filled_when_they_are_looked_at(viewer, panel, qtbot):
    make(panel, qtbot)
    coverage, quality = viewer.layers["mosaic coverage"], viewer.layers["mosaic quality"]
    coverage.visible = True
    panel.layers.update(whole=True)
    assert np.nanmax(coverage.data) > 3
    assert 0.9 < np.nanmax(quality.data) <= 1
    assert np.isnan(coverage.data[0, 0])
    assert coverage.colormap.map(coverage.data[:1, 0])[0, 3] == 0, "transparent where there are no frames"
    assert coverage.colorbar.visible
    inside = viewer.layers["mosaic ELS+"]
    np.testing.assert_allclose(coverage.extent.world[0], inside.extent.world[0], atol=8 * 2.3)


def test_layers_keep_the_users_colours_and_are_used_again(viewer, panel, qtbot):
    make(panel, qtbot)
    layer = viewer.layers["mosaic ELS+"]
    layer.colormap = "magenta"
    viewer.layers.remove("mosaic quality")
    before = len(viewer.layers)
    make(panel, qtbot)
    assert viewer.layers["mosaic ELS+"] == layer
    assert layer.colormap.name == "magenta"
    assert len(viewer.layers) == before + 1
    assert mosaics(viewer) == OURS - {"mosaic LS", "mosaic ELSA"}


def test_copies_that_the_user_makes_are_the_users(viewer, panel, qtbot):
    """Before: a mosaic was not duplicated but raised, and the copy of a track was drawn and removed in its place."""
    make(panel, qtbot)
    qtbot.waitUntil(lambda: "mosaic quality" in viewer.layers)
    drawn = np.asarray(viewer.layers["mosaic ELS+"].data[0])
    viewer.layers.selection = [layer for layer in viewer.layers if layer.name in mosaics(viewer)]
    duplicate_layers(viewer.layers)
    copies = {name for name in mosaics(viewer) if name.endswith(" copy")}
    assert "mosaic ELS+ copy" in copies
    assert len(copies) == len(mosaics(viewer)) / 2
    lines = viewer.layers["mosaic track copy"].data
    panel.form.undoing.native.click()
    qtbot.waitUntil(lambda: not panel.layers.behind)
    assert len(viewer.layers["mosaic track"].data) < len(lines)
    assert viewer.layers["mosaic track copy"].data is lines
    panel.form.clearing.native.click()
    assert mosaics(viewer) == copies
    np.testing.assert_array_equal(viewer.layers["mosaic ELS+ copy"].data[0], drawn)


def test_a_mosaic_whose_layer_was_removed_names_the_ways_that_are_left(viewer, panel, qtbot):
    make(panel, qtbot)
    assert "removed" not in panel.form.status.text()
    viewer.layers.remove("mosaic ELS+")
    assert "its layer was removed: press Save..." in panel.form.status.text()
    panel.form.clearing.native.click()
    assert "removed" not in panel.form.status.text()


def test_stopping_keeps_what_was_laid_and_states_what_is_missing(viewer, panel, qtbot, monkeypatch):
    """Before: 12 of 12 frames were tracked, though the recording has more."""
    reached, stopped = Event(), Event()

    def progress(items, name):
        for index, item in enumerate(Work.progress(panel.work, items, name)):
            if index == FRAMES // 2:
                reached.set()
                stopped.wait(60)
            yield item

    monkeypatch.setattr(panel.work, "progress", progress)
    panel.form.start.native.click()
    qtbot.waitUntil(reached.is_set, timeout=60_000)
    qtbot.waitUntil(lambda: "mosaic ELS+" in viewer.layers, timeout=60_000)
    assert "stopped" not in panel.form.status.text()
    panel.form.start.native.click()
    stopped.set()
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    assert panel.form.start.text == "Mosaic"
    assert np.isfinite(viewer.layers["mosaic ELS+"].data[-1]).any()
    left = FRAMES - len(panel._shown.rows)
    assert 0 < left <= FRAMES // 2
    assert f"stopped before the end</b>: {left} images are left" in panel.form.status.text()
    monkeypatch.undo()
    make(panel, qtbot)
    assert "stopped" not in panel.form.status.text()


def test_undo_save_clear_and_their_keys(viewer, panel, qtbot, tmp_path, said):
    viewer.window.show()
    shown = [layer.name for layer in viewer.layers if layer.visible]
    make(panel, qtbot)
    panel.save(tmp_path / "m.ome.tif")
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    image = tifffile.imread(tmp_path / "m.ome.tif")
    drawn = np.asarray(viewer.layers["mosaic ELS+"].data[0])
    assert np.count_nonzero(image) == np.isfinite(drawn).sum()
    assert {row.state for row in read_track(tmp_path / "m.track.csv")} == {"tracked"}
    assert (tmp_path / "m.png").read_bytes()[:4] == b"\x89PNG"

    panel.window().activateWindow()
    qtbot.waitUntil(lambda: panel.window().isActiveWindow(), timeout=60_000)
    keys = Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier
    QTest.keyClick(panel, Qt.Key.Key_U, keys)
    assert not np.isfinite(viewer.layers["mosaic ELS+"].data[-1]).any()
    assert f"<b>0</b> of {FRAMES}" in panel.form.status.text()
    assert [len(viewer.layers[f"mosaic {what}"].data) for what in ("track", "track marks")] == [0, 0]
    panel.save(tmp_path / "nothing.ome.tif")
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    assert any("no mosaic to save" in words for _, words in said())
    QTest.keyClick(panel, Qt.Key.Key_K, keys)
    assert mosaics(viewer) == set()
    assert [layer.name for layer in viewer.layers if layer.visible] == shown


def test_bad_input_is_one_clear_line(viewer, panel, qtbot, said, tmp_path):
    def told(words):
        panel.form.start.native.click()
        qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
        assert any(words in message for _, message in said()), said()
        assert mosaics(viewer) == set()

    for box in panel.form.modes.values():
        box.value = False
    told("no image is chosen")
    panel.form.modes["els"].value = True
    (tmp_path / "bare").mkdir()
    tifffile.imwrite(tmp_path / "bare" / "bare.tif", truth().frames[:5])
    viewer.open(str(tmp_path / "bare" / "bare.tif"), plugin=PLUGIN)
    panel.form.recording.value = "bare raw"
    told("bare raw has no calibration: select a calibration file above")
    for name, frames, words in (
        ("single", np.ones((1, 60, 60)), "the stack has 1 frame"),
        ("even", np.ones((4, 60, 60)), "constant"),
        ("broken", np.full((4, 60, 60), np.nan), "NaN"),
    ):
        viewer.add_image(frames, name=name, contrast_limits=(0, 1))
        panel.form.recording.value = name
        told(words)
    panel.form.calibration.value = tmp_path / "scan.calibration.json"
    told("is for frames of 236 x 480 pixels, broken has 60 x 60")


def test_a_calibration_file_serves_a_recording_without_one(viewer, panel, qtbot, tmp_path):
    (tmp_path / "bare").mkdir()
    tifffile.imwrite(tmp_path / "bare" / "bare.tif", truth().frames[:8])
    viewer.open(str(tmp_path / "bare" / "bare.tif"), plugin=PLUGIN)
    panel.form.recording.value = "bare raw"
    panel.form.calibration.value = tmp_path / "scan.calibration.json"
    make(panel, qtbot)
    assert "<b>8</b> of 8" in panel.form.status.text()


def test_a_selected_calibration_file_that_is_gone_is_an_error(viewer, panel, tmp_path, said):
    """Before: the mosaic was made by the recording's own calibration, without a word."""
    panel.form.calibration.value = tmp_path / "gone.json"
    panel.form.start.native.click()
    assert not panel.work.busy
    assert "gone.json" in said()[-1][1]


def test_finished_images_are_laid_as_they_are(viewer, panel, qtbot):
    scene = 100 * texture(500, 3)
    images = np.stack([scene[100 + 4 * k :][:200, 50 + 7 * k :][:, :200] for k in range(10)])
    viewer.add_layer(Image(images, name="my images", scale=(1, 2, 2), units=("s", "um", "um")))
    panel.form.recording.value = "my images"
    make(panel, qtbot)
    layer = viewer.layers["mosaic my images"]
    assert layer.scale == pytest.approx([2, 2])
    assert "<b>10</b> of 10" in panel.form.status.text()


def test_finished_images_that_were_opened_as_raw_frames_are_ticked_as_such(viewer, panel, qtbot, tmp_path, said):
    """Before: another microscope's TIFF had no calibration, and there was no way to its mosaic."""
    scene = 100 * texture(500, 3)
    images = np.stack([scene[100 + 4 * k :][:200, 50 + 7 * k :][:, :200] for k in range(10)]).astype(np.uint16)
    (tmp_path / "bare").mkdir()
    path = tmp_path / "bare" / "video.tif"
    tifffile.imwrite(path, images)
    assert panel.form.finished.native.isHidden()
    viewer.open(str(path), plugin=PLUGIN)
    panel.form.recording.value = "video raw"
    assert not panel.form.finished.native.isHidden()
    panel.form.start.native.click()
    ((_, message),) = [one for one in said() if one[0] == "error"]
    assert "tick finished images" in message
    panel.form.finished.value = True
    make(panel, qtbot)
    assert "mosaic video" in viewer.layers
    assert "<b>10</b> of 10" in panel.form.status.text()
    panel.copy_script()
    script = QApplication.clipboard().text()
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert [one.state for one in read_track(tmp_path / "video-mosaic.track.csv")] == ["tracked"] * 10
    panel.form.recording.value = "scan raw"
    assert panel.form.finished.native.isHidden()
    make(panel, qtbot)
    assert f"<b>{FRAMES}</b> of {FRAMES}" in panel.form.status.text()


def test_the_image_types_are_stated_to_be_of_the_live_mosaic_where_finished_images_are_selected(viewer, panel, qtbot):
    """Before: the boxes were ticked to no effect, and one had to be."""
    assert panel.form.modes_note.isHidden()
    images = np.stack([100 * texture(300, 3)[4 * k :][:200, 7 * k :][:, :200] for k in range(5)])
    viewer.add_image(images, name="my images")
    panel.form.recording.value = "my images"
    panel.refresh()
    assert not panel.form.modes_note.isHidden()
    for box in panel.form.modes.values():
        box.value = False
    make(panel, qtbot)
    assert "mosaic my images" in viewer.layers
    panel.form.recording.value = "scan raw"
    panel.refresh()
    assert panel.form.modes_note.isHidden()


def test_a_mosaic_of_images_without_a_scale_is_not_measured(viewer, panel, qtbot, tmp_path):
    scene = 100 * texture(500, 3)
    images = np.stack([scene[100 + 4 * k :][:200, 50 + 7 * k :][:, :200] for k in range(10)])
    (tmp_path / "bare").mkdir()
    write_images(tmp_path / "bare" / "mine.tif", images)
    viewer.open(str(tmp_path / "bare" / "mine.tif"), plugin=PLUGIN)
    assert str(viewer.layers["mine images"].units[-1]) == "micrometer"
    panel.form.recording.value = "mine images"
    make(panel, qtbot)
    layer = viewer.layers["mosaic mine images"]
    assert str(layer.units[-1]) == "micrometer"
    layer.save(str(tmp_path / "layer.ome.tif"), plugin=PLUGIN)
    panel.save(tmp_path / "panel.ome.tif")
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=30_000)
    for name in ("layer", "panel"):
        with open_recording(tmp_path / f"{name}.ome.tif") as back:
            assert "um_per_px" not in back.metadata


def test_layers_that_are_used_again_take_the_scale_of_the_new_mosaic(viewer, panel, qtbot):
    make(panel, qtbot)
    scene = 100 * texture(500, 3)
    images = np.stack([scene[100 + 4 * k :][:200, 50 + 7 * k :][:, :200] for k in range(10)])
    viewer.add_layer(Image(images, name="my images", scale=(1, 5, 5), units=("s", "um", "um")))
    panel.form.recording.value = "my images"
    make(panel, qtbot)
    for kind in ("my images", "track", "track marks"):
        assert viewer.layers[f"mosaic {kind}"].scale == pytest.approx([5, 5])


def test_scripts_settings_and_themes(viewer, panel, qtbot, scan):
    panel.form.method.value = "paper"
    panel.form.insertion.value = "feathered"
    panel.form.script.native.click()
    text = QApplication.clipboard().text()
    compile(text, "script", "exec")
    assert str(scan) in text
    assert "'paper'" in text
    make(panel, qtbot)
    assert recall("mosaic") == {"method": "paper", "insertion": "feathered", "modes": ["els"]}
    for theme in ("light", "dark"):
        viewer.theme = theme
        assert panel.form.speed.text


def test_the_layers_stay_when_the_panel_goes_and_the_next_one_uses_them(viewer, scan, qtbot):
    viewer.open(str(scan), plugin=PLUGIN)
    _, panel = viewer.window.add_plugin_dock_widget(PLUGIN, "Mosaic")
    assert isinstance(panel, MosaicPanel)
    make(panel, qtbot)
    layer = viewer.layers["mosaic ELS+"]
    gone = weakref.ref(panel)
    viewer.window.remove_dock_widget(panel)
    del panel, _
    for _ in range(2):
        QApplication.processEvents()
        gc.collect()
    assert gone() is None
    assert layer in viewer.layers
    assert np.isfinite(layer.data[0]).any()
    _, again = viewer.window.add_plugin_dock_widget(PLUGIN, "Mosaic")
    make(again, qtbot)
    assert viewer.layers["mosaic ELS+"] == layer


def test_a_live_mosaic_replaces_an_unsaved_one_of_a_recording_only_if_confirmed(
    viewer, panel, qtbot, tmp_path, questions, monkeypatch
):
    make(panel, qtbot)
    assert panel.unsaved() == "The mosaic was not saved. Discard it?"
    monkeypatch.setattr(panel.connection, "connect", lambda *_: pytest.fail("a rig was connected"))
    questions.answer = False
    panel.form.going_live.native.click()
    assert len(questions) == 1
    assert mosaics(viewer)
    panel.save(tmp_path / "m.ome.tif")
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    assert panel.unsaved() == ""


def test_what_is_being_saved_is_neither_stopped_nor_cleared(panel, qtbot, tmp_path, monkeypatch):
    make(panel, qtbot)
    begun, goes_on = Event(), Event()

    def slow(*parts, **options):
        begun.set()
        assert goes_on.wait(60)
        return save_mosaics(*parts, **options)

    monkeypatch.setattr("napari_elsplus.widgets.mosaic.panel.save_mosaics", slow)
    panel.save(tmp_path / "m.ome.tif")
    assert begun.wait(60)
    buttons = panel.form.start, panel.form.clearing, panel.form.saving
    assert all(not button.enabled and "wait until it is saved" in button.tooltip for button in buttons)
    assert panel.work.findChild(QPushButton).isHidden(), "what is being written is not cancelled"
    assert panel.saving()
    goes_on.set()
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    assert not panel.saving()
    assert panel.form.start.enabled


def test_mosaics_that_cannot_be_begun_change_nothing(viewer, panel, qtbot, tmp_path):
    make(panel, qtbot)
    viewer.add_image(np.full((4, 60, 60), np.nan), name="broken", contrast_limits=(0, 1))
    panel.form.recording.value = "broken"
    before = [(layer.name, layer.visible) for layer in viewer.layers]
    make(panel, qtbot)
    assert [(layer.name, layer.visible) for layer in viewer.layers] == before
    panel.save(tmp_path / "m.ome.tif")
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    assert np.count_nonzero(tifffile.imread(tmp_path / "m.ome.tif"))


def test_mosaics_that_are_cancelled_before_their_first_frame_change_nothing(viewer, panel, qtbot, monkeypatch):
    make(panel, qtbot)
    shown, compiling, cancelled = panel._shown, Event(), Event()
    monkeypatch.setattr(
        "napari_elsplus.viewing.mosaic.recorded.StackMosaics.compile_kernels",
        lambda _: (compiling.set(), cancelled.wait(60)),
    )
    panel.form.start.native.click()
    qtbot.waitUntil(compiling.is_set, timeout=60_000)
    panel.form.start.native.click()
    cancelled.set()
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    assert panel._shown is shown


def test_the_users_layers_are_displayed_until_the_first_frame_is_inserted(viewer, panel, qtbot, monkeypatch):
    """Before: the canvas was black meanwhile, for seconds on a busy computer, and stayed so after Cancel."""
    begun, goes_on, run = Event(), Event(), StackMosaics.run
    monkeypatch.setattr(StackMosaics, "run", lambda *given: (begun.set(), goes_on.wait(60), run(*given))[-1])
    before = [(layer.name, layer.visible) for layer in viewer.layers]
    panel.form.start.native.click()
    qtbot.waitUntil(begun.is_set, timeout=60_000)
    panel.tick()
    assert [(layer.name, layer.visible) for layer in viewer.layers] == before
    panel.form.start.native.click()
    goes_on.set()
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    panel.tick()
    assert [(layer.name, layer.visible) for layer in viewer.layers] == before
    assert panel.unsaved() == ""


def test_a_renamed_recording_stays_selected(viewer, panel, qtbot):
    viewer.add_image(np.ones((4, 60, 60)), name="another")
    assert panel.form.recording.value == "scan raw"
    viewer.layers["scan raw"].name = "mine"
    assert panel.form.recording.value == "mine"
    make(panel, qtbot)
    assert f"<b>{FRAMES}</b> of {FRAMES}" in panel.form.status.text()
