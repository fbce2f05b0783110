"""Plots: new numbers go into what is drawn, everything else is drawn anew."""

from __future__ import annotations

import numpy as np
import pytest
from qtpy.QtGui import QPainter, QPicture

from napari_elsplus.widgets.shared.plots import Band, Curve, ThemedPlot

X = np.linspace(0, 1, 9)
MARGIN_PX = 8
"""Empty rim of a label's text, which may lie outside."""


@pytest.fixture
def plot(qtbot):
    widget = ThemedPlot("time / s", "light", "dark")
    qtbot.addWidget(widget)
    widget.draw([Curve("signal", X, X**2, "blue")], bands=[Band(0.2, 0.4, "green")])
    return widget


def drawn(plot):
    return plot.plotItem.listDataItems()


def test_new_numbers_are_put_into_what_is_drawn(plot):
    before = drawn(plot)
    plot.draw([Curve("signal", X, X**3, "blue")], bands=[Band(0.5, 0.6, "green")])
    assert drawn(plot) == before
    np.testing.assert_array_equal(before[0].getData()[1], X**3)
    (band,) = (item for item in plot.plotItem.items if hasattr(item, "getRegion"))
    assert band.getRegion() == (0.5, 0.6)


def test_a_mark_that_is_gone_is_taken_away(plot):
    plot.draw([Curve("signal", X, X, "blue")], marks=[(0.5, "grey", "middle")])
    marked = len(plot.plotItem.items)
    plot.draw([Curve("signal", X, X, "blue")])
    assert len(plot.plotItem.items) == marked - 1


@pytest.mark.parametrize("change", ["name", "colour", "mark", "theme", "band"])
def test_whatever_else_changes_is_drawn_anew(plot, change):
    before = drawn(plot)
    curve = Curve("other" if change == "name" else "signal", X, X, "orange" if change == "colour" else "blue")
    marks = [(0.5, "grey", "middle")] if change == "mark" else []
    bands = [] if change == "band" else [Band(0.5, 0.6, "green")]
    if change == "theme":
        plot.apply_theme("light")
    else:
        plot.draw([curve], marks=marks, bands=bands)
    assert len(drawn(plot)) == 1
    assert drawn(plot) != before


def test_an_empty_plot_has_no_axes(plot):
    for curves in ([Curve("signal", X, X, "blue")], []):
        plot.draw(curves)
        assert [plot.getAxis(side).isVisible() for side in ("bottom", "left")] == [bool(curves)] * 2


def tick_labels(plot, side):
    """Places of an axis' tick labels in the plot, as it would draw them."""
    axis, picture = plot.getAxis(side), QPicture()
    painter = QPainter(picture)
    painter.setFont(axis.style["tickFont"])
    _, _, texts = axis.generateDrawSpecs(painter)
    painter.end()
    return [axis.mapRectToScene(rect) for rect, _, _ in texts]


@pytest.mark.parametrize(
    "names", [["a", "b"], ["signal kept (%)", "3 dB (\N{MICRO SIGN}m)", "10 dB (\N{MICRO SIGN}m)"], ["a" * 30] * 4]
)
def test_at_its_least_height_neither_legend_nor_tick_labels_are_cut(plot, qtbot, names):
    drawn = [Curve(name, 1e4 * X - 5e3, -1e4 * X, "blue") for name in names]
    plot.draw(drawn)
    plot.resize(400, plot.minimumSizeHint().height())
    plot.draw([])
    plot.show()
    qtbot.wait(50)
    plot.hide()
    plot.draw(drawn, left="a quantity in a unit with long names")  # as a result appears in a panel whose size stays
    plot.resize(400, plot.minimumSizeHint().height())
    plot.show()
    for position in (0, 1):  # what is followed: only a mark moves
        qtbot.wait(50)
        plot.draw(drawn, marks=[(position, "blue", "now")], left="a quantity in a unit with long names")
    qtbot.wait(50)
    curves, legend, whole = (one.sceneBoundingRect() for one in (plot.getViewBox(), plot._legend, plot.plotItem))
    assert curves.height() > 50
    assert legend.top() >= curves.bottom()
    assert legend.bottom() <= whole.bottom()
    for side in ("bottom", "left"):
        label = plot.getAxis(side).label
        place = label.mapRectToScene(label.boundingRect())
        assert plot.sceneRect().adjusted(-MARGIN_PX, -MARGIN_PX, MARGIN_PX, MARGIN_PX).contains(place), side
        labels = tick_labels(plot, side)
        assert len(labels) > 1
        assert all(plot.sceneRect().contains(label) for label in labels), side


def test_the_wheel_does_not_zoom(plot, qtbot, turn_wheel):
    """Before: scrolling the panel over a plot zoomed it, and nothing led back."""
    plot.show()
    qtbot.waitExposed(plot)
    shown = plot.viewRange()
    turn_wheel(plot.viewport(), 240)
    assert plot.viewRange() == shown
