"""What all panels owe whoever uses them."""

from __future__ import annotations

import re
from threading import Event

import pytest
from qtpy.QtWidgets import QLabel, QProgressBar, QPushButton

from napari_elsplus.acquisition.engine.status import Status
from napari_elsplus.errors import InputError
from napari_elsplus.processing.compilation import report_compilation
from napari_elsplus.widgets.dock.status_line import rig_line
from napari_elsplus.widgets.shared.work import Work

PLUGIN = "napari-elsplus"


@pytest.mark.parametrize("name", ["Compare", "Axial response", "Quality"])
def test_a_button_that_cannot_be_pressed_says_what_comes_first(make_napari_viewer_proxy, name):
    _, panel = make_napari_viewer_proxy().window.add_plugin_dock_widget(PLUGIN, name)
    barred = [button for button in panel.findChildren(QPushButton) if not button.isEnabled()]
    assert len(barred) >= 3
    assert [button.text() for button in barred if "; first " not in button.toolTip()] == []


def test_the_bar_names_the_kernel_that_is_compiled_meanwhile(qtbot):
    compiled, ended, results = Event(), Event(), []
    work = Work(lambda: None)
    qtbot.addWidget(work)
    label = work.findChild(QLabel)

    def compute():
        report_compilation("align")
        compiled.wait(100)
        report_compilation("")
        ended.wait(100)
        return 3

    work.begin(0, compute, results.append)
    try:
        qtbot.waitUntil(lambda: label.text() == "compiling align, once after an installation", timeout=60_000)
        assert label.isVisible()
        compiled.set()
        qtbot.waitUntil(lambda: not label.isVisible(), timeout=60_000)
    finally:
        compiled.set()
        ended.set()
    qtbot.waitUntil(lambda: not work.busy, timeout=60_000)
    assert results == [3]


def test_the_bar_displays_the_time_that_is_left(qtbot):
    """Before: steps in a second, from which nobody can tell how long it takes."""
    ended = Event()
    work = Work(lambda: None)
    qtbot.addWidget(work)
    bar = work.findChild(QProgressBar)

    def compute():
        for step in work.progress(range(50)):
            if step == 40:
                ended.wait(100)

    work.begin(0, compute, lambda result: None)
    try:
        qtbot.waitUntil(lambda: re.fullmatch(r"%p %, \d+ s left", bar.format()) is not None, timeout=60_000)
        assert bar.value() == 40
    finally:
        ended.set()
    qtbot.waitUntil(lambda: not work.busy, timeout=60_000)


def test_each_step_of_a_computation_is_named_above_its_own_bar(qtbot):
    work, ended = Work(lambda: None), Event()
    qtbot.addWidget(work)

    def compute():
        for name in ("Tracking", "Tracking again"):
            for step in work.progress(range(20), name):
                if (name, step) == ("Tracking again", 10):
                    ended.wait(100)

    work.begin(0, compute, lambda result: None)
    try:
        bar = work.findChild(QProgressBar)
        qtbot.waitUntil(lambda: (bar.value(), bar.maximum()) == (10, 20), timeout=60_000)
        assert work._step.text() == "Tracking again"
        assert not work._step.isHidden()
    finally:
        ended.set()
    qtbot.waitUntil(lambda: not work.busy, timeout=60_000)


def test_the_status_line_names_the_kernel_that_the_engine_compiles():
    assert "compiling align" in rig_line("simulated", Status(compiling="align"))
    assert "compiling" not in rig_line("simulated", Status())


def test_a_computation_is_refused_while_another_runs_whose_result_is_delivered_to_its_own_function(qtbot):
    """Before: the first result went to the second function, and the second result raised an AttributeError."""
    ended, first, second = Event(), [], []
    work = Work(lambda: None)
    qtbot.addWidget(work)
    work.begin(0, lambda: ended.wait(100), first.append)
    try:
        with pytest.raises(InputError, match="press Cancel"):
            work.begin(0, lambda: False, second.append)
    finally:
        ended.set()
    qtbot.waitUntil(lambda: not work.busy, timeout=60_000)
    assert (first, second) == ([True], [])
