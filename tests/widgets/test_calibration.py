"""The Calibration panel, driven as a user drives it."""

from __future__ import annotations

import pytest

from napari_elsplus.io import read_calibration
from napari_elsplus.processing.draft import State, Step
from napari_elsplus.simulation.instrument import Instrument
from napari_elsplus.widgets.calibration.panel import CalibrationPanel

PLUGIN = "napari-elsplus"
LONG_MS = 90_000


@pytest.fixture
def viewer(make_napari_viewer_proxy):
    return make_napari_viewer_proxy()


@pytest.fixture
def panel(viewer):
    _, widget = viewer.window.add_plugin_dock_widget(PLUGIN, "Calibration")
    assert isinstance(widget, CalibrationPanel)
    yield widget
    viewer.window.remove_dock_widget(widget)


def idle(qtbot, panel):
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=LONG_MS)


def state(panel, step):
    return panel.draft.state(step)[0]


def measure(qtbot, panel, step):
    panel.form.steps[step].click()
    assert panel.form.measure.isEnabled(), panel.form.measure.toolTip()
    panel.form.measure.click()
    idle(qtbot, panel)


def test_calibrating_the_simulated_rig_by_clicking(viewer, panel, qtbot, said, tmp_path):
    form = panel.form
    assert not form.measure.isEnabled()
    assert "connect" in form.measure.toolTip()
    form.connect_button.click()
    idle(qtbot, panel)
    form.voltages.setValue(40)
    for step in Step:
        measure(qtbot, panel, step)
        assert not said(), step
        assert form.headline.text() != "not measured yet"
        form.accept.click()
        assert state(panel, step) is State.DONE
    panel.save(tmp_path / "cal.json")
    found = read_calibration(tmp_path / "cal.json")
    true = Instrument.of("240hz", offset_um=-29.0)
    assert found.galvo.volts_per_row == pytest.approx(true.volts_per_row, rel=5e-4)
    assert found.bundle.confocal_centre == pytest.approx(true.left_centre, abs=0.15)
