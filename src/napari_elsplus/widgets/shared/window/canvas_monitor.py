"""Paint events of the viewer's canvas, so that it is given no more images than it can draw."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from qtpy.QtCore import QEvent, QObject
from qtpy.QtWidgets import QOpenGLWidget  # type: ignore[attr-defined] # where Qt 6 has it

from napari_elsplus.widgets.shared.window.main_window import main_window

if TYPE_CHECKING:
    from qtpy.QtWidgets import QWidget

PAINT_TIMEOUT_S: Final = 0.25
"""A hidden canvas is never painted; a paint is waited for no longer than this (chosen: ten times a slow redraw)."""


class CanvasMonitor(QObject):
    """Counts the paint events of the canvas in the main window of a docked panel.

    Parameters
    ----------
    panel : QWidget
        The panel.

    Attributes
    ----------
    drawn : int
        Paint events since the first image.
    canvas_px : tuple of int
        Height and width of the canvas when it was painted last.
    """

    def __init__(self, panel: QWidget) -> None:
        super().__init__(panel)
        self._panel = panel
        self._installed = False
        self._updated_s: float | None = None
        self.drawn = 0
        self.canvas_px = (0, 0)

    @property
    def pending(self) -> bool:
        """True until the last update is painted, at most for the timeout."""
        return self._updated_s is not None and time.perf_counter() - self._updated_s < PAINT_TIMEOUT_S

    def expect_paint(self) -> None:
        """Note that the canvas was given a new image."""
        if not self._installed:
            self._install()
        self._updated_s = time.perf_counter() if self._installed else None

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Count a paint event of the watched canvas; see :meth:`QObject.eventFilter`."""
        if event is not None and event.type() == QEvent.Type.Paint:
            self._updated_s = None
            self.drawn += 1
            if isinstance(watched, QOpenGLWidget):
                self.canvas_px = watched.height(), watched.width()
        return bool(super().eventFilter(watched, event))

    def _install(self) -> None:
        window = main_window(self._panel)
        for canvas in window.findChildren(QOpenGLWidget) if window is not None else ():
            canvas.installEventFilter(self)
            self._installed = True
