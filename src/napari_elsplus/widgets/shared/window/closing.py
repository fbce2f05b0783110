"""Detect that the main window closes, which a docked panel is not notified of; warn where something is not saved."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari.utils.notifications import show_info
from qtpy.QtCore import QEvent, QObject, QTimer
from qtpy.QtWidgets import QMessageBox

from napari_elsplus.widgets.shared.window.main_window import main_window, when_docked

if TYPE_CHECKING:
    from collections.abc import Callable

    from qtpy.QtWidgets import QWidget

SAVED_MS: Final = 100
"""Interval at which a window that waits to be closed tests whether all is saved, milliseconds; chosen."""


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
    saving : callable, optional
        Returns True while a result is being written: the window closes once that has ended.
    """

    def __init__(
        self,
        panel: QWidget,
        closed: Callable[[], None],
        unsaved: Callable[[], str] = lambda: "",
        saving: Callable[[], bool] = lambda: False,
    ) -> None:
        super().__init__(panel)
        self._panel, self._closed, self._unsaved, self._saving = panel, closed, unsaved, saving
        self._waiting = QTimer(self)
        self._waiting.setInterval(SAVED_MS)
        self._waiting.timeout.connect(self._close_if_saved)
        when_docked(panel, lambda window: window.installEventFilter(self))

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Detect that the watched window closes, by the event that hides it; see :meth:`QObject.eventFilter`."""
        if event is not None and event.type() in (QEvent.Type.Hide, QEvent.Type.Close):
            window = main_window(self._panel)  # no reference is kept, so that the window can be deleted
            if window is not None and watched is window:
                closing = event.type() == QEvent.Type.Close
                if closing and window.isVisible() and not self._may_close(window):
                    event.ignore()
                    return True
                if (closing and not window.isVisible()) or (not closing and not event.spontaneous()):
                    self._closed()
        return bool(super().eventFilter(watched, event))

    def _may_close(self, window: QWidget) -> bool:
        if not self._saving():
            return may_discard(window, self._unsaved())
        if not self._waiting.isActive():
            show_info("a result is being saved; the window closes afterwards")
            self._waiting.start()
        return False

    def _close_if_saved(self) -> None:
        if not self._saving():
            self._waiting.stop()
            window = main_window(self._panel)
            if window is not None:
                window.close()


def may_discard(parent: QWidget, question: str, cause: str = "") -> bool:
    """Return True if nothing is unsaved, or the user agrees to discard it.

    Parameters
    ----------
    parent : QWidget
        The dialog is placed over it.
    question : str
        Names what is lost; empty if nothing is.
    cause : str
        Sentence that precedes the question.
    """
    return not question or confirm(parent, f"{cause} {question}".lstrip())


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
