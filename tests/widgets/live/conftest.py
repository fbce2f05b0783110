"""The Live panel on the small engine."""

from __future__ import annotations

import pytest

from napari_elsplus.acquisition.engine.status import Settings
from small_rig import small_calibration


@pytest.fixture
def panel(viewer, qtbot, tmp_path):
    """The Live panel, connected to a calibrated rig."""
    _, panel = viewer.window.add_plugin_dock_widget("napari-elsplus", "Live")
    client = panel.connection.connect("simulated", Settings("240hz", frame_rate_hz=100.0))
    client.use(small_calibration()).result(60)
    panel.form.folder.value = tmp_path
    panel.form.seconds.value = 0
    return panel
