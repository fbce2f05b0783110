"""Scrolling a panel."""

from __future__ import annotations

import pytest
from magicgui.widgets import ComboBox, FloatSpinBox, SpinBox
from qtpy.QtCore import QLocale, Qt
from qtpy.QtWidgets import QApplication, QDoubleSpinBox, QLabel, QScrollArea, QSpinBox, QWidget

from napari_elsplus.widgets.shared.panel import form_layout, panel_layout


@pytest.mark.parametrize("focused", [False, True])
def test_the_wheel_scrolls_over_fields_and_changes_none(qtbot, turn_wheel, focused):
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


@pytest.mark.parametrize("language", ["C", "de_DE"])
@pytest.mark.parametrize("typed", ["7.648", "7,648"])
def test_decimal_points_and_commas_are_understood_in_every_language_and_points_written(qtbot, language, typed):
    """Before: a line period of 7,648 us was taken for 764 us."""
    panel = QWidget()
    qtbot.addWidget(panel)
    field = QDoubleSpinBox()
    field.setDecimals(4)
    field.setRange(0, 1000)
    field.setLocale(QLocale(language))
    panel_layout(panel).addWidget(field)
    panel.show()
    qtbot.waitExposed(panel)
    field.selectAll()
    qtbot.keyClicks(field, typed)
    qtbot.keyClick(field, Qt.Key.Key_Return)
    assert field.value() == 7.648
    assert field.text() == "7.6480"


@pytest.mark.parametrize("copied", ["7,648", "7.648", " 7,648\t", "7,648\r\n"])
def test_a_number_that_is_pasted_from_a_spreadsheet_is_understood_and_passes_no_other_value(qtbot, copied):
    """Before: 7,648 was pasted as 7648, and one with a blank not at all."""
    panel, values = QWidget(), []
    qtbot.addWidget(panel)
    field = QDoubleSpinBox()
    field.setDecimals(4)
    field.setRange(0, 10_000)
    panel_layout(panel).addWidget(field)
    panel.show()
    qtbot.waitExposed(panel)
    field.valueChanged.connect(values.append)
    QApplication.clipboard().setText(copied)
    field.selectAll()
    field.lineEdit().paste()
    qtbot.keyClick(field, Qt.Key.Key_Return)
    assert set(values) == {7.648}
    assert field.text() == "7.6480"


def test_a_number_with_thousands_is_not_taken_for_another(qtbot):
    panel = QWidget()
    qtbot.addWidget(panel)
    field = QDoubleSpinBox()
    field.setRange(0, 10_000)
    field.setValue(5)
    panel_layout(panel).addWidget(field)
    panel.show()
    qtbot.waitExposed(panel)
    QApplication.clipboard().setText("1.234,5")
    field.selectAll()
    field.lineEdit().paste()
    qtbot.keyClick(field, Qt.Key.Key_Return)
    assert field.value() == 5
