"""What panels share that use the engine: one connection, answers without waiting, and an orderly end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.io.calibration_lookup import active_calibration_for_rig
from napari_elsplus.widgets.shared.asking import Asking
from napari_elsplus.widgets.shared.connection import join
from napari_elsplus.widgets.shared.panel import Panel, told
from napari_elsplus.widgets.shared.window_end import WindowEnd

if TYPE_CHECKING:
    from collections.abc import Callable

    import napari.viewer

    from napari_elsplus.acquisition.link.client import EngineClient


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

    def activate_calibration(self, client: EngineClient, then: Callable[[], None] = lambda: None) -> None:
        """Let a rig that has none work by the calibration that is known, and go on, whether it can use it or not.

        Parameters
        ----------
        client : EngineClient
            Just connected.
        then : callable
            Called afterwards.

        Notes
        -----
        What the panels share comes first, then the active calibration unless it was acquired with another rig.
        """
        known, path = self.connection.calibration, self.connection.calibration_file
        if known is None:
            with told():
                known, path = active_calibration_for_rig(self.connection.rig)
        if known is None or client.calibration is not None:
            then()
        else:
            self.asking.ask(self.connection.take(known, path), lambda _: then(), otherwise=then)

    def cleanup(self) -> None:
        """Let go of the engine and the viewer."""
        if self._left:
            return
        self._left = True
        self.asking.stop()
        self.connection.leave()
        super().cleanup()
        if self.parent() is None:  # the dock has let go of it, and nobody else holds it
            self.deleteLater()
