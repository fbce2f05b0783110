"""Detect that the main window closes: a docked panel receives no event then."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from qtpy.QtCore import QEvent, QObject, QTimer

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
    """

    def __init__(self, panel: QWidget, closed: Callable[[], None]) -> None:
        super().__init__(panel)
        self._panel, self._closed = panel, closed
        self._search = QTimer(self)
        self._search.setInterval(SEARCH_INTERVAL_MS)
        self._search.timeout.connect(self._find)
        self._search.start()

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Detect that the watched window closes, by the event that hides it; see :meth:`QObject.eventFilter`."""
        if event is not None and event.type() in (QEvent.Type.Hide, QEvent.Type.Close):
            window = self._window()
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
