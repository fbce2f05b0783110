"""The Compare panel, driven as a user drives it."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest
import tifffile
from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QApplication

from napari_elsplus._problems import problems
from napari_elsplus._view import SETTLED_MS
from napari_elsplus.processing.analysis.line_profiles import line_profiles
from napari_elsplus.processing.images.sectioning import Mode, Sectioner
from napari_elsplus.widgets.analysis.compare import BLINK, DIFFERENCE, ComparePanel
from napari_elsplus.widgets.shared.window.main_window import main_window
from pairs import calibration, frames, write_pair

PLUGIN = "napari-elsplus"
LONG_MS = 60_000
OURS = ["compare LS", "compare ELSA", "compare ELS+", "compare titles", "compare line"]


@pytest.fixture
def panel(viewer, tmp_path, qtbot):
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    qtbot.wait(3 * SETTLED_MS)  # the view is fitted
    _, widget = viewer.window.add_plugin_dock_widget(PLUGIN, "Compare")
    return widget


def state(viewer):
    camera = viewer.scene.camera
    return [(layer.name, layer.visible) for layer in viewer.layers], tuple(camera.center), camera.zoom


def press(panel, qtbot):
    """Press the button that begins or ends, and wait until what it began is there."""
    panel.start.native.click()
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=LONG_MS)


def names(viewer):
    return [layer.name for layer in viewer.layers if layer.name.startswith("compare")]


def test_three_images_appear_and_everything_is_as_before_at_the_end(viewer, panel, qtbot):
    viewer.layers["scan LS"].visible = True
    viewer.scene.camera.zoom = 3.21
    before = state(viewer)
    press(panel, qtbot)
    assert names(viewer) == OURS
    assert not any(layer.visible for layer in viewer.layers if layer.name.startswith("scan"))
    lefts = [layer.translate[2] for layer in panel.display.images]
    assert np.all(np.diff(lefts) > 2.0 * panel.display.images[0].data.shape[2])
    press(panel, qtbot)
    assert state(viewer) == before


def test_a_comparison_is_of_one_frame_also_where_three_dimensions_were_displayed(viewer, panel, qtbot):
    """Before: all frames were read, and projected onto each other beside the numbers of one."""
    viewer.layers["scan ELS+"].visible = False
    viewer.dims.ndisplay = 3
    before = state(viewer)
    press(panel, qtbot)
    assert viewer.dims.ndisplay == 2
    viewer.dims.ndisplay = 3
    assert viewer.dims.ndisplay == 2, "nor later"
    press(panel, qtbot)
    assert viewer.dims.ndisplay == 3
    assert state(viewer) == before


def test_what_cannot_be_compared_is_not_selected(viewer, panel, qtbot):
    """Before: the core filter that needs a flat field stayed selected above images without any filter."""
    press(panel, qtbot)
    panel.cores.value = "gaussian"
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=LONG_MS)
    assert "needs a flat field" in problems.newest
    assert names(viewer) == OURS
    assert panel.cores.value == "none"
    panel.view.value = BLINK
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=LONG_MS)
    assert (panel.cores.value, panel.view.value, panel.recording.value) == ("none", BLINK, "scan raw")
    problems.dismiss()


def test_the_window_answers_between_the_layers(viewer, panel, qtbot):
    """Before: the window stood still until all layers were there, and longer until they were gone."""
    events = []
    ticks = QTimer(panel)
    ticks.timeout.connect(lambda: events.append("tick"))
    ticks.start(0)
    for emitter in (viewer.layers.events.inserted, viewer.layers.events.removed):
        emitter.connect(lambda _: events.append("layer"))
    press(panel, qtbot)
    press(panel, qtbot)
    ticks.stop()
    assert events.count("layer") == 2 * len(OURS)
    assert "layer layer" not in " ".join(events)


@pytest.mark.parametrize("moment", ["hidden", "inserted", "removed"])
def test_the_window_closes_while_a_comparison_begins_or_ends(make_napari_viewer, tmp_path, qtbot, moment):
    own, closed = make_napari_viewer(), []
    own.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    _, widget = own.window.add_plugin_dock_widget(PLUGIN, "Compare")
    qtbot.waitUntil(lambda: main_window(widget) is not None)
    if moment == "removed":
        press(widget, qtbot)
    close = lambda: closed or (closed.append(True), own.close())  # noqa: E731
    layers = own.layers.events
    hidden = own.layers["scan ELS+"].events.visible
    emitters = {"hidden": hidden, "inserted": layers.inserted, "removed": layers.removed}
    emitters[moment].connect(lambda _: QTimer.singleShot(0, close))
    with qtbot.captureExceptions() as errors:
        widget.start.native.click()
        qtbot.waitUntil(lambda: bool(closed), timeout=LONG_MS)
        qtbot.wait(200)
    assert errors == []
    assert not widget.display.images
    assert names(own) == []


def test_a_recording_that_is_opened_meanwhile_is_displayed_at_the_end(viewer, panel, qtbot, tmp_path):
    """Before: it lay over the compared images."""
    press(panel, qtbot)
    viewer.open(str(write_pair(tmp_path, name="next")), plugin=PLUGIN)
    mine = viewer.add_points([[1.0, 1.0]], name="mine")
    assert [layer.name for layer in viewer.layers if layer.visible] == [*OURS, "mine"]
    press(panel, qtbot)
    assert {layer.name for layer in viewer.layers if layer.visible} == {"scan ELS+", "next ELS+", "mine"}
    assert mine in viewer.layers


def test_one_slider_moves_all_and_the_numbers_follow(viewer, panel, qtbot):
    press(panel, qtbot)
    sectioner = Sectioner(calibration(), (64, 128))
    for step in (2, 4):
        viewer.dims.set_current_step(0, step)
        ls, _, els = (np.asarray(layer.data[step]) for layer in panel.display.images)
        np.testing.assert_array_equal(els, sectioner.els(frames()[step]))
        qtbot.waitUntil(lambda ls=ls: np.array_equal(panel.plot.curves[0].y, profile(panel, ls)), timeout=LONG_MS)
        assert [curve.name for curve in panel.plot.curves] == ["LS", "ELSA", "ELS+"]
    assert "contrast" in panel.numbers.text()


def profile(panel, image):
    return line_profiles({Mode.LS: image}, *panel.display.line, 2.0).values[Mode.LS]


def test_a_line_drawn_on_any_image_is_laid_across_all_and_averaged_over_its_width(viewer, panel, qtbot):
    press(panel, qtbot)
    before, line = panel.display.line, viewer.layers["compare line"]
    line.add_lines(np.array([[10, 12], [11, 13]]))
    assert panel.display.line == before, "a stray click draws no line"
    assert len(line.data) == 3
    side = panel.display.images[0].data.shape[2]
    third = 2 * (side + 20)
    line.add_lines(np.array([[10, third + 12], [40, third + 30]]))
    assert panel.display.line == ((10, 12), (40, 30))
    assert len(set(line.edge_width)) == 1
    assert [np.asarray(one)[0].tolist() for one in line.data] == [[10, 12], [10, side + 32], [10, third + 12]]
    qtbot.waitUntil(lambda: len(panel.plot.curves[0].x) == 36, timeout=LONG_MS)
    wide = panel.plot.curves[0].y
    panel.line_width.value = 1
    narrow = panel.plot.curves[0].y
    assert np.var(np.diff(narrow)) > np.var(np.diff(wide))


def test_scaling_filter_and_view_change_while_comparing(viewer, panel, qtbot):
    press(panel, qtbot)
    ls, elsa, els = panel.display.images
    assert elsa.contrast_limits == els.contrast_limits
    panel.scaling.value = "shared"
    assert ls.contrast_limits == elsa.contrast_limits == els.contrast_limits
    panel.scaling.value = "individual"
    assert elsa.contrast_limits != els.contrast_limits

    viewer.dims.set_current_step(0, 3)
    before = np.asarray(els.data[3])
    panel.cores.value = "median"
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=LONG_MS)
    assert viewer.dims.current_step[0] == 3
    assert names(viewer) == OURS
    assert not np.array_equal(np.asarray(panel.display.images[2].data[3]), before)

    panel.cores.value = "none"
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=LONG_MS)
    panel.view.value = DIFFERENCE
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=LONG_MS)
    removed, moved = panel.display.images
    sectioner, raw = Sectioner(calibration(), (64, 128)), frames()
    np.testing.assert_allclose(np.asarray(removed.data[1]), sectioner.residual(raw[1]), atol=1e-4)
    expected = sectioner.elsa(raw[1], raw[2]).copy() - sectioner.els(raw[1])
    np.testing.assert_allclose(np.asarray(moved.data[1]), expected, atol=1e-4)
    assert removed.contrast_limits[0] == -removed.contrast_limits[1]


def test_blinking_shows_one_after_the_other_in_one_place_with_its_title_alone(panel, qtbot):
    panel.view.value = BLINK
    press(panel, qtbot)
    seen = set()

    def all_seen():
        lit = [layer.name for layer in panel.display.images if layer.visible]
        assert len(lit) == 1
        titles = [str(text) for text in panel.viewer.layers["compare titles"].text.values if text]
        assert titles == [lit[0].removeprefix("compare ")]
        seen.update(lit)
        return len(seen) == 3

    qtbot.waitUntil(all_seen, timeout=LONG_MS)
    assert len({tuple(layer.translate) for layer in panel.display.images}) == 1


def test_a_filter_that_needs_a_flat_field_is_one_notification_and_no_half_made_layers(viewer, panel, said, qtbot):
    before = state(viewer)
    panel.cores.value = "interpolate"
    press(panel, qtbot)
    assert state(viewer) == before
    ((severity, message),) = said()
    assert severity == "error"
    assert "flat field" in message
    assert not panel.comparing
    panel.cores.value = "none"
    press(panel, qtbot)
    assert problems.newest == ""
    panel.cores.value = "interpolate"
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=LONG_MS)
    assert panel.comparing
    assert "flat field" in problems.newest, "until an action of the user succeeds"
    problems.dismiss()


def test_a_comparison_that_is_cancelled_changes_nothing(viewer, panel, qtbot):
    before = state(viewer)
    panel.start.native.click()
    assert not panel.start.enabled
    assert "first images" in panel.numbers.text()
    panel.work.cancel()
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=LONG_MS)
    assert not panel.comparing
    assert state(viewer) == before
    assert panel.start.enabled
    assert "select a recording" in panel.numbers.text()


def test_a_plot_that_cannot_be_written_is_one_notification(panel, qtbot, said, tmp_path, monkeypatch):
    press(panel, qtbot)
    monkeypatch.setattr("qtpy.QtWidgets.QFileDialog.getSaveFileName", lambda *_: (str(tmp_path / "no" / "p.csv"), ""))
    panel.save.native.click()
    ((severity, message),) = said()
    assert severity == "error"
    assert "there is no folder" in message


def test_taking_one_of_its_layers_away_ends_it(viewer, panel, qtbot):
    before = state(viewer)
    press(panel, qtbot)
    viewer.layers.remove("compare LS")
    qtbot.waitUntil(lambda: not panel.comparing, timeout=LONG_MS)
    assert state(viewer) == before
    press(panel, qtbot)
    viewer.layers.remove("scan raw")
    qtbot.waitUntil(lambda: not panel.comparing, timeout=LONG_MS)
    assert names(viewer) == []


@pytest.mark.parametrize("what", ["selected", "all"])
def test_taking_several_layers_away_at_once_ends_it(viewer, panel, qtbot, what):
    press(panel, qtbot)
    if what == "selected":
        viewer.layers.selection = {viewer.layers[name] for name in ("compare LS", "compare ELSA", "scan residual")}
        viewer.layers.remove_selected()
    else:
        viewer.layers.clear()
    qtbot.waitUntil(lambda: not panel.comparing, timeout=LONG_MS)
    left = ["scan raw", "scan LS", "scan ELSA", "scan ELS+"] if what == "selected" else []
    assert [layer.name for layer in viewer.layers] == left
    assert panel.start.enabled == bool(left)


def test_a_renamed_recording_stays_selected(viewer, panel, qtbot):
    viewer.layers["scan raw"].name = "mine"
    assert panel.recording.value == "mine"
    press(panel, qtbot)
    assert names(viewer) == OURS
    viewer.layers["mine"].name = "yours"
    viewer.layers["compare LS"].name = "left"
    panel.cores.value = "median"
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=LONG_MS)
    assert names(viewer) == OURS
    panel.script.native.click()
    assert "scan.tif" in QApplication.clipboard().text()
    press(panel, qtbot)
    assert panel.recording.value == "yours"


def test_the_window_closes_while_comparing(make_napari_viewer, tmp_path, qtbot):
    viewer = make_napari_viewer()
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    _, panel = viewer.window.add_plugin_dock_widget(PLUGIN, "Compare")
    press(panel, qtbot)
    viewer.close()
    qtbot.wait(200)


def test_only_recordings_with_a_calibration_are_offered(viewer, panel, tmp_path):
    (tmp_path / "bare").mkdir()
    tifffile.imwrite(tmp_path / "bare" / "bare.tif", frames())
    viewer.open(str(tmp_path / "bare" / "bare.tif"), plugin=PLUGIN)
    assert list(panel.recording.choices) == ["scan raw"]
    for name in ("scan raw", "bare raw"):
        viewer.layers.remove(name)
    assert not panel.start.enabled
    assert "Open Sample" in panel.start.tooltip


def test_scripts_plots_and_themes(viewer, panel, tmp_path, qtbot):
    panel.script.native.click()
    text = QApplication.clipboard().text()
    assert str(tmp_path / "scan.tif") in text
    compile(text, "script", "exec")

    press(panel, qtbot)
    panel.plot.save(tmp_path / "p.png")
    panel.plot.save(tmp_path / "p.csv")
    assert (tmp_path / "p.png").read_bytes()[:4] == b"\x89PNG"
    header, first, *_ = (tmp_path / "p.csv").read_text(encoding="utf-8").splitlines()
    assert header == "position along the line / µm,LS,ELSA,ELS+"
    assert len(first.split(",")) == 4

    for theme, ink in (("light", "#0072b2"), ("dark", "#56b4e9")):
        viewer.theme = theme
        assert panel.plot.colour("blue") == ink
        assert ink in panel.numbers.text()
        blue = np.array([int(ink[k : k + 2], 16) for k in (1, 3, 5)]) / 255
        np.testing.assert_allclose(viewer.layers["compare titles"].text.color.array[0][:3], blue, atol=1e-6)


def test_closing_the_dock_ends_the_comparison_and_leaves_nothing(viewer, tmp_path, qtbot):
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    qtbot.waitUntil(lambda: viewer.canvas.overlays.scale_bar.visible)  # fitted to the canvas
    before = state(viewer)
    dock, panel = viewer.window.add_plugin_dock_widget(PLUGIN, "Compare")
    assert isinstance(panel, ComparePanel)
    press(panel, qtbot)
    gone = weakref.ref(panel)
    viewer.window.remove_dock_widget(panel)
    assert state(viewer) == before
    del panel, dock
    QApplication.processEvents()
    gc.collect()
    QApplication.processEvents()
    gc.collect()
    assert gone() is None


def test_the_line_survives_a_change_of_view(panel, qtbot):
    press(panel, qtbot)
    panel.display.set_line((10.0, 12.0), (40.0, 30.0))
    for view in (BLINK, DIFFERENCE):
        panel.view.value = view
        qtbot.waitUntil(lambda: not panel.work.busy, timeout=LONG_MS)
        assert panel.display.line == ((10, 12), (40, 30))


def test_the_figure_is_saved_as_it_is_displayed(panel, qtbot, tmp_path):
    assert "start the comparison" in panel.save_figure.tooltip
    press(panel, qtbot)
    panel.display.set_line((10.0, 12.0), (40.0, 30.0))
    panel.line_width.value = 3
    for suffix in ("png", "pdf", "svg"):
        path = tmp_path / f"figure.{suffix}"
        panel.save_figure_to(path)
        assert not panel.save_figure.enabled
        qtbot.waitUntil(lambda: not panel.work.busy, timeout=LONG_MS)
        assert path.stat().st_size > 5000
        assert [one.name for one in tmp_path.iterdir() if "figure" in one.name] == [path.name]
        path.unlink()
