"""Scroll area of a panel's content, so that a panel fits a small window, in a tab and in a dock of its own."""

from __future__ import annotations

from typing import Final

from qtpy.QtCore import QEvent, QObject, QSize
from qtpy.QtWidgets import QFrame, QScrollArea, QWidget

MIN_HEIGHT_PX: Final = 280
"""Smallest height of a panel, pixels; chosen: with title, tabs and status line the dock needs about 400."""
MAX_MIN_WIDTH_PX: Final = 525
"""Largest width that the dock demands, pixels; measured: with a font of 13 points napari's own docks and the smallest
canvas leave 532 of 1280. Where tabs or panels need more, in larger fonts, they scroll."""


class PanelScrollArea(QScrollArea):
    """Scrolls a panel's content, sideways only where the font makes it too wide for the window of a laptop.

    Parameters
    ----------
    content : QWidget
        What is scrolled.
    """

    def __init__(self, content: QWidget) -> None:
        super().__init__()
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setWidgetResizable(True)
        self.setWidget(content)

    def minimumSizeHint(self) -> QSize:
        """Return the content's smallest width with the scroll bar, and a height that fits small screens."""
        content, bar = self.widget(), self.verticalScrollBar()
        width_px = (content.minimumSizeHint().width() if content else 0) + (bar.sizeHint().width() if bar else 0)
        return QSize(min(width_px, MAX_MIN_WIDTH_PX), MIN_HEIGHT_PX)

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Follow changes of the content's smallest width; see :meth:`QObject.eventFilter`."""
        if event is not None and event.type() == QEvent.Type.LayoutRequest:
            self.updateGeometry()
        return bool(super().eventFilter(watched, event))
