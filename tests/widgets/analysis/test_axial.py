"""The Axial response panel, driven as a user drives it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from napari.layers import Image

from depth_scan import DEPTH_UM, calibration, frames
from napari_elsplus._problems import problems
from napari_elsplus.io import write_calibration, write_column, write_images
from napari_elsplus.processing.axial.axial_response import axial_response
from napari_elsplus.viewing.axial import Scan
from napari_elsplus.widgets.analysis.axial import MANUAL, SIMULATED, STACK
from napari_elsplus.workflows import simulated

PLUGIN = "napari-elsplus"


@pytest.fixture
def panel(viewer):
    _, widget = viewer.window.add_plugin_dock_widget(PLUGIN, "Axial response")
    return widget


@pytest.fixture
def scan_file(tmp_path):
    write_images(tmp_path / "scan.tif", frames())
    write_column(tmp_path / "scan.depths.csv", "depth_um", DEPTH_UM)
    write_calibration(tmp_path / "scan.calibration.json", calibration())
    return tmp_path / "scan.tif"


def test_a_stack_is_measured_beside_the_window_and_saved(viewer, panel, scan_file, qtbot, tmp_path):
    assert not panel.measure.enabled
    assert "depths.csv" in panel.measure.tooltip
    viewer.open(str(scan_file), plugin=PLUGIN)
    before = [(layer.name, layer.visible) for layer in viewer.layers]
    panel.measure.native.click()
    assert panel.work.busy
    assert not panel.measure.enabled
    assert panel.numbers.text() == ""
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    assert [(layer.name, layer.visible) for layer in viewer.layers] == before
    (scan,) = panel.scans
    assert scan.response.els_3db.um == pytest.approx(30, rel=0.02)
    assert [curve.name for curve in panel.plot.curves] == ["LS", "residual", "ELS+"]
    assert "30.0 ±" in panel.numbers.text()
    assert "record the scan there and back" in panel.numbers.text()
    assert " um" not in panel.numbers.text()

    for ending in ("json", "csv", "png"):
        panel.save_to(tmp_path / f"out.{ending}")
    content = json.loads((tmp_path / "out.json").read_text())
    assert content["els"]["drop_3db_um"] == scan.response.els_3db.um
    assert content["offset_um"] == 20.0
    header = (tmp_path / "out.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header == "distance from contact / µm,LS,residual,ELS+"
    panel.clear.native.click()
    assert panel.scans == []
    assert not panel.save.enabled


def test_frames_are_taken_by_hand_at_the_depths_that_are_set(viewer, panel, scan_file, said):
    viewer.open(str(scan_file), plugin=PLUGIN)
    panel.source.value = MANUAL
    panel.depth_step.value = 10
    for k in range(4):
        viewer.dims.set_current_step(0, k)
        assert panel.depth_now.value == 10 * k
        panel.take.native.click()
    (scan,) = panel.scans
    np.testing.assert_array_equal(scan.response.depth_um, DEPTH_UM[:4])
    assert scan.response.ls[3] == pytest.approx(60 / 90, rel=1e-3)
    assert np.isnan(scan.response.els_10db.um)
    assert "beyond" in panel.numbers.text()
    assert said() == []


def test_an_unsaved_manual_scan_is_discarded_only_if_the_user_agrees(viewer, panel, scan_file, questions, tmp_path):
    """Before: closing the window or Clear discarded it, and the plate would have to be moved through again."""
    viewer.window.show()
    viewer.open(str(scan_file), plugin=PLUGIN)
    panel.source.value = MANUAL
    assert "Add frame" in panel.numbers.text()
    panel.take.native.click()
    questions.answer = False
    panel.clear_scans()
    panel.window().close()
    assert questions == ["The manual scan was not saved. Discard it?"] * 2
    assert "1 of at least 3" in panel.numbers.text()
    for k in (1, 2):
        viewer.dims.set_current_step(0, k)
        panel.take.native.click()
    panel.save_to(tmp_path / "scan.json")
    panel.clear.native.click()
    assert len(questions) == 2
    assert panel.scans == []


def test_the_next_action_can_be_done(viewer, panel, scan_file):
    """Before: it was to measure a scan, whose button was disabled."""
    for source, action in ((STACK, "open a scan"), (MANUAL, "open a recording"), (SIMULATED, "Simulate and measure")):
        panel.source.value = source
        assert action in panel.numbers.text()
    viewer.open(str(scan_file), plugin=PLUGIN)
    for source, action in ((STACK, "press Measure"), (MANUAL, "press Add frame")):
        panel.source.value = source
        assert action in panel.numbers.text()


def test_the_newest_frames_are_chosen_until_one_is_added_and_each_is_added_once(viewer, panel, scan_file, said):
    """Before: a recording that was open first stayed chosen while live images were displayed, and its one frame was
    added at every depth without a word.
    """
    panel.source.value = MANUAL
    viewer.open(str(scan_file), plugin=PLUGIN)
    assert panel.live.value == "scan raw"
    facts = {"kind": "live raw", "calibration": calibration()}
    viewer.layers.append(Image(frames()[2], name="live raw", metadata={"elsplus": facts}))
    assert panel.live.value == "live raw"
    for _ in range(2):
        panel.take.native.click()
    assert "1 of at least 3" in panel.numbers.text()
    assert next(message for severity, message in said() if severity == "error").startswith("this frame was added at 0")
    assert panel.depth_now.value == panel.depth_step.value
    viewer.open(str(scan_file), plugin=PLUGIN)
    assert panel.live.value == "live raw"


def test_a_live_image_is_a_single_frame(viewer, panel):
    live = Image(frames()[2], name="live raw", metadata={"elsplus": {"kind": "raw", "calibration": calibration()}})
    viewer.layers.append(live)
    panel.source.value = MANUAL
    panel.take.native.click()
    assert "1 of at least 3" in panel.numbers.text()
    live.data = frames()[2][:50]
    panel.take.native.click()
    assert "1 of at least 3" in panel.numbers.text()


def test_a_frame_that_does_not_fit_is_one_notification(viewer, panel, said):
    metadata = {"elsplus": {"kind": "raw", "calibration": calibration()}}
    viewer.layers.append(Image(np.zeros((50, 60), np.uint8), name="live raw", metadata=metadata))
    panel.source.value = MANUAL
    panel.take.native.click()
    ((severity, message),) = said()
    assert severity == "error"
    assert "300 x 640" in message


def test_a_simulated_scan_can_be_cancelled(panel, qtbot):
    panel.source.value = SIMULATED
    panel.simulate.native.click()
    assert panel.work.busy
    panel.work.cancel()
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    assert panel.scans == []
    assert panel.simulate.enabled


def test_several_simulated_scans_are_drawn_against_the_offset(panel, qtbot, monkeypatch):
    monkeypatch.setattr(simulated, "scan_depths_um", lambda: np.array([0.0, 20, 60]))
    panel.source.value = SIMULATED
    for offset_um in (20, 40):
        panel.offset.value = offset_um
        panel.simulate.native.click()
        qtbot.waitUntil(lambda: not panel.work.busy, timeout=40_000)
    assert [round(scan.offset_um) for scan in panel.scans] == [20, 40]

    depth = np.arange(0.0, 600, 2)
    ls = 1 / (1 + depth / 60)
    panel.scans.clear()
    for offset_um in (12.0, 29.0, 58.0):
        els = 1 / (1 + (depth / (58 * (1 - np.exp(-offset_um / 30)))) ** 2)
        panel.scans.append(Scan(f"<{offset_um}", axial_response(depth, ls, ls - els), offset_um, 2.9))
    panel.shown.value = "slit offset"
    three, _, *fits = panel.plot.curves
    np.testing.assert_array_equal(three.x, [12, 29, 58])
    assert fits[0].name.startswith("3 dB fit: 58")
    panel.shown.value = "signal and depth"
    assert len(panel.plot.curves) == 5
    assert "&lt;58.0" in panel.numbers.text()
    panel.scans.clear()
    panel.scans.append(Scan("of an unknown slit", axial_response(depth, ls, 0.5 * ls), None, None))
    panel.show_scans()
    panel.shown.value = "slit width"
    assert "slit width is known" in problems.newest
    assert panel.plot.curves == (), "before: another plot remained"
    problems.dismiss()
    assert STACK in panel.source.choices


def test_a_renamed_stack_stays_selected(viewer, panel, scan_file, qtbot):
    viewer.open(str(scan_file), plugin=PLUGIN)
    viewer.layers["scan raw"].name = "mine"
    assert panel.stack.value == panel.live.value == "mine"
    panel.measure.native.click()
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    assert len(panel.scans) == 1
    panel.source.value = MANUAL
    panel.take.native.click()
    assert "1 of at least 3 depths" in panel.numbers.text()
