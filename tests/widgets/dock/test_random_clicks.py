"""Random clicks on Rig, Live and Calibration, on the simulated rig with its engine's process: no traceback.

Two minutes under ``--all``; twenty by ``ELSPLUS_CLICKS_S=1200``, other clicks by ``ELSPLUS_CLICKS_SEED=1``.
"""

from __future__ import annotations

import os
import random
import sys
import threading
import time
import traceback
from collections import Counter, deque
from pathlib import Path

import pytest
from napari.utils.notifications import ErrorNotification, notification_manager
from qtpy.QtCore import Qt, QTimer
from qtpy.QtTest import QTest
from qtpy.QtWidgets import (
    QAbstractButton,
    QAbstractSpinBox,
    QApplication,
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QFileDialog,
    QSpinBox,
)

from napari_elsplus.io import write_calibration
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.truth import true_calibration

PLUGIN = "napari-elsplus"
SECONDS = float(os.environ.get("ELSPLUS_CLICKS_S", "120"))
SEED = int(os.environ.get("ELSPLUS_CLICKS_SEED", "0"))
PANELS = ("Rig", "Live", "Calibration")
KINDS = (QAbstractButton, QComboBox, QSpinBox, QDoubleSpinBox)
NEVER = ("rehears", "copy")
"""Buttons left alone: a rehearsal, which has tests of its own and takes the whole computer, and the clipboard."""
ENDING = ("Disconnect", "Cancel", "Cancel calibration", "Stop")
"""Buttons clicked a tenth as often as others, so that streams and calibrations get on."""
PAUSES_MS = (0, 5, 30, 200, 800)
MAX_LAYERS = 20
MAX_RECORDED_BYTES = 2_000_000_000


class Clicker:
    """Clicks at random, and notes what it did."""

    def __init__(self, panels, files, rng):
        self.panels, self.files, self.rng = panels, files, rng
        self.last = deque(maxlen=40)
        self.counts = Counter()

    def click(self):
        """Act on a random control of a random panel that a hand could reach."""
        name, panel = self.rng.choice(list(self.panels.items()))
        controls = [one for kind in KINDS for one in panel.findChildren(kind) if self.may(one, panel)]
        if not controls:
            return
        control = self.rng.choice(controls)
        if isinstance(control, QAbstractButton) and control.text() in ENDING and self.rng.random() > 0.1:
            return
        label = control.text() if isinstance(control, QAbstractButton) else control.objectName()
        self.last.append(f"{time.monotonic():.2f} {name}: {type(control).__name__} {label!r}")
        self.counts[name, type(control).__name__] += 1
        self.act(control)

    def may(self, control, panel):
        inside = isinstance(control.parent(), QAbstractSpinBox | QComboBox)
        words = f"{control.text() if isinstance(control, QAbstractButton) else ''} {control.toolTip()}".lower()
        return control.isEnabled() and control.isVisibleTo(panel) and not inside and not any(w in words for w in NEVER)

    def act(self, control):
        if isinstance(control, QComboBox):
            control.setCurrentIndex(self.rng.randrange(max(1, control.count())))
        elif isinstance(control, QAbstractSpinBox):
            low, high = control.minimum(), control.maximum()
            value = self.rng.choice([low, high, control.value(), self.rng.uniform(low, high)])
            control.setValue(int(value) if isinstance(control, QSpinBox) else value)
        elif isinstance(control, QCheckBox):
            control.click()
        else:
            QTest.mouseClick(control, Qt.MouseButton.LeftButton)

    def choose(self, *_, **__):
        """Answer a file dialog."""
        return self.rng.choice(["", *map(str, self.files)]), ""


@pytest.fixture
def tracebacks(monkeypatch):
    """What was raised in any thread of this process."""
    found = []
    monkeypatch.setattr(sys, "excepthook", lambda *error: found.append("".join(traceback.format_exception(*error))))
    monkeypatch.setattr(
        threading, "excepthook", lambda error: found.append("".join(traceback.format_exception(*error[:3])))
    )
    return found


@pytest.mark.slow
def test_random_clicks_leave_no_traceback(make_napari_viewer_proxy, qtbot, tmp_path, monkeypatch, tracebacks, capfd):
    rng = random.Random(SEED)
    before = len(notification_manager.records)
    good = tmp_path / "calibration.json"
    write_calibration(good, true_calibration(Instrument.of("240hz", offset_um=-29)))
    wrong = tmp_path / "wrong.json"
    wrong.write_text('{"format": "another"}')
    viewer = make_napari_viewer_proxy()
    viewer.window.show()
    panels = {name: viewer.window.add_plugin_dock_widget(PLUGIN, name)[1] for name in PANELS}
    panels["Live"].form.folder.value = tmp_path
    clicker = Clicker(panels, [good, wrong, tmp_path / "new.json"], rng)
    monkeypatch.setattr(QFileDialog, "getOpenFileName", clicker.choose)
    monkeypatch.setattr(QFileDialog, "getSaveFileName", clicker.choose)
    monkeypatch.setattr(QFileDialog, "getExistingDirectory", lambda *_, **__: str(tmp_path))
    monkeypatch.setattr(QFileDialog, "exec", lambda *_: 0)
    dialogs = QTimer()
    dialogs.timeout.connect(lambda: (one := QApplication.activeModalWidget()) and one.close())
    dialogs.start(300)
    panels["Live"].form.start.native.click()
    qtbot.waitUntil(lambda: panels["Live"].live, timeout=120_000)
    end_s = time.monotonic() + SECONDS
    clicks = live = 0
    while time.monotonic() < end_s and not tracebacks:
        clicker.click()
        clicks += 1
        live += panels["Live"].live
        qtbot.wait(rng.choice(PAUSES_MS))
        if len(viewer.layers) > MAX_LAYERS:
            viewer.layers.clear()
        recordings = sorted(tmp_path.glob("*.tif"), key=lambda path: path.stat().st_mtime)
        while sum(path.stat().st_size for path in recordings) > MAX_RECORDED_BYTES:
            recordings.pop(0).unlink()
    dialogs.stop()
    with capfd.disabled():
        sys.stderr.write(
            f"{clicks} clicks in {SECONDS:g} s, {live} of them while live, seed {SEED}: {dict(clicker.counts)}\n"
        )
    story = "\n".join(clicker.last)
    assert not tracebacks, "\n".join([*tracebacks, story])
    records = notification_manager.records[before:]
    assert [r.message for r in records if isinstance(r, ErrorNotification)] == [], story
    wild = [r.message for r in records if "Traceback" in r.message or "this is a defect" in r.message]
    assert wild == [], story
    assert clicks > SECONDS / 4
    assert live > 0
    output = capfd.readouterr()
    assert "Traceback" not in output.err + output.out, output.err[-4000:] + story
    assert not list(Path(tmp_path).glob("*.part"))
