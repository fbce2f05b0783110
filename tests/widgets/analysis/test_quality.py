"""The Quality panel, driven as a user drives it."""

from __future__ import annotations

import gc
import weakref
from threading import Event

import numpy as np
import pytest
from qtpy.QtWidgets import QApplication

from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import write_calibration
from napari_elsplus.widgets.analysis.quality import EDGE, measure_edge
from pairs import CONTENT, write_pair

PLUGIN = "napari-elsplus"


@pytest.fixture
def panel(viewer, tmp_path):
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    _, widget = viewer.window.add_plugin_dock_widget(PLUGIN, "Quality")
    return widget


def mark(panel, qtbot):
    panel.mark.native.click()
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)


def test_alignment_is_told_of_the_frame_that_is_shown(viewer, panel):
    told = []
    for step in (0, 4):
        viewer.dims.set_current_step(0, step)
        panel.align.native.click()
        told.append(panel.alignment)
        assert f"{100 * panel.alignment.before:.2f} %" in panel.numbers.text()
    assert told[0] != told[1]


def test_elements_are_measured_as_they_are_drawn(viewer, panel, qtbot):
    panel.align.native.click()
    mark(panel, qtbot)
    assert "draw a box" in panel.numbers.text(), "beside the alignment"
    boxes = viewer.layers["quality elements"]
    assert boxes.mode == "add_rectangle"
    boxes.add_rectangles(np.array([[10, 10], [30, 30]]))
    assert panel.boxes_px == [(10, 10, 30, 30)]
    assert "draw a box" not in panel.numbers.text()
    (one,) = panel.resolution.elements
    assert f"{one.group}-{one.element}" in panel.numbers.text()
    ls = viewer.layers["scan LS"]
    np.testing.assert_allclose(boxes.translate, ls.translate[1:])
    np.testing.assert_allclose(boxes.scale, ls.scale[1:])
    boxes.selected_data = {0}
    boxes.remove_selected()
    assert panel.resolution is None
    viewer.layers.remove(boxes)
    mark(panel, qtbot)
    assert "quality elements" in viewer.layers


def test_the_edge_map_becomes_a_layer_and_a_plot(viewer, panel, qtbot, tmp_path):
    assert not panel.save.enabled
    for _ in range(2):
        panel.average.native.click()
        assert not panel.average.enabled
        qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    assert [layer.name for layer in viewer.layers].count(EDGE) == 1
    assert viewer.layers[EDGE].name_overlay.visible
    np.testing.assert_allclose(viewer.layers[EDGE].translate, viewer.layers["scan LS"].translate[1:])
    panel.plot.save(tmp_path / "edge.csv")
    assert len((tmp_path / "edge.csv").read_text().splitlines()) == 1 + len(panel.edge.profile)
    for theme in ("light", "dark"):
        viewer.theme = theme


def test_what_cannot_be_done_is_one_notification(viewer, panel, qtbot, said):
    mark(panel, qtbot)
    viewer.layers["quality elements"].add_rectangles(np.array([[10, 10], [30, 30]]))
    panel.cores.value = "interpolate"
    ((severity, message),) = said()
    assert (severity, "flat field" in message) == ("error", True)
    viewer.layers.remove("scan raw")
    assert not any(button.enabled for button in (panel.align, panel.mark, panel.average, panel.script))


def test_the_script_names_the_files_and_closing_leaves_nothing(viewer, tmp_path, qtbot):
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    dock, panel = viewer.window.add_plugin_dock_widget(PLUGIN, "Quality")
    mark(panel, qtbot)
    viewer.layers["quality elements"].add_rectangles(np.array([[10, 10], [30, 30]]))
    panel.script.native.click()
    text = QApplication.clipboard().text()
    assert str(tmp_path / "scan.tif") in text
    assert "(10.0, 10.0, 30.0, 30.0)" in text
    compile(text, "script", "exec")
    gone = weakref.ref(panel)
    viewer.window.remove_dock_widget(panel)
    del panel, dock
    for _ in range(2):
        QApplication.processEvents()
        gc.collect()
    assert gone() is None


def test_the_alignment_error_follows_the_recording_and_names_it(viewer, panel, tmp_path):
    viewer.open(str(write_pair(tmp_path, 5, "other")), plugin=PLUGIN)
    panel.recording.value = "scan raw"
    panel.align.native.click()
    assert "Alignment error</b> of scan raw, frame" in panel.numbers.text()
    panel.recording.value = "other raw"
    assert "Alignment error</b> of other raw, frame" in panel.numbers.text()
    viewer.layers.remove("other raw")
    assert "Alignment error</b> of scan raw, frame" in panel.numbers.text()
    viewer.layers.remove("scan raw")
    assert "Alignment error" not in panel.numbers.text()


def test_the_boxes_lie_on_the_same_pixels_of_the_recording_that_is_chosen(viewer, panel, tmp_path, qtbot):
    mark(panel, qtbot)
    boxes = viewer.layers["quality elements"]
    boxes.add_rectangles(np.array([[10, 10], [30, 30]]))
    path = write_pair(tmp_path, name="coarse")
    bundle = {**CONTENT["bundle"], "confocal_centre": [31.0, 32.0]}
    coarse = {**CONTENT, "bundle": bundle, "optics": {**CONTENT["optics"], "um_per_px": 4.0}}
    write_calibration(tmp_path / "coarse.calibration.json", Calibration.parse(coarse), force=True)
    viewer.open(str(path), plugin=PLUGIN)
    line_pair_um = panel.resolution.elements[0].line_pair_um
    for name, um_per_px in (("coarse", 4.0), ("scan", 2.0)):
        panel.recording.value = f"{name} raw"
        images = viewer.layers[f"{name} LS"]
        np.testing.assert_allclose(boxes.scale, [um_per_px, um_per_px])
        np.testing.assert_allclose(boxes.translate, images.translate[1:])
        assert panel.boxes_px == [(10, 10, 30, 30)]
    assert panel.resolution.elements[0].line_pair_um == line_pair_um


def test_an_edge_map_is_not_displayed_under_another_recording(viewer, panel, tmp_path, qtbot, monkeypatch):
    viewer.open(str(write_pair(tmp_path, 5, "other")), plugin=PLUGIN)
    computed, chosen = Event(), Event()

    def late(*given):
        edge = measure_edge(*given)
        computed.set()
        assert chosen.wait(20)
        return edge

    monkeypatch.setattr("napari_elsplus.widgets.analysis.quality.measure_edge", late)
    panel.average.native.click()
    qtbot.waitUntil(computed.is_set, timeout=60_000)
    panel.recording.value = next(name for name in panel.recording.choices if name != panel.recording.value)
    chosen.set()
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    assert EDGE not in viewer.layers
    assert panel.edge is None
    assert not panel.plot.curves
    assert panel.average.enabled
    panel.average.native.click()
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    assert EDGE in viewer.layers


def test_a_renamed_recording_stays_selected_with_its_results(viewer, panel, tmp_path, qtbot):
    viewer.open(str(write_pair(tmp_path, 5, "other")), plugin=PLUGIN)
    panel.recording.value = "other raw"
    panel.align.native.click()
    panel.average.native.click()
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    edge = panel.edge
    other = viewer.layers["other raw"]
    for name in ("mine", "scan raw"):  # napari makes the second one unique
        other.name = name
        assert panel.recording.value == other.name != "other raw"
        assert f"Alignment error</b> of {other.name}, frame" in panel.numbers.text()
        assert panel.edge is edge
        panel.script.native.click()
        assert "other.tif" in QApplication.clipboard().text()
    viewer.layers["scan raw"].name = "other raw"  # another one under the former name
    assert panel.recording.value == other.name
    viewer.layers.remove(other)
    assert panel.recording.value == "other raw"
