"""Errors of panels, each notified once."""

from __future__ import annotations

from qtpy.QtWidgets import QWidget

from napari_elsplus._problems import problems


def test_an_error_that_several_panels_meet_is_shown_once(qtbot, said):
    """Before: that the engine had ended was notified by each panel that waited for it."""
    panels = [QWidget(), QWidget()]
    for panel in panels:
        qtbot.addWidget(panel)
        problems.report("the engine ended: connect again", panel)
    assert len(said()) == 1
    problems.resolve(panels[0])
    assert problems.newest == "the engine ended: connect again"
    problems.resolve(panels[1])
    assert not problems.newest
    problems.report("the engine ended: connect again", panels[0])
    assert len(said()) == 2
