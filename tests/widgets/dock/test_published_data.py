"""From another lab's AVI files to a figure and a mosaic, by mouse and at most four typed numbers."""

from __future__ import annotations

import numpy as np
import pytest
from qtpy.QtCore import Qt
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QFileDialog

from napari_elsplus.io import read_calibration, read_track
from napari_elsplus.workflows.simulated import simulate_calibration, simulate_recording
from videos import write_avi

PLUGIN = "napari-elsplus"
FRAMES = 8
MAX_TYPED = 4
LONG_MS = 120_000


class Hand:
    """Clicks on tabs and buttons of a dock, and types numbers; counts these."""

    def __init__(self, dock, qtbot):
        self.dock, self.qtbot, self.typed = dock, qtbot, 0

    def show(self, title):
        bar = self.dock.tabs.tabBar()
        at = [bar.tabText(index) for index in range(bar.count())].index(title)
        QTest.mouseClick(bar, Qt.MouseButton.LeftButton, pos=bar.tabRect(at).center())
        assert self.dock.tabs.currentWidget() is self.dock.by_title[title]
        return self.dock.by_title[title].panel

    def click(self, button):
        assert button.isEnabled(), button.toolTip()
        QTest.mouseClick(button, Qt.MouseButton.LeftButton)

    def type(self, field, number):
        field.lineEdit().selectAll()
        QTest.keyClicks(field, f"{number:g}")
        QTest.keyClick(field, Qt.Key.Key_Return)
        self.typed += 1

    def wait(self, condition):
        self.qtbot.waitUntil(condition, timeout=LONG_MS)


@pytest.fixture
def recording():
    return simulate_recording(frames=FRAMES, seed=7)


@pytest.fixture
def folder(tmp_path, recording):
    """Frames of the bundle lit from its far end, and of the moving probe, as video files."""
    bundle = simulate_calibration(seed=7).bundle
    write_avi(tmp_path / "transmission.avi", np.stack([bundle[k] for k in range(4)]))
    write_avi(tmp_path / "tissue.avi", np.stack([recording[k] for k in range(FRAMES)]))
    return tmp_path


def test_from_the_videos_of_another_lab_to_a_figure_and_a_mosaic(
    make_napari_viewer_proxy, qtbot, drop, recording, folder, monkeypatch
):
    suggested = lambda _parent, _title, name="", _kinds="": (str(folder / name), "")  # noqa: E731
    monkeypatch.setattr(QFileDialog, "getSaveFileName", suggested)
    viewer = make_napari_viewer_proxy(show=True)
    _, dock = viewer.window.add_plugin_dock_widget(PLUGIN, "ELS+")
    hand = Hand(dock, qtbot)
    hand.wait(lambda: all(tab.built for tab in dock.by_title.values()))

    calibration = hand.show("Calibration")
    hand.click(calibration.form.steps["pair"])
    drop(calibration, folder / "transmission.avi")
    hand.wait(lambda: calibration.candidate is not None and not calibration.work.busy)
    hand.type(calibration.form.bundle_um, 620)
    hand.type(calibration.form.line_period_us, 7.648)
    hand.type(calibration.form.periods_per_frame, 544.8)
    hand.click(calibration.form.accept)
    hand.click(calibration.form.save)

    compare = hand.show("Compare")
    drop(compare, folder / "tissue.avi")
    hand.wait(lambda: compare.start.enabled)
    hand.click(compare.start.native)
    hand.wait(lambda: compare.comparing)
    hand.click(compare.save_figure.native)
    hand.click(compare.start.native)

    mosaic = hand.show("Mosaic")
    hand.click(mosaic.form.start.native)
    hand.wait(lambda: not mosaic.work.busy)
    hand.click(mosaic.form.saving.native)
    hand.wait(lambda: not mosaic.work.busy)

    assert hand.typed <= MAX_TYPED
    assert (folder / "comparison.pdf").read_bytes().startswith(b"%PDF")
    found, true = read_calibration(folder / "calibration.json"), recording.calibration
    assert found.um_per_px == pytest.approx(true.um_per_px, rel=3e-3)
    np.testing.assert_allclose(found.bundle.confocal_centre, true.bundle.confocal_centre, atol=0.3)
    assert found.bundle.residual_gain == pytest.approx(true.bundle.residual_gain, rel=0.01)
    (track,) = folder.glob("*.track.csv")
    assert [point.state for point in read_track(track)] == ["tracked"] * FRAMES
