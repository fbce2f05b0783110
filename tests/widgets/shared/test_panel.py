"""What all panels owe whoever uses them."""

from __future__ import annotations

import pytest
from qtpy.QtWidgets import QPushButton

PLUGIN = "napari-elsplus"


@pytest.mark.parametrize("name", ["Compare", "Axial response", "Quality"])
def test_a_button_that_cannot_be_pressed_says_what_comes_first(make_napari_viewer_proxy, name):
    _, panel = make_napari_viewer_proxy().window.add_plugin_dock_widget(PLUGIN, name)
    barred = [button for button in panel.findChildren(QPushButton) if not button.isEnabled()]
    assert len(barred) >= 3
    assert [button.text() for button in barred if "; first " not in button.toolTip()] == []
