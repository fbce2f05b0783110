"""Widgets need a screen, real or virtual."""

from __future__ import annotations

import os
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from napari.utils.notifications import notification_manager
from qtpy.QtCore import QMimeData, QPoint, QPointF, Qt, QUrl
from qtpy.QtGui import QDragEnterEvent, QDropEvent, QWheelEvent
from qtpy.QtWidgets import QApplication

from napari_elsplus._problems import problems
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.link.client import EngineClient
from processes import exists

TESTS = Path(__file__).parents[1]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if sys.platform.startswith("linux") and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ):
        for item in items:
            if "widgets" in item.path.parts:
                item.add_marker(pytest.mark.skip("no screen, and Qt would end the whole run: start under xvfb-run"))


class Clients(list[EngineClient]):
    """Engines that were started; `start` starts one more."""


@pytest.fixture
def viewer(make_napari_viewer_proxy):
    return make_napari_viewer_proxy()


@pytest.fixture(autouse=True)
def _patient_engine(monkeypatch):
    """Panels start the engine's process with limits that are no test of the computer."""
    start = partial(EngineClient, (sys.executable, str(TESTS / "patient_process.py")))
    monkeypatch.setattr("napari_elsplus.widgets.shared.connection.EngineClient", start)


@pytest.fixture
def small_engine(tmp_path, monkeypatch):
    """Panels start the engine on a rig of a few lines, at a rate that leaves time for other tests' work."""
    monkeypatch.setenv("ELSPLUS_CONFIG", str(tmp_path / "settings"))
    command = (sys.executable, str(TESTS / "acquisition" / "engine_process.py"), str(tmp_path / "mirror.log"))
    clients = Clients()

    def start():
        clients.append(EngineClient(command))
        return clients[-1]

    clients.start = start
    monkeypatch.setattr("napari_elsplus.widgets.shared.connection.EngineClient", start)
    slow = Settings("240hz", frame_rate_hz=100.0)
    monkeypatch.setattr("napari_elsplus.widgets.shared.engine_panel.remembered_settings", lambda: slow)
    yield clients
    end = time.monotonic() + 60
    while any(exists(client.pid) for client in clients):  # they end beside the window
        assert time.monotonic() < end, "an engine was left behind"
        time.sleep(0.01)


@pytest.fixture(autouse=True)
def _errors_of_other_tests_are_forgotten() -> None:
    """They are remembered for the process, as for a window."""
    problems.dismiss()


@pytest.fixture(autouse=True)
def questions(monkeypatch):
    """Questions before unsaved results are lost, each answered by the value of `answer`."""
    asked = Questions()
    confirm = lambda _, question: (asked.append(question), asked.answer)[1]  # noqa: E731
    monkeypatch.setattr("napari_elsplus.widgets.shared.window.closing.confirm", confirm)
    return asked


class Questions(list[str]):
    answer = True


@pytest.fixture
def drop():
    """Drop files on a widget, as from the desktop."""

    def onto(widget, *paths):
        data = QMimeData()
        data.setUrls([QUrl.fromLocalFile(str(path)) for path in paths])
        with_the_mouse = Qt.DropAction.CopyAction, data, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier
        enter = QDragEnterEvent(QPoint(5, 5), *with_the_mouse)
        QApplication.sendEvent(widget, enter)
        assert enter.isAccepted()
        QApplication.sendEvent(widget, QDropEvent(QPointF(5, 5), *with_the_mouse))

    return onto


@pytest.fixture
def turn_wheel():
    """Turn the wheel towards the user over the middle of a widget, by eighths of a degree."""

    def over(widget, eighths=120):
        at = QPointF(widget.rect().center())
        event = QWheelEvent(
            at, QPointF(widget.mapToGlobal(at.toPoint())), QPoint(), QPoint(0, -eighths), Qt.MouseButton.NoButton,
            Qt.KeyboardModifier.NoModifier, Qt.ScrollPhase.NoScrollPhase, False,
        )  # fmt: skip
        QApplication.sendEvent(widget, event)

    return over


@pytest.fixture
def said():
    """What napari was told to show, as (severity, message)."""
    before = len(notification_manager.records)
    return lambda: [(r.severity.value, r.message) for r in notification_manager.records[before:]]
