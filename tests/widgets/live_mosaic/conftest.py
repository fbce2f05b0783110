"""The Mosaic panel on the live stream, with the engine in a process of its own."""

from __future__ import annotations

import pytest

from napari_elsplus.acquisition.engine.status import Settings
from small_rig import small_calibration

PLUGIN = "napari-elsplus"


@pytest.fixture
def viewer(small_engine, make_napari_viewer_proxy):
    return make_napari_viewer_proxy()


@pytest.fixture
def panel(viewer, qtbot):
    """The Mosaic panel, connected to a calibrated rig; LS is laid, since the small rig's views differ little."""
    _, panel = viewer.window.add_plugin_dock_widget(PLUGIN, "Mosaic")
    client = panel.connection.connect("simulated", Settings("240hz", frame_rate_hz=100.0))
    client.use(small_calibration()).result(60)
    for mode, box in panel.form.modes.items():
        box.value = mode == "ls"
    return panel


@pytest.fixture
def go_live():
    """Click on Live mosaic, and wait until frames were tracked."""

    def click(viewer, panel, qtbot, frames=20):
        qtbot.waitUntil(
            lambda: panel.form.going_live.enabled and panel.form.going_live.text == "Live mosaic", timeout=30_000
        )
        panel.form.going_live.native.click()
        drawing = lambda: panel.layers.drawing  # noqa: E731
        qtbot.waitUntil(
            lambda: (
                "mosaic LS" in viewer.layers and drawing() is not None and drawing().rows.counts["tracked"] > frames
            ),
            timeout=60_000,
        )

    return click
