"""What panels share that use the engine: one connection, answers without waiting, and an orderly end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from qtpy.QtCore import QEvent, QObject

from napari_elsplus.widgets.asking import Asking
from napari_elsplus.widgets.connection import join
from napari_elsplus.widgets.panel import Panel

if TYPE_CHECKING:
    import napari.viewer


class EnginePanel(Panel):
    """A docked panel that uses the engine; it leaves it when the dock or the window is closed.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer)
        self.connection = join()
        self.asking = Asking(self, self.refresh)
        self._watches = False
        self._left = False

    def refresh(self) -> None:
        """Show how things are; called when an answer has come, and now and then."""
        window = self.window()
        if window is not None and window is not self and not self._watches:
            self._watches = True
            window.installEventFilter(self)

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Leave the engine when the window closes: it is hidden then, by the program and not by the screen."""
        window = self.window()
        if event is not None and window is not None and watched is window:
            hides = event.type() == QEvent.Type.Hide and not event.spontaneous()
            if hides or (event.type() == QEvent.Type.Close and not window.isVisible()):
                self.cleanup()
        return bool(super().eventFilter(watched, event))

    def cleanup(self) -> None:
        """Let go of the engine and the viewer."""
        if self._left:
            return
        self._left = True
        self.asking.stop()
        self.connection.leave()
        super().cleanup()
