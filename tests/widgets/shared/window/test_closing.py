"""A window that is closed while something is not saved, or is being saved."""

from __future__ import annotations

import pytest
from qtpy.QtWidgets import QMainWindow, QWidget

from napari_elsplus.widgets.shared.window.closing import WindowCloseFilter
from napari_elsplus.widgets.shared.window.main_window import SEARCH_INTERVAL_MS


class Panel(QWidget):
    def __init__(self) -> None:
        super().__init__()
        self.closed, self.question, self.writes = 0, "", False
        self.end = WindowCloseFilter(self, self.note, lambda: self.question, lambda: self.writes)

    def note(self) -> None:
        self.closed += 1


@pytest.fixture
def window(qtbot):
    window = QMainWindow()
    qtbot.addWidget(window)
    window.setCentralWidget(Panel())
    window.show()
    qtbot.waitUntil(window.isVisible, timeout=60_000)
    qtbot.wait(5 * SEARCH_INTERVAL_MS)
    return window


def test_the_window_remains_unless_the_user_agrees(window, questions):
    panel = window.centralWidget()
    panel.question, questions.answer = "It was not saved. Discard it?", False
    assert not window.close()
    assert (window.isVisible(), panel.closed, questions) == (True, 0, [panel.question])
    questions.answer = True
    assert window.close()
    assert panel.closed


def test_the_window_closes_once_a_result_is_saved_and_asks_nothing(window, qtbot, questions, said):
    """Before: it asked whether to discard what was being written."""
    panel = window.centralWidget()
    panel.question, panel.writes = "It was not saved. Discard it?", True
    for _ in range(2):
        assert not window.close()
    assert [words for _, words in said()] == ["a result is being saved; the window closes afterwards"]
    qtbot.wait(300)
    assert (window.isVisible(), panel.closed) == (True, 0)
    panel.question, panel.writes = "", False
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=60_000)
    assert panel.closed
    assert questions == []


def test_the_window_asks_once_where_saving_has_failed(window, qtbot, questions):
    panel = window.centralWidget()
    panel.question, panel.writes, questions.answer = "It was not saved. Discard it?", True, False
    window.close()
    panel.writes = False
    qtbot.waitUntil(lambda: bool(questions), timeout=60_000)
    qtbot.wait(300)
    assert (window.isVisible(), questions) == (True, [panel.question])
