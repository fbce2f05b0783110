"""The ELS+ dock: every panel as a tab, and the status line that all have in common."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from qtpy.QtCore import QSize, Qt
from qtpy.QtWidgets import QDockWidget, QSizePolicy, QTabWidget, QVBoxLayout

from napari_elsplus.widgets.dock.status_line import StatusLine
from napari_elsplus.widgets.dock.tab import MIN_WIDTH_PX, PanelKind, Tab
from napari_elsplus.widgets.shared.engine_panel import EnginePanel
from napari_elsplus.widgets.shared.panel import timer
from napari_elsplus.widgets.shared.window.garbage import leave_out_present_objects
from napari_elsplus.widgets.shared.window.scrolling import width_limit_px

if TYPE_CHECKING:
    import napari.viewer

PANELS: Final = (
    PanelKind("Rig", "napari_elsplus.widgets.live.rig:RigPanel"),
    PanelKind("Calibration", "napari_elsplus.widgets.calibration.panel:CalibrationPanel"),
    PanelKind("Live", "napari_elsplus.widgets.live.panel:LivePanel"),
    PanelKind("Mosaic", "napari_elsplus.widgets.mosaic.panel:MosaicPanel"),
    PanelKind("Compare", "napari_elsplus.widgets.analysis.compare:ComparePanel"),
    PanelKind("Axial response", "napari_elsplus.widgets.analysis.axial:AxialResponsePanel"),
    PanelKind("Quality", "napari_elsplus.widgets.analysis.quality:QualityPanel"),
)
"""From left to right, in the order of the work; the manifest declares each as a widget of its own, too."""
FIRST: Final = "Compare"
"""The tab in front at first: it needs no instrument."""
TAB_STYLE: Final = "QTabBar {background: none; border: none; padding: 0px} QTabBar::tab {padding: 4px 2px}"
"""Of the tabs; napari's draws its own frame around the bar, which cuts their tops."""
STATUS_MS: Final = 200
"""Interval of the status line, milliseconds; chosen, faster than it can be read."""


class _Tabs(QTabWidget):
    """Tabs that are all seen; arrows scroll them only where the font makes them too wide for the window of a laptop."""

    def minimumSizeHint(self) -> QSize:
        """Return the width of the tabs within the dock's limits, and the height of a panel that scrolls."""
        bar = self.tabBar()
        tabs_px = bar.sizeHint().width() if bar is not None else 0
        width_px = min(max(MIN_WIDTH_PX, tabs_px), width_limit_px(self))
        return super().minimumSizeHint().expandedTo(QSize(width_px, 0))


class ElsPlusDock(EnginePanel):
    """All panels in one dock.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer.

    Notes
    -----
    The front tab is built first and the others one by one in the following turns of the event loop, so that the window
    appears at once and every key acts from any tab.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer)
        self.tabs = _Tabs()
        self.tabs.setDocumentMode(True)
        self.tabs.setStyleSheet(TAB_STYLE)
        bar = self.tabs.tabBar()
        assert bar is not None
        bar.setDrawBase(False)
        self.tabs.setElideMode(Qt.TextElideMode.ElideNone)
        self.by_title = {kind.title: Tab(kind, viewer) for kind in PANELS}
        for title, tab in self.by_title.items():
            self.tabs.addTab(tab, title)
        self.status_line = StatusLine()
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(0)
        layout.addWidget(self.tabs, 1)
        layout.addWidget(self.status_line)
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Expanding)
        self.by_title[FIRST].build()
        self.show_tab(FIRST)
        self.tabs.currentChanged.connect(lambda _: self._build_current())
        self._timer = timer(self, STATUS_MS, self.refresh, starts=True)
        self._idle = timer(self, 0, self._build_next, starts=True)
        self.refresh()

    def show_tab(self, title: str) -> None:
        """Bring the tab with a title to the front."""
        self.tabs.setCurrentWidget(self.by_title[title])

    def refresh(self) -> None:
        """Update the status line, and keep the tabs below the dock's title."""
        self.status_line.update_from(self.connection)
        self._leave_room_for_title()

    def lost_with_dock(self) -> str:
        """Return the questions of the panels in the tabs; each asks for itself where the window is closed."""
        return " ".join(tab.panel.unsaved() for tab in self.by_title.values() if tab.panel is not None).strip()

    def cleanup(self) -> None:
        """Release what the panels in the tabs use, then the engine and the viewer."""
        if not self._closed:
            self._timer.stop()
            self._idle.stop()
            for tab in self.by_title.values():
                tab.cleanup()
        super().cleanup()

    def _leave_room_for_title(self) -> None:
        """Begin below the dock's title bar, which napari gives less height than its text needs, by the font."""
        dock, layout = self.parentWidget(), self.layout()
        title = dock.titleBarWidget() if isinstance(dock, QDockWidget) else None
        covered_px = 0 if title is None else max(0, title.geometry().bottom() + 1 - self.y())
        if layout is not None and layout.contentsMargins().top() != covered_px:
            layout.setContentsMargins(0, covered_px, 0, 0)

    def _build_current(self) -> None:
        tab = self.tabs.currentWidget()
        assert isinstance(tab, Tab)
        tab.build()

    def _build_next(self) -> None:
        waiting = [tab for tab in self.by_title.values() if not tab.built]
        if waiting:
            waiting[0].build()
        else:
            self._idle.stop()
            leave_out_present_objects(self.viewer)
