"""napari with the plugin in it: ``python -m napari_elsplus._window``.

Opens the dock with all panels, the same as in the Plugins menu, and the simulated recording.
"""

from __future__ import annotations

import signal
from typing import Final

import napari
from napari.settings import get_settings
from qtpy.QtCore import QSize, QTimer
from qtpy.QtGui import QGuiApplication
from qtpy.QtWidgets import QApplication

PLUGIN: Final = "napari-elsplus"
DOCK: Final = "ELS+"
SAMPLE: Final = "recording"
SHARE_OF_SCREEN: Final = 0.85
"""Size of the first window relative to the screen; chosen."""
MIN_SIZE: Final = QSize(1440, 900)
"""Of the first window, pixels, where the screen has as many; chosen: some 650 are left between the docks for images."""
SIGNALS_MS: Final = 100
"""Period in which signals are handled, milliseconds; chosen: below the 0.5 s in which the galvo parks."""


def fill(viewer: napari.Viewer) -> None:
    """Add the plugin's dock to a viewer, and open a sample."""
    dock, _ = viewer.window.add_plugin_dock_widget(PLUGIN, DOCK)
    dock.setWindowTitle(DOCK)
    viewer.open_sample(PLUGIN, SAMPLE)


def first_size(screen: QSize) -> QSize:
    """Return the size of the first window, in pixels: napari's is too small for a panel beside images.

    Parameters
    ----------
    screen : QSize
        What is free on the screen.
    """
    return (screen * SHARE_OF_SCREEN).expandedTo(MIN_SIZE).boundedTo(screen)


def close_at_once(viewer: napari.Viewer) -> None:
    """Close a viewer without questions about what is not saved, and end the application; the engine parks and ends.

    Parameters
    ----------
    viewer : napari.Viewer
        Its panels release the engine when its window is hidden, and open no dialog when it is closed then.
    """
    for window in QApplication.topLevelWidgets():
        if window.isVisible():
            window.close() if window.isModal() else window.hide()  # a question that is closed is answered by Cancel
    viewer.close()
    QApplication.quit()


def close_on_signals(viewer: napari.Viewer) -> QTimer:
    """Close a viewer without questions on SIGINT, SIGTERM and SIGHUP, the galvo parked by the end of the engine.

    Parameters
    ----------
    viewer : napari.Viewer
        Closed in the main thread.

    Returns
    -------
    QTimer
        Lets Python handle signals while the window is idle; to be kept.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, name):  # Windows has not all of them
            signal.signal(getattr(signal, name), lambda *_: close_at_once(viewer))
    timer = QTimer()
    timer.timeout.connect(lambda: None)
    timer.start(SIGNALS_MS)
    return timer


def main() -> None:
    """Open the window and run until it is closed; signals that end programs close it."""
    viewer = napari.Viewer()
    screen = QGuiApplication.primaryScreen()
    if get_settings().application.window_size is None and screen is not None:
        size = first_size(screen.availableSize())
        viewer.window.resize(size.width(), size.height())
    fill(viewer)
    timer = close_on_signals(viewer)
    napari.run()
    timer.stop()


if __name__ == "__main__":
    main()
