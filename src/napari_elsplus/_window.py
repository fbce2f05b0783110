"""napari with the plugin in it: ``python -m napari_elsplus._window``.

Docks the widgets that the manifest declares, and opens the simulated recording.
"""

from __future__ import annotations

import signal
from typing import Final

import napari
from napari.settings import get_settings
from npe2 import PluginManager
from qtpy.QtCore import Qt, QTimer
from qtpy.QtGui import QGuiApplication
from qtpy.QtWidgets import QTabBar

PLUGIN: Final = "napari-elsplus"
SAMPLE: Final = "recording"
SHARE_OF_SCREEN: Final = 0.85
"""Size of the first window relative to the screen; chosen."""
TABS_MARGIN_PX: Final = 12
"""Added to the width of the dock's tabs, pixels; chosen."""


def fill(viewer: napari.Viewer) -> None:
    """Add the plugin's panels to a viewer, the first one in front, and open a sample."""
    contributions = PluginManager.instance().get_manifest(PLUGIN).contributions
    docks = []
    for widget in contributions.widgets or ():
        dock, _ = viewer.window.add_plugin_dock_widget(PLUGIN, widget.display_name, tabify=True)
        dock.setWindowTitle(widget.display_name)  # without the plugin's name, so that the tabs fit
        docks.append(dock)
    window = docks[0].parent()
    bars = window.findChildren(QTabBar)
    for bar in bars:
        bar.setElideMode(Qt.TextElideMode.ElideNone)
    viewer.open_sample(PLUGIN, SAMPLE)
    viewer.canvas.overlays.scale_bar.visible = True

    def arrange() -> None:
        docks[0].raise_()
        tabs_px = max((bar.tabRect(bar.count() - 1).right() for bar in bars), default=0)
        window.resizeDocks([docks[0]], [tabs_px + TABS_MARGIN_PX], Qt.Orientation.Horizontal)
        QTimer.singleShot(0, viewer.reset_view)  # after the canvas was resized

    QTimer.singleShot(0, arrange)  # after the window's layout


def main() -> None:
    """Open the window and run until it is closed; SIGTERM closes it."""
    viewer = napari.Viewer()
    screen = QGuiApplication.primaryScreen()
    if get_settings().application.window_size is None and screen is not None:
        size = screen.availableSize() * SHARE_OF_SCREEN  # napari's default is too small for a panel beside images
        viewer.window.resize(size.width(), size.height())
    fill(viewer)
    signal.signal(signal.SIGTERM, lambda *_: viewer.close())
    napari.run()


if __name__ == "__main__":
    main()
