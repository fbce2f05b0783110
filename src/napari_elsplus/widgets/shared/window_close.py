"""Detect that the main window closes, and ask first where something is not saved; a docked panel gets no event."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from qtpy.QtCore import QEvent, QObject, QTimer
from qtpy.QtWidgets import QMessageBox

if TYPE_CHECKING:
    from collections.abc import Callable

    from qtpy.QtWidgets import QWidget

SEARCH_INTERVAL_MS: Final = 20
"""Interval of the search for the main window until the panel is docked, milliseconds; chosen."""


class WindowCloseFilter(QObject):
    """Calls a function when the main window of a docked panel closes, also where the dock floats.

    Parameters
    ----------
    panel : QWidget
        The panel; may be docked later.
    closed : callable
        Called when the window closes; may be called more than once.
    unsaved : callable, optional
        Returns a question if something would be lost by closing; the window remains open unless the user agrees.
    """

    def __init__(self, panel: QWidget, closed: Callable[[], None], unsaved: Callable[[], str] = lambda: "") -> None:
        super().__init__(panel)
        self._panel, self._closed, self._unsaved = panel, closed, unsaved
        self._search = QTimer(self)
        self._search.setInterval(SEARCH_INTERVAL_MS)
        self._search.timeout.connect(self._find)
        self._search.start()

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Detect that the watched window closes, by the event that hides it; see :meth:`QObject.eventFilter`."""
        if event is not None and event.type() in (QEvent.Type.Hide, QEvent.Type.Close):
            window = self._window()
            if watched is window and event.type() == QEvent.Type.Close and window.isVisible():
                question = self._unsaved()
                if question and not confirm(window, question):
                    event.ignore()
                    return True
            hides = event.type() == QEvent.Type.Hide and not event.spontaneous()
            if watched is window and (hides or (event.type() == QEvent.Type.Close and not window.isVisible())):
                self._closed()
        return bool(super().eventFilter(watched, event))

    def _window(self) -> QWidget:
        """Return the outermost widget; no reference is kept, so that the window can be deleted."""
        widget = self._panel
        while (parent := widget.parentWidget()) is not None:
            widget = parent
        return widget

    def _find(self) -> None:
        window = self._window()
        if window is not self._panel:
            self._search.stop()
            window.installEventFilter(self)


def confirm(parent: QWidget, question: str) -> bool:
    """Return True if the user agrees to discard what was not saved; Cancel is the default.

    Parameters
    ----------
    parent : QWidget
        The dialog is placed over it.
    question : str
        Names what is lost.
    """
    discard, cancel = QMessageBox.StandardButton.Discard, QMessageBox.StandardButton.Cancel
    return bool(QMessageBox.question(parent, "Not saved", question, discard | cancel, cancel) == discard)
