"""Plots: new numbers go into what is drawn, everything else is drawn anew."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.widgets.shared.plots import Band, Curve, ThemedPlot

X = np.linspace(0, 1, 9)


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
