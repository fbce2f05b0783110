"""napari with the plugin in it: ``python -m napari_elsplus._window``.

Docks what the manifest declares as widgets, and opens the simulated recording.
"""

from __future__ import annotations

import signal

import napari
from napari.settings import get_settings
from npe2 import PluginManager
from qtpy.QtCore import Qt, QTimer
from qtpy.QtGui import QGuiApplication
from qtpy.QtWidgets import QTabBar

PLUGIN = "napari-elsplus"
SAMPLE = "recording"
SHARE_OF_SCREEN = 0.85
TABS_MARGIN_PX = 12


def fill(viewer: napari.Viewer) -> None:
    """Put what the plugin offers into a viewer: its panels, the first of them in front, and a sample to look at."""
    offers = PluginManager.instance().get_manifest(PLUGIN).contributions
    docks = []
    for widget in offers.widgets or ():
        dock, _ = viewer.window.add_plugin_dock_widget(PLUGIN, widget.display_name, tabify=True)
        dock.setWindowTitle(widget.display_name)  # the plugin's name beside each would leave the tabs no room
        docks.append(dock)
    window = docks[0].parent()
    bars = window.findChildren(QTabBar)
    for bar in bars:
        bar.setElideMode(Qt.TextElideMode.ElideNone)
    viewer.open_sample(PLUGIN, SAMPLE)
    viewer.canvas.overlays.scale_bar.visible = True

    def look() -> None:
        docks[0].raise_()
        tabs_px = max((bar.tabRect(bar.count() - 1).right() for bar in bars), default=0)
        window.resizeDocks([docks[0]], [tabs_px + TABS_MARGIN_PX], Qt.Orientation.Horizontal)
        QTimer.singleShot(0, viewer.reset_view)  # when the canvas has the room that is left

    QTimer.singleShot(0, look)  # not before the window has laid them out


def main() -> None:
    """Open the window and stay until it is closed; a termination closes it as a click would."""
    viewer = napari.Viewer()
    screen = QGuiApplication.primaryScreen()
    if get_settings().application.window_size is None and screen is not None:
        size = screen.availableSize() * SHARE_OF_SCREEN  # napari's first size leaves a panel and images no room
        viewer.window.resize(size.width(), size.height())
    fill(viewer)
    signal.signal(signal.SIGTERM, lambda *_: viewer.close())
    napari.run()


if __name__ == "__main__":
    main()
