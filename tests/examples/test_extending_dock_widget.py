"""The panel of examples/extending/dock_widget.py shares engine and calibration with the panels of the package."""

from __future__ import annotations

import os
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from napari.layers import Image

from napari_elsplus.acquisition.engine.status import Settings
from small_rig import small_calibration

TESTS = Path(__file__).resolve().parents[1]
EXAMPLE = TESTS.parent / "examples" / "extending" / "dock_widget.py"
NO_SCREEN = sys.platform.startswith("linux") and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ)

pytestmark = [pytest.mark.checkout, pytest.mark.skipif(NO_SCREEN, reason="no screen: start under xvfb-run")]

shared = runpy.run_path(str(TESTS / "widgets" / "conftest.py"))
small_engine, said = shared["small_engine"], shared["said"]


@pytest.fixture
def panel(small_engine, make_napari_viewer_proxy):
    viewer = make_napari_viewer_proxy()
    panel = runpy.run_path(str(EXAMPLE))["MeanSignalPanel"](viewer)
    viewer.window.add_dock_widget(panel, name="Mean signal")
    return panel


def test_it_follows_the_stream_that_the_live_panel_started(panel, qtbot):
    assert panel.state.text() == "not connected; no calibration"
    _, live = panel.viewer.window.add_plugin_dock_widget("napari-elsplus", "Live")
    assert live.connection is panel.connection
    client = live.connection.connect("simulated", Settings("240hz", frame_rate_hz=100.0))
    calibration = small_calibration()
    panel.requests.follow(panel.connection.apply(calibration), lambda _: live.toggle())
    qtbot.waitUntil(lambda: len(panel.live) >= 3, timeout=60_000)
    assert live.connection.calibration is calibration
    assert panel.state.text() == f"rig simulated; {calibration.um_per_px} µm per pixel"
    assert all(np.isfinite(mean) for _, mean in panel.live)
    (curve,) = panel.plot.curves
    assert len(curve.x) >= 3
    client.stop().result(60)


def test_it_plots_the_mean_of_each_frame_of_a_layer(panel, qtbot, said):
    panel.measure.native.click()
    assert any("no image layer" in message for _, message in said())
    frames = np.arange(5, dtype=np.float32)[:, None, None] * np.ones((5, 8, 8), np.float32)
    panel.viewer.layers.append(Image(frames))
    panel.measure.native.click()
    qtbot.waitUntil(lambda: len(panel.plot.curves) == 1, timeout=30_000)
    assert panel.plot.curves[0].y.tolist() == [0, 1, 2, 3, 4]
