"""A tab of the ELS+ dock: a panel, or a note where the panel has a dock of its own."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final, NamedTuple

from qtpy.QtCore import QEvent, QObject, Qt
from qtpy.QtWidgets import QDockWidget, QLabel, QPushButton, QTabWidget, QVBoxLayout, QWidget

from napari_elsplus.widgets.shared.panel import Panel, find_panel

if TYPE_CHECKING:
    import napari.viewer

MIN_WIDTH_PX: Final = 440
"""Smallest width of the dock, pixels; chosen, so that plots can be read."""


class PanelKind(NamedTuple):
    """Title of a panel, and where its class is: ``module:Class``, imported when the panel is made."""

    title: str
    place: str

    def load(self) -> type[Panel]:
        """Import the class."""
        module, _, name = self.place.partition(":")
        kind: type[Panel] = getattr(import_module(module), name)
        return kind


class Tab(QWidget):
    """Contains a panel, made when it is first needed.

    Parameters
    ----------
    kind : PanelKind
        The panel's title and class.
    viewer : napari.Viewer
        The viewer.
    """

    def __init__(self, kind: PanelKind, viewer: napari.viewer.Viewer) -> None:
        super().__init__()
        self.kind = kind
        self._viewer = viewer
        self._layout = QVBoxLayout(self)
        self._layout.setContentsMargins(0, 0, 0, 0)
        self._content: QWidget | None = None
        self._panel: Panel | None = None

    @property
    def panel(self) -> Panel | None:
        """The panel, while it is in this tab."""
        return self._panel

    @property
    def built(self) -> bool:
        """True once the tab displays the panel, or the note in its place."""
        return self._content is not None

    def build(self) -> None:
        """Make the panel unless it exists; one that has a dock of its own stays there."""
        if self._panel is not None:
            return
        present = find_panel(self.kind.load(), self._viewer)
        if present is None:
            self._hold(self.kind.load()(self._viewer))
        elif self._content is None:
            self._show(self._note())

    def take_panel(self) -> None:
        """Move the panel from its own dock into this tab, and remove the dock; make one if it was closed."""
        panel = find_panel(self.kind.load(), self._viewer)
        if panel is None:
            self.build()
            return
        dock: QWidget | None = panel
        while dock is not None and not isinstance(dock, QDockWidget):
            dock = dock.parentWidget()
        self._hold(panel)
        if dock is not None:
            self._viewer.window.remove_dock_widget(dock)

    def cleanup(self) -> None:
        """Release what the panel uses."""
        if self._panel is not None:
            self._panel.removeEventFilter(self)
            self._panel.cleanup()

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Detect that napari docks the panel elsewhere; see :meth:`QObject.eventFilter`."""
        if event is not None and event.type() == QEvent.Type.ParentChange and watched is self._panel:
            assert self._panel is not None
            if not self.isAncestorOf(self._panel):
                self._panel.removeEventFilter(self)
                self._panel = None
                self._show(self._note())
        return bool(super().eventFilter(watched, event))

    def _hold(self, panel: Panel) -> None:
        self._panel = panel
        panel.installEventFilter(self)
        self._show(panel)
        panel.show()

    def _show(self, content: QWidget) -> None:
        before, self._content = self._content, content
        self._layout.addWidget(content)
        self._follow_tabs(content)
        if before is not None and self.isAncestorOf(before):  # not a panel that was docked elsewhere
            before.deleteLater()

    def _follow_tabs(self, content: QWidget) -> None:
        """Have the Tab key go from the tabs to the content, which Qt appends behind napari's own widgets."""
        tabs = self.parentWidget()
        while tabs is not None and not isinstance(tabs, QTabWidget):
            tabs = tabs.parentWidget()
        if tabs is None:
            return
        last: QWidget | None = tabs.tabBar()
        for one in _in_tab_order(content):
            QWidget.setTabOrder(last, one)
            last = one

    def _note(self) -> QWidget:
        note = QWidget()
        layout = QVBoxLayout(note)
        text = QLabel(f"{self.kind.title} has a dock of its own.")
        text.setAlignment(Qt.AlignmentFlag.AlignCenter)
        back = QPushButton(f"Show {self.kind.title} here")
        back.setToolTip("Move the panel into this tab; nothing is stopped or lost")
        back.clicked.connect(self.take_panel)
        layout.addStretch(1)
        layout.addWidget(text)
        layout.addWidget(back, 0, Qt.AlignmentFlag.AlignCenter)
        layout.addStretch(1)
        return note


def _in_tab_order(content: QWidget) -> list[QWidget]:
    """Return the widgets within a widget that the Tab key reaches, in its order."""
    reached, one = [], content.nextInFocusChain()
    while one is not None and one is not content:
        tabbed = bool(one.focusPolicy() & Qt.FocusPolicy.TabFocus) and one.focusProxy() is None
        if tabbed and content.isAncestorOf(one):
            reached.append(one)
        one = one.nextInFocusChain()
    return reached
