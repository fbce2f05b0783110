"""What panels share that use the engine: one connection, answers without waiting, and an orderly end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.widgets.asking import Asking
from napari_elsplus.widgets.connection import join
from napari_elsplus.widgets.panel import Panel
from napari_elsplus.widgets.window_end import WindowEnd

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
        self._left = False
        self._window_end = WindowEnd(self, self.cleanup)

    def refresh(self) -> None:
        """Show how things are; called when an answer has come, and now and then."""

    def cleanup(self) -> None:
        """Let go of the engine and the viewer."""
        if self._left:
            return
        self._left = True
        self.asking.stop()
        self.connection.leave()
        super().cleanup()
