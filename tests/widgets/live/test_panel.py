"""The Rig and Live panels, driven as a user drives them, on an engine in a process of its own."""

from __future__ import annotations

import os
import re
import signal
import sys
import time
from concurrent.futures import Future
from datetime import datetime
from pathlib import Path
from threading import Event

import numpy as np
import pint
import pytest
from pint.registry import LazyRegistry
from qtpy.QtCore import Qt
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication, QLineEdit, QWidget

import pairs
from napari_elsplus._problems import problems
from napari_elsplus.acquisition.engine.live_images import display_layout
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.link.client import EngineClient
from napari_elsplus.acquisition.streaming.ring import Ring
from napari_elsplus.errors import CancelledError, DeviceError, InputError
from napari_elsplus.hardware.protocols import FrameInfo
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import open_recording, read_calibration, write_calibration
from napari_elsplus.io.settings import active_calibration, recall, remember
from napari_elsplus.processing.calibration.draft import Draft
from napari_elsplus.processing.calibration.scan.lag import ScanLag
from napari_elsplus.processing.calibration.steps import GALVO
from napari_elsplus.widgets.dock.status_line import StatusLine
from napari_elsplus.widgets.live.form import CONTINUOUS, DEFAULT_LIMIT_S, LiveForm
from napari_elsplus.widgets.live.layers import LiveLayers, import_ahead
from napari_elsplus.widgets.live.panel import LivePanel
from napari_elsplus.widgets.shared.calibration_state import AMBER
from napari_elsplus.widgets.shared.connection import join
from processes import exists
from small_rig import SmallRig, small_calibration

PLUGIN = "napari-elsplus"


@pytest.fixture
def viewer(small_engine, make_napari_viewer_proxy):
    return make_napari_viewer_proxy()


def images(viewer):
    return [layer for layer in viewer.layers if layer.name != "live titles"]


def ended(panel):
    recording = panel.connection.client.status.recording
    return recording is not None and not recording.running


def start(panel, qtbot):
    panel.form.start.native.click()
    qtbot.waitUntil(
        lambda: (
            panel.live and panel._arranged is not None and panel.form.snapping.enabled and panel.form.record.enabled
        ),
        timeout=30_000,
    )


def stop(panel, qtbot):
    panel.form.start.native.click()
    qtbot.waitUntil(lambda: not panel.live and not panel.requests.busy, timeout=30_000)


def test_live_layers_fill_and_are_kept_as_the_user_has_set_them(viewer, panel, qtbot):
    before = viewer.add_image(np.ones((40, 60)), name="before")
    start(panel, qtbot)
    els = viewer.layers["live ELS+"]
    qtbot.waitUntil(lambda: np.abs(els.data).max() > 1, timeout=30_000)
    assert [layer.name for layer in viewer.layers if layer.visible] == ["live LS", "live ELS+", "live titles"]
    assert list(viewer.layers["live titles"].text.values) == ["LS", "ELS+"]
    viewer.layers.remove(before)
    assert els.scale == pytest.approx([1.33, 1.33])
    assert els.translate[1] > 466 * 1.33
    els.colormap, els.contrast_limits = "magenta", (3, 77)
    viewer.scene.camera.zoom = 2.5
    stop(panel, qtbot)
    start(panel, qtbot)
    qtbot.wait(200)
    assert len(images(viewer)) == 2
    assert els in viewer.layers
    assert (els.colormap.name, tuple(els.contrast_limits), viewer.scene.camera.zoom) == ("magenta", (3, 77), 2.5)
    panel.form.contrast.value = CONTINUOUS
    qtbot.waitUntil(lambda: tuple(els.contrast_limits) != (3, 77), timeout=30_000)
    facts = els.metadata["elsplus"]
    assert facts["calibration"] is panel.connection.client.calibration
    assert (facts["rig"], facts["kind"]) == ("simulated", "live els")
    assert facts["software"].startswith("napari-elsplus ")
    assert datetime.fromisoformat(facts["displayed_since"]).tzinfo is not None


def test_two_viewers_display_one_stream_which_goes_on_when_one_is_closed(
    viewer, panel, make_napari_viewer_proxy, qtbot
):
    other = make_napari_viewer_proxy()
    _, second = other.window.add_plugin_dock_widget(PLUGIN, "Live")
    assert second is not panel
    start(panel, qtbot)
    qtbot.waitUntil(lambda: "live ELS+" in other.layers and second.form.start.text == "Stop", timeout=30_000)
    stop(second, qtbot)
    assert not panel.live
    start(second, qtbot)
    other.close()
    qtbot.wait(300)
    displayed = panel.layers._last_sequence
    qtbot.waitUntil(lambda: panel.live and panel.layers._last_sequence > displayed, timeout=30_000)
    stop(panel, qtbot)


def test_remembered_values_that_a_field_does_not_take_leave_its_default(viewer):
    """Before: the panel did not open."""
    remember("live", cores="octagonal", average=900, kinds=3, seconds=5.0, folder=7)
    remember("mosaic", method="sextant", insertion="feathered", modes=3)
    forms = [viewer.window.add_plugin_dock_widget("napari-elsplus", name)[1].form for name in ("Live", "Mosaic")]
    assert (forms[0].cores.value, forms[0].average.value, forms[0].chosen) == ("none", 1, ["ls", "els"])
    assert forms[0].seconds.value == 5.0
    assert (forms[1].method.value, forms[1].insertion.value, forms[1].plan.modes) == ("elsplus", "feathered", ("els",))


def test_a_panel_that_is_deleted_before_it_was_found_docked_ends_its_engine(viewer, qtbot):
    """Before: the engine of the next window's panels was not ended with them, since this one was still counted."""
    panel = LivePanel(viewer)
    client = panel.connection.connect("simulated", Settings("240hz", frame_rate_hz=100.0))
    panel.deleteLater()
    qtbot.waitUntil(lambda: not exists(client.pid), timeout=30_000)


def test_park_while_a_start_is_prepared_starts_nothing(viewer, panel, qtbot):
    """Before: the galvo was parked, and scanned a moment later."""
    _, rig = viewer.window.add_plugin_dock_widget(PLUGIN, "Rig")
    panel.form.start.native.click()
    rig.park()
    qtbot.waitUntil(lambda: not panel.requests.busy and not rig.requests.busy, timeout=30_000)
    qtbot.wait(300)
    assert not panel.connection.client.status.live
    start(panel, qtbot)
    stop(panel, qtbot)


def test_a_snap_is_one_frame(panel, qtbot, tmp_path):
    start(panel, qtbot)
    panel.form.snapping.native.click()
    qtbot.waitUntil(lambda: list(tmp_path.glob("snap-*.calibration.json")) != [], timeout=30_000)
    qtbot.waitUntil(lambda: ended(panel), timeout=30_000)
    (path,) = tmp_path.glob("snap-*.ome.tif")
    with open_recording(path) as recording:
        assert len(recording) == 1


def test_what_is_shown_follows_the_boxes(viewer, panel, qtbot):
    start(panel, qtbot)
    panel.form.kinds["ls"].value = False
    panel.form.kinds["elsa"].value = True
    qtbot.waitUntil(lambda: "elsa" in panel.layers.images, timeout=30_000)
    assert {layer.name for layer in images(viewer) if layer.visible} == {"live ELS+", "live ELSA"}
    assert list(viewer.layers["live titles"].text.values) == ["ELS+", "ELSA"]
    for box in panel.form.kinds.values():
        box.value = False
    qtbot.waitUntil(lambda: "tick an image" in panel.form.status.text(), timeout=30_000)
    panel.form.kinds["els"].value = panel.form.kinds["elsa"].value = True
    panel.form.side_by_side.value = False
    qtbot.waitUntil(lambda: {layer.translate[1] for layer in images(viewer) if layer.visible} == {0.0}, timeout=30_000)
    assert recall("live")["kinds"] == ["els", "elsa"]


def test_an_image_that_is_removed_while_it_streams_is_unticked(viewer, panel, qtbot):
    """Before: its box stayed ticked, and its title above nothing."""
    start(panel, qtbot)
    viewer.layers.remove(viewer.layers["live LS"])
    qtbot.waitUntil(lambda: not panel.form.kinds["ls"].value, timeout=30_000)
    qtbot.waitUntil(lambda: list(viewer.layers["live titles"].text.values) == ["ELS+"], timeout=30_000)
    assert viewer.layers["live ELS+"].translate[1] == 0
    panel.form.kinds["ls"].value = True
    qtbot.waitUntil(lambda: "live LS" in viewer.layers, timeout=30_000)
    stop(panel, qtbot)
    for layer in images(viewer):
        viewer.layers.remove(layer)
    start(panel, qtbot)
    assert {layer.name for layer in images(viewer)} == {"live LS", "live ELS+"}, "removed between streams"


def test_start_displays_images_after_all_were_removed(viewer, panel, qtbot):
    """Before: none, also in the next session, which remembered that none was ticked."""
    start(panel, qtbot)
    viewer.layers.clear()
    qtbot.waitUntil(lambda: not panel.form.chosen, timeout=30_000)
    qtbot.wait(300)
    assert panel.live
    assert not viewer.layers
    stop(panel, qtbot)
    assert LiveForm(QWidget()).chosen == []
    start(panel, qtbot)
    assert {layer.name for layer in images(viewer)} == {"live LS", "live ELS+"}


def test_a_view_that_cannot_be_made_is_said_and_the_stream_goes_on(panel, qtbot, said):
    start(panel, qtbot)
    panel.form.average.value = 3
    panel.form.flat_field.value = True
    qtbot.waitUntil(lambda: any("no flat field" in words for _, words in said()), timeout=30_000)
    assert panel.live
    qtbot.waitUntil(lambda: not panel.requests.busy, timeout=30_000)
    assert (panel.form.flat_field.value, panel.form.average.value) == (False, 3), "before: ticked above images without"
    assert (recall("live")["flat_field"], recall("live")["average"]) == (False, 3)
    panel.form.cores.value = "gaussian"
    qtbot.waitUntil(lambda: panel.form.cores.value == "none", timeout=30_000)
    stop(panel, qtbot)
    with panel.form.flat_field.changed.blocked():
        panel.form.flat_field.value = True  # as of another session, whose calibration had one
    panel.form.start.native.click()
    qtbot.waitUntil(lambda: not panel.form.flat_field.value, timeout=30_000)
    start(panel, qtbot)


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
def test_a_killed_engine_is_said_once_the_layers_stay_and_it_can_start_again(viewer, panel, qtbot, said, small_engine):
    start(panel, qtbot)
    os.kill(panel.connection.client.pid, signal.SIGKILL)
    qtbot.waitUntil(lambda: any("SIGKILL" in words for _, words in said()), timeout=30_000)
    qtbot.wait(600)
    assert sum("SIGKILL" in words for _, words in said()) == 1
    assert len(images(viewer)) == 2
    panel.form.start.native.click()
    qtbot.waitUntil(lambda: panel.connection.client is not None and not panel.requests.busy, timeout=30_000)
    assert len(small_engine) == 2


def test_keys_start_and_stop(viewer, panel, qtbot):
    viewer.window.show()
    panel.window().activateWindow()
    qtbot.waitUntil(lambda: panel.window().isActiveWindow(), timeout=60_000)
    QTest.keyClick(panel, Qt.Key.Key_Return, Qt.KeyboardModifier.ControlModifier)
    qtbot.waitUntil(lambda: panel.live, timeout=30_000)
    QTest.keyClick(panel, Qt.Key.Key_Return, Qt.KeyboardModifier.ControlModifier)
    qtbot.waitUntil(lambda: not panel.live, timeout=30_000)


def test_a_start_that_is_commanded_twice_or_by_two_panels_connects_once_and_is_displayed(
    viewer, panel, qtbot, small_engine, said, monkeypatch
):
    """Before: the second one closed the engine of the first, which was reported as an error."""
    _, rig = viewer.window.add_plugin_dock_widget(PLUGIN, "Rig")
    viewer.window.show()
    panel.window().activateWindow()
    qtbot.waitUntil(lambda: panel.window().isActiveWindow(), timeout=60_000)
    panel.connection.disconnect()
    may_open = Event()
    monkeypatch.setattr(EngineClient, "open", lambda client, name: (may_open.wait(60), client.call("open", name))[1])
    line = StatusLine()
    qtbot.addWidget(line)
    try:
        for _ in range(2):
            QTest.keyClick(panel, Qt.Key.Key_Return, Qt.KeyboardModifier.ControlModifier)
        qtbot.waitUntil(lambda: not rig.connect.enabled, timeout=60_000)
        assert "Connecting" in rig.status.text()
        line.update_from(panel.connection)
        assert "connecting to simulated" in line.state.text()
    finally:
        may_open.set()
    qtbot.waitUntil(lambda: panel.live, timeout=60_000)
    assert len(small_engine) == 2, "the one of before, and one more"
    assert [message for severity, message in said() if severity == "error"] == []
    line.update_from(panel.connection)
    assert "connecting" not in line.state.text()


def test_the_key_of_one_frame_is_not_that_of_the_command_palette(viewer, panel, qtbot, tmp_path):
    viewer.window.show()
    start(panel, qtbot)
    panel.window().activateWindow()
    qtbot.waitUntil(lambda: panel.window().isActiveWindow(), timeout=60_000)
    assert "Ctrl+Shift+F" in panel.form.snapping.tooltip
    QTest.keyClick(panel, Qt.Key.Key_F, Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier)
    qtbot.waitUntil(lambda: list(tmp_path.glob("snap-*.ome.tif")) != [], timeout=30_000)
    qtbot.waitUntil(lambda: ended(panel), timeout=30_000)


def test_the_rig_panel_connects_sets_up_parks_and_remembers(viewer, qtbot, tmp_path, small_engine, monkeypatch):
    _, panel = viewer.window.add_plugin_dock_widget(PLUGIN, "Rig")
    assert panel.rig.value == "simulated"
    assert not panel.parking.enabled
    panel.connect.native.click()
    qtbot.waitUntil(lambda: panel.connection.client is not None, timeout=60_000)
    panel.slit_rows.value = 5
    qtbot.waitUntil(lambda: not panel.requests.busy, timeout=30_000)
    assert "slit 6.7" in panel.optics.text()
    refused: Future[None] = Future()
    refused.set_exception(InputError("frame rate of 240 Hz", "the camera allows 1 to 120 Hz"))
    with monkeypatch.context() as patch:  # the form displays the settings that hold, and they are remembered
        patch.setattr(panel.connection.client, "configure", lambda _: refused)
        panel.preset.value = "120hz"
        qtbot.waitUntil(lambda: not panel.requests.busy, timeout=30_000)
    assert "the camera allows" in problems.newest
    assert (panel.preset.value, panel.slit_rows.value, recall("rig")["preset"]) == ("240hz", 5, "240hz")
    assert "slit 6.7" in panel.optics.text()
    problems.dismiss()
    panel.parking.native.click()
    log = tmp_path / "mirror.log"
    qtbot.waitUntil(lambda: log.exists() and log.read_text().split()[-1:] == ["park"], timeout=30_000)
    assert recall("rig")["slit_rows"] == 5
    qtbot.waitUntil(lambda: panel.connect.enabled, timeout=30_000)  # the mirror moves before the answer comes
    panel.connect.native.click()
    qtbot.waitUntil(lambda: not exists(small_engine[0].pid), timeout=30_000)
    qtbot.waitUntil(lambda: not panel.requests.busy, timeout=30_000)


def type_into(field, text, qtbot):
    """Replace the number in a field by typing."""
    line = field.native.findChild(QLineEdit)
    qtbot.mouseClick(line, Qt.MouseButton.LeftButton)
    line.selectAll()
    QTest.keyClicks(line, text)
    QTest.keyClick(line, Qt.Key.Key_Return)


def test_numbers_are_applied_whole_once_they_are_typed(viewer, qtbot, small_engine):
    """Before: 120 Hz was first 1 Hz and 12 Hz, and 500 Hz silently became 50 Hz."""
    _, rig = viewer.window.add_plugin_dock_widget(PLUGIN, "Rig")
    rig.connect.native.click()
    rig.refresh()
    assert not rig.rate_hz.enabled, "it would be replaced by the settings of the connected rig"
    qtbot.waitUntil(lambda: rig.connection.client is not None and not rig.requests.busy, timeout=60_000)
    qtbot.waitUntil(lambda: rig.rate_hz.enabled, timeout=30_000)
    applied, configure = [], rig.connection.configure
    rig.connection.configure = lambda settings: (applied.append(settings), configure(settings))[1]
    for field, text in ((rig.rate_hz, "500"), (rig.slit_rows, "12"), (rig.gain_db, "30"), (rig.slit_rows, "120")):
        type_into(field, text, qtbot)
        assert "Applying settings" in rig.status.text()
        qtbot.waitUntil(lambda: not rig.requests.busy, timeout=30_000)
    assert [(one.frame_rate_hz, one.slit_rows, one.gain_db) for one in applied] == [
        (500, 3, 0), (500, 12, 0), (500, 12, 30), (500, 120, 30),
    ]  # fmt: skip
    assert "a slit of 120 rows: choose a smaller one" in problems.newest
    assert rig.settings == Settings("240hz", 12, 500.0, 30.0)


def test_the_settings_that_the_rig_accepts_are_remembered_and_not_those_that_follow(viewer, qtbot, small_engine):
    """Before: the form's were, which may be refused, and were those of the next start."""
    _, rig = viewer.window.add_plugin_dock_widget(PLUGIN, "Rig")
    rig.connection.connect("simulated", Settings("240hz", frame_rate_hz=100.0))
    rig.refresh()
    rig.gain_db.value = 2.0
    rig.slit_rows.value = 9999
    qtbot.waitUntil(lambda: not rig.requests.busy, timeout=30_000)
    assert (recall("rig")["gain_db"], recall("rig")["slit_rows"]) == (2.0, 3)
    assert rig.slit_rows.value == 3


def test_the_offset_is_in_micrometres_of_the_calibration_and_not_of_the_chosen_preset(viewer, small_engine):
    """Before: those of another objective, where the calibration was not of the preset in the form."""
    _, rig = viewer.window.add_plugin_dock_widget(PLUGIN, "Rig")
    calibration = pairs.calibration()
    rig.connection.apply(calibration)
    rows, um_per_px = calibration.offset.rows, calibration.um_per_px
    for name in ("240hz", "120hz"):
        rig.preset.value = name
        rig.refresh()
        assert f"offset {rows:.1f} rows, {rows * um_per_px:.1f} µm" in rig.optics.text()
    rig.connection.apply(calibration.model_copy(update={"optics": None}))
    rig.refresh()
    assert rig.optics.text().endswith(f"offset {rows:.1f} rows")


def test_the_rig_panel_displays_the_settings_by_which_another_panel_connected(viewer, qtbot, small_engine):
    _, rig = viewer.window.add_plugin_dock_widget(PLUGIN, "Rig")
    _, steps = viewer.window.add_plugin_dock_widget(PLUGIN, "Calibration")
    rig.slit_rows.value, rig.rate_hz.value = 9, 30
    steps.form.preset.setCurrentIndex(steps.form.preset.findData("120hz"))
    steps.connect_rig()
    qtbot.waitUntil(lambda: not steps.work.busy and rig.connection.client is not None, timeout=60_000)
    qtbot.waitUntil(lambda: rig.settings == Settings("120hz"), timeout=30_000)
    assert "slit 2.9" in rig.optics.text()
    rig.gain_db.value = 2  # changes nothing else
    qtbot.waitUntil(lambda: not rig.requests.busy, timeout=30_000)
    assert rig.connection.settings == rig.settings == Settings("120hz", gain_db=2.0)
    steps.connect_rig()
    qtbot.waitUntil(lambda: not steps.work.busy, timeout=60_000)
    assert rig.connection.settings is None


def test_a_calibration_that_the_user_cancels_is_no_error(viewer, panel, qtbot, said):
    """Before: a notification and a warning that stayed, with the advice to start it again."""
    measured = panel.connection.client.measure_step(GALVO, Draft(small_calibration()), 2000)
    panel.requests.follow(measured)
    qtbot.waitUntil(lambda: panel.form.start.text == "Cancel calibration", timeout=60_000)
    panel.form.start.native.click()
    qtbot.waitUntil(lambda: not panel.requests.busy, timeout=60_000)
    assert isinstance(measured.exception(), CancelledError)
    assert said() == []
    assert problems.newest == ""
    qtbot.waitUntil(lambda: "Stopped" in panel.form.status.text(), timeout=60_000)


def test_the_calibration_panel_displays_the_rig_that_another_panel_connected(viewer, qtbot, small_engine):
    """Before: it offered to connect, which disconnected, and its scripts named another preset."""
    _, rig = viewer.window.add_plugin_dock_widget(PLUGIN, "Rig")
    _, steps = viewer.window.add_plugin_dock_widget(PLUGIN, "Calibration")
    rig.preset.value = "120hz"
    rig.toggle()
    qtbot.waitUntil(lambda: not rig.requests.busy and rig.connection.client is not None, timeout=60_000)
    qtbot.waitUntil(lambda: steps.form.connect_button.text() == "Disconnect", timeout=30_000)
    assert steps.form.live_source("offset", "small").preset == "120hz"
    assert steps.form.rig.currentText() == rig.rig.value
    rig.preset.value = "240hz"
    qtbot.waitUntil(lambda: steps.form.preset.currentData() == "240hz", timeout=30_000)
    rig.toggle()
    qtbot.waitUntil(lambda: steps.form.connect_button.text() == "Connect", timeout=30_000)
    assert steps.form.preset.currentData() == "240hz"


def test_a_rig_that_is_not_there_is_said(viewer, qtbot, said, monkeypatch):
    _, panel = viewer.window.add_plugin_dock_widget(PLUGIN, "Rig")
    panel.rig.choices = ["none"]
    panel.connect.native.click()
    qtbot.waitUntil(lambda: any("no rig 'none'" in words for _, words in said()), timeout=60_000)
    qtbot.waitUntil(lambda: not panel.requests.busy, timeout=30_000)


def test_stop_acts_while_the_window_still_waits_for_its_answer(panel, qtbot, tmp_path):
    start(panel, qtbot)
    qtbot.waitUntil(lambda: panel.connection.client.status.scanning, timeout=30_000)
    asked_s = time.perf_counter()
    panel.form.start.native.click()
    log = tmp_path / "mirror.log"
    while not log.read_text().endswith("park\n"):  # the window cannot take an answer meanwhile
        assert time.perf_counter() - asked_s < 30
        time.sleep(1e-3)
    parked_s = time.perf_counter() - asked_s
    assert panel.requests.busy
    qtbot.waitUntil(lambda: not panel.live and not panel.requests.busy, timeout=30_000)
    shown_s = time.perf_counter() - asked_s
    sys.stdout.write(f"stop: parked after {parked_s:.3f} s, shown after {shown_s:.3f} s\n")


def test_a_recording_ends_after_so_many_frames(panel, qtbot, tmp_path):
    assert panel.form.frames.native.text() == "no limit"
    panel.form.frames.value = 12
    start(panel, qtbot)
    panel.form.record.native.click()
    qtbot.waitUntil(lambda: list(tmp_path.glob("recording-*.calibration.json")) != [], timeout=30_000)
    qtbot.waitUntil(lambda: ended(panel), timeout=30_000)
    (path,) = tmp_path.glob("recording-*.ome.tif")
    with open_recording(path) as recording:
        assert len(recording) == 12


def test_what_the_panel_does_runs_as_a_script(panel, qtbot, tmp_path, monkeypatch):
    file = write_calibration(tmp_path / "cal.json", panel.connection.calibration)
    panel.connection.apply(panel.connection.calibration, file).result(60)
    panel.form.frames.value, panel.form.average.value, panel.form.cores.value = 7, 2, "median"
    panel.copy_script()
    text = QApplication.clipboard().text()
    panel.connection.disconnect()
    monkeypatch.setattr("napari_elsplus.acquisition.live_engine.open_live", lambda name: SmallRig())
    exec(compile(text, "script", "exec"), {})
    (path,) = tmp_path.glob("recording-*.ome.tif")
    with open_recording(path) as recording:
        assert len(recording) == 7
        assert recording.calibration == panel.connection.calibration


def test_a_script_needs_the_file_of_a_real_rigs_calibration(panel, said):
    panel.connection.rig = "mine"
    panel.copy_script()
    assert any("save it in the Rig panel" in words for _, words in said())
    panel.connection.rig = "simulated"


def test_live_frames_can_be_taken_for_an_axial_response(viewer, panel, qtbot):
    _, axial = viewer.window.add_plugin_dock_widget(PLUGIN, "Axial response")
    panel.form.kinds["raw"].value = True
    start(panel, qtbot)
    qtbot.waitUntil(lambda: "live raw" in axial.live.choices, timeout=30_000)
    axial.live.value = "live raw"
    panel.form.kinds["raw"].value = False  # the frame is the newest one also where it is hidden
    qtbot.waitUntil(lambda: not viewer.layers["live raw"].visible, timeout=30_000)
    before = int(viewer.layers["live raw"].data[0, :8].view(np.int64)[0])
    qtbot.waitUntil(lambda: int(viewer.layers["live raw"].data[0, :8].view(np.int64)[0]) > before, timeout=30_000)
    frame = viewer.layers["live raw"].data
    axial.take.native.click()
    added = np.array(frame)
    qtbot.waitUntil(lambda: not np.array_equal(frame, added), timeout=30_000)
    axial.take.native.click()
    assert "2 of at least 3 depths" in axial.numbers.text()


def test_a_calibration_reaches_the_other_panels_whoever_loaded_it(viewer, qtbot, tmp_path, small_engine):
    known = small_calibration()
    file = write_calibration(tmp_path / "cal.json", known)
    _, rig = viewer.window.add_plugin_dock_widget(PLUGIN, "Rig")
    _, steps = viewer.window.add_plugin_dock_widget(PLUGIN, "Calibration")
    assert not rig.save_file.enabled
    rig.connect.native.click()
    qtbot.waitUntil(lambda: rig.connection.client is not None and not rig.requests.busy, timeout=60_000)
    rig.load(file)
    qtbot.waitUntil(lambda: steps.draft.calibration == known, timeout=30_000)
    other = known.model_copy(update={"optics": known.optics.model_copy(update={"um_per_px": 2.0})})
    steps.load(write_calibration(tmp_path / "other.json", other))
    qtbot.waitUntil(lambda: rig.connection.client.calibration == other, timeout=30_000)
    qtbot.waitUntil(lambda: rig.connection.calibration_file == tmp_path / "other.json", timeout=30_000)
    steps.undo()
    qtbot.waitUntil(lambda: rig.connection.client.calibration == known, timeout=30_000)
    rig.save(tmp_path / "saved.json")
    qtbot.waitUntil(lambda: rig.connection.calibration_file == tmp_path / "saved.json", timeout=30_000)
    assert read_calibration(tmp_path / "saved.json") == known
    assert active_calibration() == tmp_path / "saved.json"
    qtbot.waitUntil(lambda: rig.connect.enabled, timeout=30_000)
    rig.connect.native.click()
    qtbot.waitUntil(lambda: rig.connection.client is None and rig.connect.enabled, timeout=30_000)
    rig.connect.native.click()  # the rig that is connected anew works by what is known
    qtbot.waitUntil(lambda: rig.connection.client is not None and not rig.requests.busy, timeout=60_000)
    assert rig.connection.client.calibration == known
    rig.forgetting.native.click()  # no calibration is active any more, nor the next time
    qtbot.waitUntil(lambda: rig.connection.calibration is None and active_calibration() is None, timeout=30_000)
    assert rig.connection.client.calibration is None
    qtbot.waitUntil(lambda: steps.draft.calibration == Calibration(), timeout=30_000)
    assert not rig.forgetting.enabled
    steps.undo()
    qtbot.waitUntil(lambda: rig.connection.client.calibration == known, timeout=30_000)


def test_closing_the_dock_does_not_wait_for_the_engine(viewer, panel, qtbot, tmp_path, small_engine, monkeypatch):
    start(panel, qtbot)
    close, may_end = EngineClient.close, Event()

    def patiently(client):
        may_end.wait(30)
        close(client)

    monkeypatch.setattr(EngineClient, "close", patiently)
    gone = []
    panel.destroyed.connect(lambda: gone.append(True))
    viewer.window.remove_dock_widget(panel)
    assert exists(small_engine[0].pid)
    may_end.set()
    qtbot.waitUntil(lambda: bool(gone), timeout=30_000)


def test_a_full_disk_and_an_unplugged_camera_are_said_once_and_it_can_go_on(panel, qtbot, said, tmp_path):
    client = panel.connection.client
    start(panel, qtbot)
    for words in ("No space left", "unplugged"):
        (tmp_path / "mirror.log").with_suffix(".fault").write_text(words)
        if words == "No space left":
            panel.form.record.native.click()
        qtbot.waitUntil(lambda words=words: any(words in said_ for _, said_ in said()), timeout=30_000)
        qtbot.wait(600)
        assert sum(words in said_ for _, said_ in said()) == 1
        assert panel.live == (words == "No space left")
    (tmp_path / "mirror.log").with_suffix(".fault").unlink()
    panel.form.start.native.click()
    qtbot.waitUntil(lambda: panel.live, timeout=30_000)
    assert panel.connection.client is client


def test_what_is_filled_in_place_is_what_the_canvas_shows(make_napari_viewer_proxy):
    viewer = make_napari_viewer_proxy(show=True)
    layout = display_layout((64, 128), 32)
    ring = Ring(bytearray(layout.nbytes), layout)
    layers = LiveLayers(viewer)
    layers.arrange(["els"], ring, None, side_by_side=True)

    def shown(level, whole):
        slot = ring.acquire()
        slot.arrays["els"][...] = level
        ring.finalize(slot, FrameInfo(0, 0.0, 0.0))
        assert layers.update(ring, whole=whole) is not None
        viewer.layers["live ELS+"].contrast_limits = (0, 100)
        picture = viewer.screenshot(canvas_only=True, flash=False)
        return int(picture[picture.shape[0] // 2, picture.shape[1] // 2, 0])

    assert shown(100, whole=True) == 255
    assert shown(20, whole=False) == pytest.approx(51, abs=2)
    assert shown(80, whole=False) == pytest.approx(204, abs=2)


def test_a_hidden_layer_of_another_preset_is_not_filled(make_napari_viewer_proxy):
    """Before: a ValueError of shapes whenever an image that had been displayed at another preset was hidden."""
    layers = LiveLayers(make_napari_viewer_proxy())
    for rows, kinds in ((64, ["raw", "els"]), (128, ["els"]), (128, ["raw"])):
        layout = display_layout((rows, 128), 32)
        ring = Ring(bytearray(layout.nbytes), layout)
        while not layers.arrange(kinds, ring, None, side_by_side=True):
            pass
        slot = ring.acquire()
        slot.arrays["raw"][...] = rows
        ring.finalize(slot, FrameInfo(0, 0.0, 0.0))
        assert layers.update(ring, whole=True) is not None
    raw = layers.images["raw"].data
    assert raw.shape == (128, 128)
    assert (raw == 128).all()


def test_a_missing_scan_lag_is_amber_in_rig_and_live_and_measured_by_one_click(viewer, panel, qtbot, monkeypatch):
    _, rig = viewer.window.add_plugin_dock_widget(PLUGIN, "Rig")
    advice = "scan lag not measured: the image is off the slit"
    client = panel.connection.client
    qtbot.waitUntil(lambda: advice in panel.form.status.text() and advice in rig.status.text(), timeout=30_000)
    assert AMBER in panel.form.status.text()
    assert AMBER in rig.status.text()
    found = Future()
    found.set_result(ScanLag(215e-6, 1e-6, np.zeros(1), np.zeros(1)))
    monkeypatch.setattr(client, "measure_step", lambda step, draft: found)
    for button in (panel.form.lag, rig.lag):
        qtbot.waitUntil(lambda button=button: not button.native.isHidden() and button.enabled, timeout=30_000)
    rig.lag.native.click()
    qtbot.waitUntil(lambda: client.calibration.galvo.lag_s == 215e-6, timeout=30_000)
    qtbot.waitUntil(lambda: advice not in panel.form.status.text() + rig.status.text(), timeout=30_000)
    qtbot.waitUntil(lambda: panel.form.lag.native.isHidden() and rig.lag.native.isHidden(), timeout=30_000)
    assert "not saved, measured" in panel.form.status.text()


def test_closing_the_last_panel_while_it_connects_leaves_no_engine(viewer, qtbot, small_engine, monkeypatch):
    opening, may_open = Event(), Event()

    def patiently(client, rig):
        opening.set()
        may_open.wait(30)
        return client.call("open", rig)

    monkeypatch.setattr(EngineClient, "open", patiently)
    _, rig = viewer.window.add_plugin_dock_widget("napari-elsplus", "Rig")
    rig.connect.native.click()
    assert opening.wait(30)
    connection = rig.connection
    viewer.window.remove_dock_widget(rig)
    may_open.set()
    qtbot.waitUntil(lambda: small_engine and not exists(small_engine[-1].pid), timeout=30_000)
    assert connection.client is None


def test_a_rig_is_not_connected_once_the_last_panel_was_closed(small_engine):
    """Before: a request whose turn came after the last panel was closed left its engine behind, the rig open."""
    connection = join()
    connection.leave()
    with pytest.raises(DeviceError, match="last panel was closed"):
        connection.connect("simulated", Settings("240hz", frame_rate_hz=100.0))
    assert connection.client is None
    assert not [client for client in small_engine if exists(client.pid)]


def test_a_recording_has_a_limit_is_described_and_opened(viewer, panel, qtbot, tmp_path):
    assert LiveForm(QWidget()).seconds.value == DEFAULT_LIMIT_S
    panel.form.seconds.value = 0.5
    start(panel, qtbot)
    assert panel.form.opening.native.isHidden()
    panel.form.record.native.click()
    qtbot.waitUntil(lambda: "<b>recording</b> recording-" in panel.form.status.text(), timeout=30_000)
    qtbot.waitUntil(lambda: "<b>recorded</b> recording-" in panel.form.status.text(), timeout=30_000)
    assert re.search(r"ome.tif: \d+ frames, \d\.\d s, (.* frames lost.*, )?\d+ MB", panel.form.status.text())
    assert not panel.form.opening.native.isHidden()
    panel.form.opening.native.click()
    (path,) = tmp_path.glob("recording-*.ome.tif")
    assert any(layer.metadata["elsplus"]["path"] == path for layer in images(viewer))


def test_live_images_return_by_one_click_after_a_recording_was_opened_while_they_stream(viewer, panel, qtbot):
    """Before: they stayed hidden until the stream was stopped and started."""
    panel.form.frames.value = 3
    start(panel, qtbot)
    panel.form.record.native.click()
    qtbot.waitUntil(lambda: panel.form.opening.text == "Open it" and ended(panel), timeout=30_000)
    qtbot.waitUntil(lambda: not panel.form.opening.native.isHidden(), timeout=30_000)
    panel.form.opening.native.click()
    assert panel.form.opening.text == "Show live images"
    panel.form.opening.native.click()
    live = ["live LS", "live ELS+", "live titles"]
    qtbot.waitUntil(lambda: sorted(layer.name for layer in viewer.layers if layer.visible) == sorted(live))
    qtbot.waitUntil(lambda: panel.form.opening.text == "Open it", timeout=30_000)


def test_a_recording_that_is_opened_and_the_stream_take_each_others_place(viewer, panel, qtbot, said):
    panel.form.frames.value = 3
    start(panel, qtbot)
    panel.form.record.native.click()
    qtbot.waitUntil(lambda: ended(panel), timeout=30_000)
    stop(panel, qtbot)
    panel.form.opening.native.click()
    visible = [layer.name for layer in viewer.layers if layer.visible]
    assert len(visible) == 1
    assert visible[0].startswith("recording-")
    recorded = Path(panel.connection.client.status.recording.path)
    recorded.unlink()  # or moved away by the user
    panel.form.opening.native.click()
    assert str(recorded) in said()[-1][1]
    start(panel, qtbot)
    live = ["live LS", "live ELS+", "live titles"]
    qtbot.waitUntil(lambda: [layer.name for layer in viewer.layers if layer.visible] == live, timeout=30_000)


def test_a_stream_that_another_panel_starts_takes_the_place_of_an_opened_recording(viewer, panel, qtbot):
    panel.form.frames.value = 3
    start(panel, qtbot)
    panel.form.record.native.click()
    qtbot.waitUntil(lambda: ended(panel), timeout=30_000)
    stop(panel, qtbot)
    panel.form.opening.native.click()
    panel.requests.follow(panel.connection.client.start())
    live = ["live LS", "live ELS+", "live titles"]
    qtbot.waitUntil(lambda: [layer.name for layer in viewer.layers if layer.visible] == live, timeout=30_000)


def test_a_panel_imports_what_the_first_layers_need_before_they_are_created(make_napari_viewer_proxy, monkeypatch):
    begun = []
    monkeypatch.setattr("napari_elsplus.widgets.live.panel.import_ahead", lambda: begun.append(import_ahead()))
    make_napari_viewer_proxy().window.add_plugin_dock_widget(PLUGIN, "Live")
    (thread,) = begun
    thread.join(30)
    assert "pandas" in sys.modules


@pytest.mark.parametrize("title", ["Live", "Calibration"])
def test_an_idle_panel_reads_the_units_that_the_first_layer_needs(make_napari_viewer_proxy, qtbot, title):
    """Before: with the first live image, for a third of the time that the window stood still."""
    units = pint.get_application_registry()
    of_other_tests = units.get()
    units.set(LazyRegistry())
    try:
        make_napari_viewer_proxy().window.add_plugin_dock_widget(PLUGIN, title)
        qtbot.waitUntil(lambda: not isinstance(units.get(), LazyRegistry))
    finally:
        units.set(of_other_tests)


def test_images_are_created_one_in_each_tick_so_that_the_window_answers_between_them(viewer, panel, qtbot, monkeypatch):
    """Before: the window stood still until all images and their titles were there."""
    created, arrange = [], panel.layers.arrange

    def counted(*what, **how):
        before = len(viewer.layers)
        complete = arrange(*what, **how)
        created.append(len(viewer.layers) - before)
        return complete

    monkeypatch.setattr(panel.layers, "arrange", counted)
    for box in panel.form.kinds.values():
        box.value = True
    start(panel, qtbot)
    qtbot.waitUntil(lambda: len(viewer.layers) == len(panel.form.kinds) + 1)
    assert max(created) == 1


def test_images_that_are_ticked_come_into_view_and_the_raw_frame_lies_below_them(viewer, panel, qtbot):
    """Before: they were displayed beside the canvas, and the wide raw frame moved the others out of it."""
    start(panel, qtbot)
    viewer.scene.camera.zoom = 20
    for kind in ("elsa", "raw"):
        panel.form.kinds[kind].value = True
        qtbot.waitUntil(lambda kind=kind: kind in panel.layers.images and panel._arranged is not None, timeout=30_000)
        assert all(seen(viewer, layer) for layer in panel.layers.images.values())
    raw, els = (panel.layers.images[kind].extent.world for kind in ("raw", "els"))
    assert raw[0, 0] > els[1, 0]
    viewer.scene.camera.zoom = zoom = 20
    panel.form.kinds["raw"].value = False
    qtbot.waitUntil(lambda: not panel.layers.images["raw"].visible)
    assert viewer.scene.camera.zoom == zoom
    viewer.layers.clear()
    qtbot.waitUntil(lambda: not panel.form.chosen)
    for kind in ("ls", "els"):
        panel.form.kinds[kind].value = True
    qtbot.waitUntil(lambda: len(panel.layers.images) == 2 and panel._arranged is not None, timeout=30_000)
    assert all(seen(viewer, layer) for layer in panel.layers.images.values())


def seen(viewer, layer):
    """True if a layer lies in the canvas."""
    camera, half = viewer.scene.camera, np.array(viewer.canvas.size) / 2
    return bool((np.abs(layer.extent.world - camera.center[-2:]) * camera.zoom <= half).all())
