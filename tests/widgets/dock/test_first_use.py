"""What a first user sees: the next action in each panel, a reason on each disabled button, files dropped anywhere."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile
from qtpy.QtWidgets import QAbstractSpinBox, QCheckBox, QComboBox, QLabel, QLineEdit, QPushButton

from napari_elsplus._problems import problems
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.widgets.analysis.axial import MANUAL
from pairs import frames, write_pair

PLUGIN = "napari-elsplus"


@pytest.fixture
def dock(small_engine, make_napari_viewer_proxy, qtbot):
    viewer = make_napari_viewer_proxy()
    _, dock = viewer.window.add_plugin_dock_widget(PLUGIN, "ELS+")
    qtbot.waitUntil(lambda: all(tab.built for tab in dock.by_title.values()), timeout=30_000)
    return dock


def panel(dock, title):
    return dock.by_title[title].panel


def hints(panel):
    """Next actions that a panel names."""
    return [label.text() for label in panel.findChildren(QLabel) if "<b>Next:</b>" in label.text()]


def test_every_panel_names_the_next_action_until_it_is_done(dock, qtbot, drop, tmp_path):
    assert {title: len(hints(panel(dock, title))) for title in dock.by_title} == dict.fromkeys(dock.by_title, 1)
    assert "open a recording" in hints(panel(dock, "Compare"))[0]
    drop(panel(dock, "Compare"), write_pair(tmp_path))
    qtbot.waitUntil(lambda: "press Compare" in "".join(hints(panel(dock, "Compare"))), timeout=60_000)
    panel(dock, "Compare").begin()
    qtbot.waitUntil(lambda: not hints(panel(dock, "Compare")), timeout=30_000)
    assert "press Connect" in hints(panel(dock, "Rig"))[0]
    assert "press Start" in hints(panel(dock, "Live"))[0]
    dock.connection.connect("simulated", Settings("240hz", frame_rate_hz=100.0))
    qtbot.waitUntil(lambda: "press Calibrate simulated rig" in "".join(hints(panel(dock, "Rig"))), timeout=60_000)
    panel(dock, "Calibration").choose("offset")
    assert "press Measure" in hints(panel(dock, "Calibration"))[0]


def test_a_recording_that_is_opened_is_chosen_unless_another_is_compared(dock, qtbot, drop, tmp_path):
    """Before: the sample stayed chosen, and the mosaic was not of the recording that had just been opened."""
    choices = [panel(dock, "Compare").recording, panel(dock, "Mosaic").form.recording]
    choices += [panel(dock, "Quality").recording, panel(dock, "Axial response").stack]
    for name in ("first", "second"):
        path = write_pair(tmp_path, name=name)
        path.with_name(f"{name}.depths.csv").write_text("depth_um\n" + "\n".join(map(str, range(6))))
        drop(panel(dock, "Compare"), path)
        assert [choice.value for choice in choices] == [f"{name} raw"] * 4
    dock.viewer.layers["first raw"].name = "renamed"
    assert [choice.value for choice in choices] == ["second raw"] * 4
    panel(dock, "Compare").begin()
    qtbot.waitUntil(lambda: panel(dock, "Compare").comparing, timeout=60_000)
    drop(panel(dock, "Compare"), write_pair(tmp_path, name="third"))
    assert [choice.value for choice in choices] == ["second raw", "third raw", "third raw", "second raw"]


def test_without_a_rig_the_steps_end_with_save_and_a_recording_for_a_live_one_is_refused(
    dock, qtbot, drop, open_recording
):
    """Before: accepting led to the scan lag, which only a rig measures, and a recording dropped there did nothing."""
    own = panel(dock, "Calibration")
    steps = (
        ("offset", "line.tif", "galvo"), ("galvo", "sweep.tif", "pair"), ("pair", "transmission.tif", "background"),
        ("background", "background.tif", "background"),
    )  # fmt: skip
    for step, name, then in steps:
        assert own.key == step
        drop(own, open_recording / name)
        qtbot.waitUntil(lambda: own.candidate is not None and not own.work.busy, timeout=60_000)
        own.accept()
        assert own.key == then
    assert "press Save..." in hints(own)[0]
    own.choose("lag")
    assert "press Connect: this step is measured live" in hints(own)[0]
    qtbot.waitUntil(lambda: not own.requests.busy, timeout=60_000)
    drop(own, open_recording / "line.tif")
    qtbot.waitUntil(lambda: not own.work.busy, timeout=60_000)
    assert "connect the rig and measure it live" in problems.newest


def test_a_recording_without_calibration_is_named_with_the_way_to_one(dock, qtbot, drop, tmp_path):
    """Before: *open a recording with a calibration*, while the user's recording lay open."""
    tifffile.imwrite(tmp_path / "mine.tif", frames())
    axial = panel(dock, "Axial response")
    axial.source.value = MANUAL
    drop(panel(dock, "Compare"), tmp_path / "mine.tif")
    for one in (panel(dock, "Compare"), panel(dock, "Quality"), axial):
        (hint,) = hints(one)
        assert "give mine raw a calibration: make and save one in Calibration, or drop its file" in hint
    drop(panel(dock, "Compare"), write_pair(tmp_path))
    assert "press Compare" in hints(panel(dock, "Compare"))[0]


def test_every_control_has_a_tooltip_and_a_disabled_button_names_the_reason(dock):
    bare, silent = [], []
    for title in dock.by_title:
        own = panel(dock, title)
        for kind in (QPushButton, QCheckBox, QComboBox, QAbstractSpinBox):
            bare += [
                f"{title}: {one.text() if isinstance(one, QPushButton | QCheckBox) else type(one).__name__}"
                for one in own.findChildren(kind)
                if one.isVisibleTo(own) and not one.toolTip() and not one.parent().toolTip()
            ]
        reasons = ("first", "connect", "start", "open", "nothing", "no ", "make", "only", "wait", "yet", "live")
        silent += [
            f"{title}: {one.text()}: {one.toolTip()}"
            for one in own.findChildren(QPushButton)
            if not one.isEnabled() and not any(word in one.toolTip().lower() for word in reasons)
        ]
    assert bare == []
    assert silent == []


def test_every_field_has_a_name_for_screen_readers(dock):
    """Before: they read out the numbers alone."""
    nameless = []
    for title in dock.by_title:
        own = panel(dock, title)
        named = [label.buddy() for label in own.findChildren(QLabel)]
        for kind in (QComboBox, QAbstractSpinBox, QLineEdit):
            nameless += [
                f"{title}: {one.toolTip()}"
                for one in own.findChildren(kind)
                if one.isVisibleTo(own)
                and not (one.accessibleName() or one in named or isinstance(one.parent(), QAbstractSpinBox | QComboBox))
            ]
    assert nameless == []


def test_a_recording_dropped_on_the_calibration_measures_the_step_and_a_calibration_is_loaded(
    dock, qtbot, drop, open_recording, tmp_path
):
    own = panel(dock, "Calibration")
    own.choose("offset")
    drop(own, open_recording / "line.tif")
    qtbot.waitUntil(lambda: own.candidate is not None and not own.work.busy, timeout=30_000)
    assert "press Accept" in hints(own)[0]
    write_pair(tmp_path)
    drop(own, tmp_path / "scan.calibration.json")
    assert own.draft.calibration.offset.rows == -4.0
    (tmp_path / "notes.txt").write_text("no recording")
    (tmp_path / "other.json").write_text('{"a": 1}')
    for title, file, words in (
        ("Compare", "notes.txt", "neither a recording nor a calibration"),
        ("Live", "other.json", "neither a recording nor a calibration"),
        ("Calibration", "other.json", "no napari-elsplus/calibration record"),
    ):
        drop(panel(dock, title), tmp_path / file)
        assert words in problems.newest
    problems.dismiss()
    assert np.isfinite(own.draft.um_per_px)
