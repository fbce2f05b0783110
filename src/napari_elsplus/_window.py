"""napari with the plugin in it: ``python -m napari_elsplus._window``.

Opens the dock with all panels, the same as in the Plugins menu, and the simulated recording.
"""

from __future__ import annotations

import signal
from typing import Final

import napari
from napari.settings import get_settings
from qtpy.QtCore import QTimer
from qtpy.QtGui import QGuiApplication

PLUGIN: Final = "napari-elsplus"
DOCK: Final = "ELS+"
SAMPLE: Final = "recording"
SHARE_OF_SCREEN: Final = 0.85
"""Size of the first window relative to the screen; chosen."""


def fill(viewer: napari.Viewer) -> None:
    """Add the plugin's dock to a viewer, and open a sample."""
    dock, _ = viewer.window.add_plugin_dock_widget(PLUGIN, DOCK)
    dock.setWindowTitle(DOCK)
    viewer.open_sample(PLUGIN, SAMPLE)
    viewer.canvas.overlays.scale_bar.visible = True
    QTimer.singleShot(0, lambda: QTimer.singleShot(0, viewer.reset_view))  # after the layout has resized the canvas


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
