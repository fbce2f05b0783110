"""The Rig and Live panels, driven as a user drives them, on an engine in a process of its own."""

from __future__ import annotations

import os
import runpy
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from qtpy.QtCore import Qt
from qtpy.QtTest import QTest

from napari_elsplus.acquisition.status import Settings
from napari_elsplus.io import open_recording
from napari_elsplus.settings import recall
from processes import exists

PLUGIN = "napari-elsplus"
HERE = Path(__file__).parents[1] / "acquisition"


@pytest.fixture
def viewer(small_engine, make_napari_viewer_proxy):
    return make_napari_viewer_proxy()


@pytest.fixture
def panel(viewer, qtbot, tmp_path):
    """The Live panel, connected to a calibrated rig."""
    _, panel = viewer.window.add_plugin_dock_widget(PLUGIN, "Live")
    client = panel.connection.connect("simulated", Settings("240hz", frame_rate_hz=100.0))
    client.use(runpy.run_path(str(HERE / "conftest.py"))["small_calibration"]()).result(60)
    panel.folder.value = tmp_path
    return panel


def ended(panel):
    recording = panel.connection.client.status.recording
    return recording is not None and not recording.running


def start(panel, qtbot):
    panel.start.native.click()
    qtbot.waitUntil(
        lambda: panel.live and len(panel.layers.images) >= 2 and panel.snapping.enabled and panel.record.enabled,
        timeout=30_000,
    )


def stop(panel, qtbot):
    panel.start.native.click()
    qtbot.waitUntil(lambda: not panel.live and not panel.asking.busy, timeout=30_000)


def test_live_layers_fill_and_are_kept_as_the_user_has_set_them(viewer, panel, qtbot):
    start(panel, qtbot)
    els = viewer.layers["live ELS+"]
    qtbot.waitUntil(lambda: np.abs(els.data).max() > 1, timeout=30_000)
    assert [layer.name for layer in viewer.layers] == ["live LS", "live ELS+"]
    assert els.scale == pytest.approx([1.33, 1.33])
    assert els.translate[1] > 466 * 1.33
    els.colormap, els.contrast_limits = "magenta", (3, 77)
    viewer.scene.camera.zoom = 2.5
    stop(panel, qtbot)
    start(panel, qtbot)
    qtbot.wait(200)
    assert len(viewer.layers) == 2
    assert els in viewer.layers
    assert (els.colormap.name, tuple(els.contrast_limits), viewer.scene.camera.zoom) == ("magenta", (3, 77), 2.5)


def test_a_blocked_window_loses_nothing(viewer, panel, qtbot, tmp_path):
    start(panel, qtbot)
    panel.record.native.click()
    qtbot.waitUntil(lambda: panel.connection.client.status.recording is not None, timeout=30_000)
    time.sleep(2.0)
    qtbot.wait(300)
    panel.record.native.click()
    qtbot.waitUntil(lambda: ended(panel), timeout=30_000)
    assert panel.connection.client.status.dropped == {}
    (path,) = tmp_path.glob("recording-*.ome.tif")
    with open_recording(path) as recording:
        assert len(recording) > 200
        assert (np.diff(recording.frame_numbers) == 1).all()


def test_a_snap_is_one_frame(panel, qtbot, tmp_path):
    start(panel, qtbot)
    panel.snapping.native.click()
    qtbot.waitUntil(lambda: list(tmp_path.glob("snap-*.calibration.json")) != [], timeout=30_000)
    qtbot.waitUntil(lambda: ended(panel), timeout=30_000)
    (path,) = tmp_path.glob("snap-*.ome.tif")
    with open_recording(path) as recording:
        assert len(recording) == 1


def test_what_is_shown_follows_the_boxes(viewer, panel, qtbot):
    start(panel, qtbot)
    panel.kinds["ls"].value = False
    panel.kinds["elsa"].value = True
    qtbot.waitUntil(lambda: "elsa" in panel.layers.images, timeout=30_000)
    assert {layer.name for layer in viewer.layers if layer.visible} == {"live ELS+", "live ELSA"}
    panel.side_by_side.value = False
    qtbot.waitUntil(lambda: {layer.translate[1] for layer in viewer.layers if layer.visible} == {0.0}, timeout=30_000)
    assert recall("live")["kinds"] == ["els", "elsa"]


def test_a_view_that_cannot_be_made_is_said_and_the_stream_goes_on(panel, qtbot, said):
    start(panel, qtbot)
    panel.flat_field.value = True
    qtbot.waitUntil(lambda: any("no flat field" in words for _, words in said()), timeout=30_000)
    assert panel.live


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
def test_a_killed_engine_is_said_once_the_layers_stay_and_it_can_start_again(viewer, panel, qtbot, said, small_engine):
    start(panel, qtbot)
    os.kill(panel.connection.client.pid, signal.SIGKILL)
    qtbot.waitUntil(lambda: any("SIGKILL" in words for _, words in said()), timeout=30_000)
    qtbot.wait(600)
    assert sum("SIGKILL" in words for _, words in said()) == 1
    assert len(viewer.layers) == 2
    panel.start.native.click()
    qtbot.waitUntil(lambda: panel.connection.client is not None and not panel.asking.busy, timeout=30_000)
    assert len(small_engine) == 2


def test_keys_start_and_stop(viewer, panel, qtbot):
    viewer.window.show()
    panel.window().activateWindow()
    qtbot.waitUntil(lambda: panel.window().isActiveWindow(), timeout=10_000)
    QTest.keyClick(panel, Qt.Key.Key_Return, Qt.KeyboardModifier.ControlModifier)
    qtbot.waitUntil(lambda: panel.live, timeout=30_000)
    QTest.keyClick(panel, Qt.Key.Key_Return, Qt.KeyboardModifier.ControlModifier)
    qtbot.waitUntil(lambda: not panel.live, timeout=30_000)


def test_the_rig_panel_connects_sets_up_parks_and_remembers(viewer, qtbot, tmp_path, small_engine):
    _, panel = viewer.window.add_plugin_dock_widget(PLUGIN, "Rig")
    assert panel.rig.value == "simulated"
    assert not panel.parking.enabled
    panel.connect.native.click()
    qtbot.waitUntil(lambda: panel.connection.client is not None, timeout=60_000)
    panel.slit_rows.value = 5
    qtbot.waitUntil(lambda: not panel.asking.busy, timeout=30_000)
    assert "slit 6.7" in panel.optics.text()
    panel.parking.native.click()
    log = tmp_path / "mirror.log"
    qtbot.waitUntil(lambda: log.exists() and log.read_text().split()[-1:] == ["park"], timeout=30_000)
    assert recall("rig")["slit_rows"] == 5
    panel.connect.native.click()
    qtbot.waitUntil(lambda: not exists(small_engine[0].pid), timeout=30_000)
    qtbot.waitUntil(lambda: not panel.asking.busy, timeout=30_000)


def test_a_rig_that_is_not_there_is_said(viewer, qtbot, said, monkeypatch):
    _, panel = viewer.window.add_plugin_dock_widget(PLUGIN, "Rig")
    panel.rig.choices = ["none"]
    panel.connect.native.click()
    qtbot.waitUntil(lambda: any("no rig 'none'" in words for _, words in said()), timeout=60_000)
    qtbot.waitUntil(lambda: not panel.asking.busy, timeout=30_000)
