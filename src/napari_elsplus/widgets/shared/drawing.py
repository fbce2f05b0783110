"""Notice when the viewer's canvas has drawn, so that it is not given more than it can show."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from qtpy.QtCore import QEvent, QObject
from qtpy.QtWidgets import QOpenGLWidget  # type: ignore[attr-defined] # where Qt 6 has it

if TYPE_CHECKING:
    from qtpy.QtWidgets import QWidget

PATIENCE_S: Final = 0.25
"""A hidden canvas never draws; it is given something new after so long."""


class Drawing(QObject):
    """Watches the canvas in the main window of a docked panel.

    Parameters
    ----------
    panel : QWidget
        The panel.

    Attributes
    ----------
    drawn : int
        How often the canvas was drawn since it is watched.
    canvas_px : tuple of int
        Its height and width when it was drawn last.
    """

    def __init__(self, panel: QWidget) -> None:
        super().__init__(panel)
        self._panel = panel
        self._watches = False
        self._asked_s: float | None = None
        self.drawn = 0
        self.canvas_px = (0, 0)

    @property
    def pending(self) -> bool:
        """Whether the canvas has yet to draw what it was given last."""
        return self._asked_s is not None and time.perf_counter() - self._asked_s < PATIENCE_S

    def ask(self) -> None:
        """Say that the canvas was given something new."""
        if not self._watches:
            self._find()
        self._asked_s = time.perf_counter() if self._watches else None

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """See the canvas being drawn."""
        if event is not None and event.type() == QEvent.Type.Paint:
            self._asked_s = None
            self.drawn += 1
            if isinstance(watched, QOpenGLWidget):
                self.canvas_px = watched.height(), watched.width()
        return bool(super().eventFilter(watched, event))

    def _find(self) -> None:
        window = self._panel
        while (parent := window.parentWidget()) is not None:
            window = parent
        for canvas in window.findChildren(QOpenGLWidget):
            canvas.installEventFilter(self)
            self._watches = True
