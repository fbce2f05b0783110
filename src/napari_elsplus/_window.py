"""napari with the plugin in it: ``python -m napari_elsplus._window``.

Docks what the manifest declares as widgets, and opens the simulated recording.
"""

from __future__ import annotations

import signal

import napari
from npe2 import PluginManager
from qtpy.QtCore import Qt, QTimer
from qtpy.QtWidgets import QTabBar

PLUGIN = "napari-elsplus"
SAMPLE = "recording"


def fill(viewer: napari.Viewer) -> None:
    """Put what the plugin offers into a viewer: its panels, the first of them in front, and a sample to look at."""
    offers = PluginManager.instance().get_manifest(PLUGIN).contributions
    docks = []
    for widget in offers.widgets or ():
        dock, _ = viewer.window.add_plugin_dock_widget(PLUGIN, widget.display_name, tabify=True)
        dock.setWindowTitle(widget.display_name)  # the plugin's name beside each would leave the tabs no room
        docks.append(dock)
    for bar in docks[0].parent().findChildren(QTabBar):
        bar.setElideMode(Qt.TextElideMode.ElideNone)
    QTimer.singleShot(0, docks[0].raise_)  # not before the window has laid them out
    viewer.open_sample(PLUGIN, SAMPLE)
    viewer.canvas.overlays.scale_bar.visible = True
    viewer.reset_view()


def main() -> None:
    """Open the window and stay until it is closed; a termination closes it as a click would."""
    viewer = napari.Viewer()
    fill(viewer)
    signal.signal(signal.SIGTERM, lambda *_: viewer.close())
    napari.run()


if __name__ == "__main__":
    main()
