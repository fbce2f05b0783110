"""Scrolling a panel."""

from __future__ import annotations

import pytest
from magicgui.widgets import ComboBox, FloatSpinBox, SpinBox
from qtpy.QtCore import QPoint, QPointF, Qt
from qtpy.QtGui import QWheelEvent
from qtpy.QtWidgets import QApplication, QLabel, QScrollArea, QSpinBox, QWidget

from napari_elsplus.widgets.shared.panel import form_layout, panel_layout


def turn_wheel(widget):
    """Turn the wheel towards the user over the middle of a widget."""
    at = QPointF(widget.rect().center())
    event = QWheelEvent(
        at, QPointF(widget.mapToGlobal(at.toPoint())), QPoint(), QPoint(0, -120), Qt.MouseButton.NoButton,
        Qt.KeyboardModifier.NoModifier, Qt.ScrollPhase.NoScrollPhase, False,
    )  # fmt: skip
    QApplication.sendEvent(widget, event)


@pytest.mark.parametrize("focused", [False, True])
def test_the_wheel_scrolls_over_fields_and_changes_none(qtbot, focused):
    """Before: slit, rate, gain and preset of a live rig changed when the panel was scrolled over them."""
    panel = QWidget()
    qtbot.addWidget(panel)
    fields = [ComboBox(choices=["a", "b"]), FloatSpinBox(value=5), SpinBox(value=5)]
    layout = panel_layout(panel)
    layout.addLayout(form_layout(*fields))
    plain = QSpinBox()
    plain.setValue(5)
    layout.addWidget(plain)
    filler = QLabel("")
    filler.setMinimumHeight(2000)
    layout.addWidget(filler)
    panel.resize(300, 300)
    panel.show()
    qtbot.waitExposed(panel)
    bar = panel.findChild(QScrollArea).verticalScrollBar()
    for field in (*(one.native for one in fields), plain):
        bar.setValue(0)
        if focused:
            field.setFocus()
        turn_wheel(field)
        assert bar.value() > 0, type(field)
        assert field.hasFocus() <= focused
    assert [one.value for one in fields] == ["a", 5.0, 5]
    assert plain.value() == 5
