"""Measure whether the text of each widget fits the place that it has on the screen."""

from __future__ import annotations

from typing import TYPE_CHECKING

from qtpy.QtCore import QPoint, QRect
from qtpy.QtGui import QTextDocument
from qtpy.QtWidgets import (
    QAbstractButton,
    QAbstractSpinBox,
    QComboBox,
    QLabel,
    QProgressBar,
    QStyle,
    QStyleOptionComboBox,
    QTabBar,
)

if TYPE_CHECKING:
    from qtpy.QtWidgets import QWidget

TOLERANCE_PX = 1
"""Rounding of font metrics, pixels; chosen."""


def clipped_texts(panel: QWidget) -> list[str]:
    """Return the texts of a panel that need more room than they have, each with both widths in pixels.

    Parameters
    ----------
    panel : QWidget
        Visible; labels, buttons, fields, progress bars and tabs in it are measured.
    """
    measured = [
        *((label, _label(label)) for label in panel.findChildren(QLabel)),
        *((button, _button(button)) for button in panel.findChildren(QAbstractButton)),
        *((choice, _choice(choice)) for choice in panel.findChildren(QComboBox)),
        *((field, _number(field)) for field in panel.findChildren(QAbstractSpinBox)),
        *((bar, _progress(bar)) for bar in panel.findChildren(QProgressBar)),
    ]
    found = []
    for widget, (text, need_px, have_px) in measured:
        if not widget.isVisible() or not text:
            continue
        if need_px > have_px + TOLERANCE_PX:
            found.append(f"{text!r} needs {need_px} px and has {have_px}")
        elif _outside(widget, panel):
            found.append(f"{text!r} reaches beyond the panel")
    for bar in panel.findChildren(QTabBar):
        for index in range(bar.count()):
            text = bar.tabText(index)
            need_px, have_px = bar.fontMetrics().horizontalAdvance(text), bar.tabRect(index).width()
            if need_px > have_px or bar.tabRect(index).right() > bar.width():
                found.append(f"tab {text!r} needs {need_px} px and has {have_px}")
    return found


def _label(label: QLabel) -> tuple[str, int, int]:
    """Return text, needed and present size: widths, or heights where the text is wrapped."""
    document = QTextDocument()
    document.setDefaultFont(label.font())
    document.setDocumentMargin(0)
    document.setHtml(label.text()) if "<" in label.text() else document.setPlainText(label.text())
    text = document.toPlainText().replace("\n", " ")
    if label.wordWrap():
        return text, label.heightForWidth(label.width()), label.height()
    return text, round(document.idealWidth()), label.contentsRect().width()


def _button(button: QAbstractButton) -> tuple[str, int, int]:
    text = button.text()
    return text, button.fontMetrics().horizontalAdvance(text), button.contentsRect().width()


def _choice(choice: QComboBox) -> tuple[str, int, int]:
    option = QStyleOptionComboBox()
    choice.initStyleOption(option)
    style = choice.style()
    assert style is not None
    field: QRect = style.subControlRect(
        QStyle.ComplexControl.CC_ComboBox, option, QStyle.SubControl.SC_ComboBoxEditField, choice
    )
    return choice.currentText(), choice.fontMetrics().horizontalAdvance(choice.currentText()), field.width()


def _progress(bar: QProgressBar) -> tuple[str, int, int]:
    text = bar.text() if bar.isTextVisible() else ""
    return text, bar.fontMetrics().horizontalAdvance(text), bar.contentsRect().width()


def _number(field: QAbstractSpinBox) -> tuple[str, int, int]:
    line = field.lineEdit()
    assert line is not None
    return field.text(), field.fontMetrics().horizontalAdvance(field.text()), line.width()


def _outside(widget: QWidget, panel: QWidget) -> bool:
    left = widget.mapTo(panel, QPoint(0, 0)).x()
    return left < 0 or left + widget.width() > panel.width() + TOLERANCE_PX
