"""The main window of a panel: a dock, a tab or a scroll area may lie between them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QMainWindow, QWidget

if TYPE_CHECKING:
    from collections.abc import Callable

SEARCH_INTERVAL_MS: Final = 20
"""Interval of the search for the main window until the panel is docked, milliseconds; chosen."""


def main_window(panel: QWidget) -> QMainWindow | None:
    """Return the main window of a panel, also where its dock floats; None until it is docked."""
    widget: QWidget | None = panel
    while widget is not None and not isinstance(widget, QMainWindow):
        widget = widget.parentWidget()
    return widget


def when_docked(panel: QWidget, call: Callable[[QMainWindow], None]) -> None:
    """Call a function with the main window of a panel, once the panel is docked in one.

    Parameters
    ----------
    panel : QWidget
        The panel; may be docked later.
    call : callable
        Called once, not before this function returns.
    """
    _Search(panel, call)


class _Search(QTimer):
    """Calls a function once the panel is docked; its slot is a bound method, which keeps no panel alive."""

    def __init__(self, panel: QWidget, call: Callable[[QMainWindow], None]) -> None:
        super().__init__(panel)
        self._call = call
        self.setInterval(SEARCH_INTERVAL_MS)
        self.timeout.connect(self._search)
        self.start()

    def _search(self) -> None:
        panel = self.parent()
        window = main_window(panel) if isinstance(panel, QWidget) else None
        if window is not None:
            self.stop()
            self._call(window)
            self.deleteLater()
