"""Scroll area of a panel's content, so that a panel fits a small window, in a tab and in a dock of its own."""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING, Final

from qtpy.QtCore import QEvent, QLocale, QObject, QSize, Qt
from qtpy.QtGui import QValidator
from qtpy.QtWidgets import (
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QDoubleSpinBox,
    QFrame,
    QLayout,
    QScrollArea,
    QWidget,
)

if TYPE_CHECKING:
    from qtpy.QtGui import QShowEvent

MIN_HEIGHT_PX: Final = 260
"""Smallest height of a panel, pixels; chosen: with title, tabs and status line the dock needs about 400."""
MAX_MIN_WIDTH_PX: Final = 525
"""Largest width that the dock demands, pixels; measured: with a font of 13 points napari's own docks and the smallest
canvas leave 532 of 1280. Where tabs or panels need more, in larger fonts, they scroll."""
NAPARI_WIDTH_PX: Final = 626
"""Width of napari's own docks and smallest canvas, and of the dock's frame, pixels; measured."""
LEAST_WIDTH_PX: Final = 174
"""Width that the dock demands on any screen, pixels; chosen: what is left of 800, a screen of 1600 scaled by 2."""

FIELDS: Final = QAbstractSpinBox, QComboBox
"""Kinds of fields that the wheel would change."""


class _DecimalComma(QValidator):
    """Takes a comma that is typed, pasted or dropped for a point, and leaves out the blanks around a pasted number.

    Qt takes the comma for a separator of thousands: 7,648 would be 7648, or 764 where that is too large.

    Parameters
    ----------
    field : QDoubleSpinBox
        Of the language C.
    """

    def __init__(self, field: QDoubleSpinBox) -> None:
        super().__init__(field)
        self._field = field

    def validate(self, text: str | None, cursor: int) -> tuple[QValidator.State, str, int]:
        """Validate a text with its cursor; see :meth:`QValidator.validate`."""
        number = (text or "").replace(",", ".").strip()
        state, number, cursor = self._field.validate(number, min(cursor, len(number)))
        return state, number, cursor


def width_limit_px(widget: QWidget) -> int:
    """Return the largest width that the dock may demand on the screen of a `widget`, in pixels."""
    screen = widget.screen()
    left_px = MAX_MIN_WIDTH_PX if screen is None else screen.availableSize().width() - NAPARI_WIDTH_PX
    return max(LEAST_WIDTH_PX, min(left_px, MAX_MIN_WIDTH_PX))


class PanelScrollArea(QScrollArea):
    """Scrolls a panel's content, sideways only where the font makes it too wide for the window of a laptop.

    The wheel scrolls over fields, too: it would change the settings of a rig that are scrolled past.

    Parameters
    ----------
    content : QWidget
        What is scrolled.

    Attributes
    ----------
    below : QLayout or None
        What lies below in the panel and is not scrolled.
    """

    def __init__(self, content: QWidget) -> None:
        super().__init__()
        self.below: QLayout | None = None
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setWidgetResizable(True)
        self.setWidget(content)

    def minimumSizeHint(self) -> QSize:
        """Return the content's smallest width with the scroll bar, and a height that fits small screens."""
        content, bar = self.widget(), self.verticalScrollBar()
        width_px = (content.minimumSizeHint().width() if content else 0) + (bar.sizeHint().width() if bar else 0)
        below_px = 0 if self.below is None else self.below.sizeHint().height()
        return QSize(min(width_px, width_limit_px(self)), MIN_HEIGHT_PX - below_px)

    def showEvent(self, event: QShowEvent | None) -> None:
        """Watch the fields, and have them write numbers with a point, as texts do; see :meth:`QWidget.showEvent`."""
        for field in chain.from_iterable(map(self.findChildren, FIELDS)):
            field.setLocale(QLocale.c())
            field.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
            field.installEventFilter(self)
            if isinstance(field, QDoubleSpinBox) and not field.findChild(_DecimalComma):
                line = field.lineEdit()
                assert line is not None
                line.setValidator(_DecimalComma(field))
        super().showEvent(event)

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Scroll by the wheel over a field; follow the content's smallest width; see :meth:`QObject.eventFilter`."""
        if event is not None and event.type() == QEvent.Type.Wheel and isinstance(watched, FIELDS):
            QApplication.sendEvent(self.viewport(), event)
            return True
        if event is not None and event.type() == QEvent.Type.LayoutRequest:
            self.updateGeometry()
        return bool(super().eventFilter(watched, event))
