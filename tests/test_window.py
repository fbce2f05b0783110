"""The window that opens: what the manifest offers is in it."""

from __future__ import annotations

import os
import sys
from typing import Any

import pytest
from npe2 import PluginManifest
from qtpy.QtWidgets import QDockWidget

from napari_elsplus import _sample_data, _window

pytestmark = pytest.mark.skipif(
    sys.platform.startswith("linux") and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ),
    reason="no screen, and Qt would end the whole run: start pytest under xvfb-run",
)


@pytest.fixture
def manifest() -> PluginManifest:
    return PluginManifest.from_distribution("napari-elsplus")


def test_the_window_shows_what_the_manifest_offers(
    make_napari_viewer: Any, monkeypatch: pytest.MonkeyPatch, npe2pm: Any, manifest: PluginManifest
) -> None:
    monkeypatch.setattr(_sample_data, "FRAMES", 2)
    npe2pm.register(manifest)
    viewer = make_napari_viewer()
    _window.fill(viewer)
    panels = [widget.display_name for widget in manifest.contributions.widgets or ()]
    (dock,) = viewer.window.dock_widgets.values()
    tabs = [dock.tabs.tabText(index) for index in range(dock.tabs.count())]
    assert tabs == panels[1:]
    assert panels[0] in [one.windowTitle() for one in viewer.window._qt_window.findChildren(QDockWidget)]
    assert [layer.name for layer in viewer.layers if layer.visible] == ["fibres LS", "fibres residual", "fibres ELS+"]
    assert viewer.canvas.overlays.scale_bar.visible
