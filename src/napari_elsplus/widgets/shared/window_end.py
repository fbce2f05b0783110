"""Notice that the window is closed: a docked panel is not told."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from qtpy.QtCore import QEvent, QObject, QTimer

if TYPE_CHECKING:
    from collections.abc import Callable

    from qtpy.QtWidgets import QWidget

LOOK_MS: Final = 20


class WindowEnd(QObject):
    """Calls back when the main window closes that a panel is docked to, also where the dock floats.

    Parameters
    ----------
    panel : QWidget
        The panel; docked sooner or later.
    left : callable
        Called when the window closes; may be called more than once.
    """

    def __init__(self, panel: QWidget, left: Callable[[], None]) -> None:
        super().__init__(panel)
        self._panel, self._left = panel, left
        self._look = QTimer(self)
        self._look.setInterval(LOOK_MS)
        self._look.timeout.connect(self._find)
        self._look.start()

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """See the window close: it is hidden then, by the program and not by the screen."""
        if event is not None and event.type() in (QEvent.Type.Hide, QEvent.Type.Close):
            window = self._window()
            hides = event.type() == QEvent.Type.Hide and not event.spontaneous()
            if watched is window and (hides or (event.type() == QEvent.Type.Close and not window.isVisible())):
                self._left()
        return bool(super().eventFilter(watched, event))

    def _window(self) -> QWidget:
        """Find the outermost widget; not kept, so that the window can go."""
        widget = self._panel
        while (parent := widget.parentWidget()) is not None:
            widget = parent
        return widget

    def _find(self) -> None:
        window = self._window()
        if window is not self._panel:
            self._look.stop()
            window.installEventFilter(self)
