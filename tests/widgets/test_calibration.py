"""The Calibration panel, driven as a user drives it."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import tifffile
from napari.settings import get_settings
from qtpy.QtWidgets import QApplication

from napari_elsplus._problems import problems
from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.link.client import EngineClient
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.virtual.bench import Simulation
from napari_elsplus.instrument.optics import preset
from napari_elsplus.io import read_calibration, write_calibration
from napari_elsplus.io.settings import active_calibration
from napari_elsplus.processing.calibration.slit_offset import measure_offset
from napari_elsplus.processing.calibration.step import REGISTERED, StepState, Target
from napari_elsplus.processing.calibration.steps import calibration_steps, find_step
from napari_elsplus.processing.calibration.summaries import with_uncertainty
from napari_elsplus.processing.images.sectioning import Sectioner, disc
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.specimen.trajectories import Still
from napari_elsplus.simulation.truth import true_calibration
from napari_elsplus.widgets.calibration.bundle_layers import IMAGE, OUTLINES
from napari_elsplus.widgets.calibration.history import HistoryDialog
from napari_elsplus.widgets.calibration.panel import CalibrationPanel
from pairs import write_pair
from processes import exists
from small_rig import small_calibration

PLUGIN = "napari-elsplus"
LONG_MS = 60_000
AVERAGED = 12
VOLTAGES = 24


@pytest.fixture
def panel(viewer):
    _, widget = viewer.window.add_plugin_dock_widget(PLUGIN, "Calibration")
    assert isinstance(widget, CalibrationPanel)
    return widget


@pytest.fixture
def live(panel, qtbot):
    """Connected to the simulated rig."""
    panel.form.connect_button.click()
    idle(qtbot, panel)
    panel.form.voltages.setValue(VOLTAGES)
    return panel


def idle(qtbot, panel):
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=LONG_MS)


def state(panel, step):
    return find_step(step).state(panel.draft)[0]


def measure(qtbot, panel, step):
    panel.form.steps[step].click()
    assert panel.form.measure.isEnabled(), panel.form.measure.toolTip()
    panel.form.measure.click()
    idle(qtbot, panel)


def from_file(qtbot, panel, step, path, volts=None):
    panel.form.steps[step].click()
    panel.measure_file(path, volts)
    idle(qtbot, panel)


def test_a_calibration_without_any_step_is_not_saved(panel, tmp_path):
    """Before: an empty file became the active calibration, by which no recording can be sectioned."""
    assert not panel.form.save.isEnabled()
    assert "measure one, or load a calibration" in panel.form.save.toolTip()
    panel.load(write_calibration(tmp_path / "cal.json", small_calibration()))
    assert panel.form.save.isEnabled()


def test_the_outlines_of_a_bundle_pair_are_prepared_in_the_thread_that_measures_it(
    viewer, panel, qtbot, open_recording, monkeypatch
):
    """Before: the window stood still for 11 s at the first pair after an installation; a stream was parked then."""
    by: list[tuple[threading.Thread, bool]] = []
    prepared = lambda: by.append((threading.current_thread(), OUTLINES in viewer.layers))  # noqa: E731
    monkeypatch.setattr("napari_elsplus.widgets.calibration.measuring.prepare_shapes", prepared)
    from_file(qtbot, panel, "pair", open_recording / "transmission.tif")
    ((thread, displayed),) = by
    assert thread is not threading.main_thread()
    assert not displayed
    assert OUTLINES in viewer.layers


def test_calibrated_by_clicking_the_simulated_rig_shows_a_scene_as_it_is(viewer, live, qtbot, said, tmp_path):
    form = live.form
    for step in (step.key for step in calibration_steps()):
        measure(qtbot, live, step)
        assert not said(), step
        assert (IMAGE in viewer.layers) == (OUTLINES in viewer.layers) == (step == "pair")
        form.accept.click()
        assert state(live, step) is StepState.DONE
        assert "✓" in form.steps[step].text()
    live.save(tmp_path / "cal.json")
    found = read_calibration(tmp_path / "cal.json")
    assert active_calibration() == tmp_path / "cal.json"
    assert live.connection.client.status.live is False

    paper = Simulation(scene=scene("paper"), trajectory=Still(), real_time=False)
    with open_rig("simulated", paper) as rig, Engine(rig) as engine:
        engine.configure(Settings("240hz"))
        engine.use(found)
        engine.start()
        raw = engine.fresh_frames(AVERAGED).mean(axis=0)
        engine.stop()
        instrument = rig.bench.optics.instrument(preset("240hz"))
        true = rig.bench.optics.calibration(preset("240hz"))
    perfect = Renderer(instrument, paper.scene, noise=False).render(0)
    expected = Sectioner(true, perfect.shape).els(perfect)
    seen = Sectioner(found, perfect.shape).els(raw.astype(np.float32))
    side = min(len(expected), len(seen))
    inside = disc(side, 0.95 * found.bundle.diameter_px)
    assert np.corrcoef(middle(expected, side)[inside], middle(seen, side)[inside])[0, 1] >= 0.99


def middle(image, side):
    first = (len(image) - side) // 2
    return image[first : first + side, first : first + side]


def test_watching_the_offset_goes_on_until_stopped_and_what_was_seen_can_be_accepted(live, qtbot):
    form = live.form
    form.follow_button.click()
    seen = set()

    def several():
        if live.candidate is not None:
            seen.add(live.candidate.found.rows)
        return len(seen) >= 3

    qtbot.waitUntil(several, timeout=LONG_MS)
    assert form.follow_button.text() == "Stop"
    assert not form.accept.isEnabled()
    assert not form.measure.isEnabled()
    assert "rows" in form.headline.text()
    assert "drop-offs" in form.numbers.text()
    assert [curve.name for curve in form.plots[0].curves] == ["confocal", "confocal fit", "residual", "residual fit"]
    (band,) = live.candidate.picture.plots[0].bands
    assert band.start < live.candidate.found.rows < band.stop
    form.follow_button.click()
    idle(qtbot, live)
    assert live.connection.client.status.live is False
    form.accept.click()
    assert state(live, "offset") is StepState.DONE


def test_a_failed_step_keeps_what_was_known_and_says_why_in_one_line(live, qtbot, said, monkeypatch):
    form = live.form
    measure(qtbot, live, "offset")
    form.accept.click()
    known = live.draft
    for step, wrong, words in (
        ("offset", Target.DARK_TUBE, "no voltage from"),
        ("pair", Target.DARK_TUBE, "is the probe lit from the far end"),
    ):
        monkeypatch.setitem(REGISTERED, step, replace(find_step(step), target=wrong))
        measure(qtbot, live, step)
        assert live.candidate is None
        assert live.draft is known
        severity, message = said()[-1]
        assert severity == "error"
        assert words in message
        assert "\n" not in message
    os.kill(live.connection.client.pid, signal.SIGKILL)
    qtbot.waitUntil(lambda: live.connection.client is None, timeout=LONG_MS)
    form.steps["galvo"].click()
    assert live.draft is known
    assert not form.measure.isEnabled()
    assert "connect" in form.measure.toolTip()


def seen_something(qtbot, panel):
    qtbot.waitUntil(lambda: panel.candidate is not None, timeout=LONG_MS)


def test_a_sweep_is_cancelled_and_the_mirror_parked(live, qtbot, said):
    live.form.voltages.setValue(2000)
    live.form.steps["galvo"].click()
    live.form.measure.click()
    client = live.connection.client
    qtbot.waitUntil(lambda: (p := client.status.progress) is not None and p.total == 2000, timeout=LONG_MS)
    live.work.cancel()
    idle(qtbot, live)
    assert live.candidate is None
    assert not said()
    assert not client.status.live
    assert live.form.measure.isEnabled()


def test_from_files_accepted_discarded_and_undone(viewer, panel, qtbot, open_recording, said):
    form = panel.form
    from_file(qtbot, panel, "offset", open_recording / "line.tif")
    form.discard.click()
    assert panel.candidate is None
    assert state(panel, "offset") is StepState.MISSING
    from_file(qtbot, panel, "offset", open_recording / "line.tif")
    form.accept.click()
    first = panel.draft
    from_file(qtbot, panel, "galvo", open_recording / "sweep.tif", open_recording / "sweep_volts.csv")
    assert len(form.plots[1].curves[0].x) > 20
    form.accept.click()
    from_file(qtbot, panel, "pair", open_recording / "transmission.tif")
    assert viewer.layers[IMAGE].data.shape == (300, 600)
    form.accept.click()
    from_file(qtbot, panel, "background", open_recording / "background.tif")
    form.accept.click()
    assert [state(panel, step) for step in REGISTERED] == [
        StepState.DONE, StepState.DONE, StepState.DONE, StepState.MISSING, StepState.DONE, StepState.DONE,
    ]  # fmt: skip
    assert panel.connection.calibration is panel.draft.calibration
    for _ in range(3):
        form.undo.click()
    assert panel.draft is first
    assert panel.connection.calibration is None  # without a bundle none is active: not the one that was undone either
    qtbot.wait(300)
    assert panel.draft is first
    form.undo.click()
    assert not form.undo.isEnabled()
    assert state(panel, "offset") is StepState.MISSING
    from_file(qtbot, panel, "pair", open_recording / "line.tif")
    assert panel.candidate is None
    assert said()[-1][0] == "error"


def test_closing_the_window_leaves_no_engine(make_napari_viewer_proxy, qtbot):
    viewer = make_napari_viewer_proxy()
    _, panel = viewer.window.add_plugin_dock_widget(PLUGIN, "Calibration")
    panel.form.connect_button.click()
    idle(qtbot, panel)
    pid = panel.connection.client.pid
    viewer.close()
    QApplication.processEvents()
    qtbot.waitUntil(lambda: not exists(pid), timeout=LONG_MS)  # it ends beside the window


def test_an_offset_that_moved_makes_the_pair_stale(panel, qtbot, open_recording):
    from_file(qtbot, panel, "offset", open_recording / "line.tif")
    shown = panel.candidate
    found = shown.found
    panel.form.accept.click()
    from_file(qtbot, panel, "pair", open_recording / "transmission.tif")
    panel.form.accept.click()
    assert state(panel, "pair") is StepState.DONE
    panel.choose("offset")
    turned = replace(found, rows=found.rows + 3, residual=replace(found.residual, row=found.residual.row + 3))
    by_line = measure_offset(tifffile.imread(open_recording / "line.tif"), pair=panel.draft.pair).rows
    panel.session.candidate = shown._replace(found=turned)  # the pair's cores count no more
    panel.accept()
    assert state(panel, "pair") is StepState.STALE
    assert "the offset has moved by" in panel.form.steps["pair"].toolTip()
    assert panel.draft.calibration.offset.rows == pytest.approx(by_line + 3)


def test_themes_and_loading(viewer, panel, qtbot, open_recording, tmp_path):
    from_file(qtbot, panel, "offset", open_recording / "line.tif")
    for theme in ("light", "dark"):
        viewer.theme = theme
        assert panel.form.plots[0].curves
    panel.form.accept.click()
    panel.save(tmp_path / "cal.json")
    panel.form.undo.click()
    panel.load(tmp_path / "cal.json")
    panel.choose("offset")
    assert state(panel, "offset") is StepState.DONE
    assert panel.form.headline.text() == "not measured in this session"
    known = panel.draft.calibration.offset
    rows, *_ = panel.form.numbers.text().split("<br>")
    assert rows == f"slit offset {with_uncertainty(known.rows, known.uncertainty_rows)} rows"
    panel.form.undo.click()
    assert state(panel, "offset") is StepState.MISSING


def test_a_calibration_that_was_measured_elsewhere_states_its_numbers(panel, tmp_path):
    """Before: it was called loaded from a file, also that of the Rig panel, and no number was displayed."""
    known = true_calibration(Instrument.of("240hz", offset_um=-29), np.full((524, 1328), 4, np.float32))
    panel.load(write_calibration(tmp_path / "known.json", known))
    done = [step.key for step in calibration_steps() if state(panel, step.key) is StepState.DONE]
    assert {"offset", "galvo", "pair", "background"} <= set(done)
    for key in done:
        panel.form.steps[key].click()
        assert panel.form.headline.text() == "not measured in this session"
        numbers = panel.form.numbers.text()
        assert any(digit in numbers for digit in "123456789"), key
    panel.form.steps["offset"].click()
    assert f"slit offset {known.offset.rows:.2f}" in panel.form.numbers.text()
    assert "µm" in panel.form.numbers.text()


def test_closing_the_dock_while_it_measures_leaves_no_panel_no_engine_and_no_thread(viewer, qtbot, said):
    before = set(threading.enumerate())
    _, panel = viewer.window.add_plugin_dock_widget(PLUGIN, "Calibration")
    panel.form.connect_button.click()
    idle(qtbot, panel)
    pid = panel.connection.client.pid
    panel.form.follow_button.click()
    seen_something(qtbot, panel)
    gone = []
    panel.destroyed.connect(lambda: gone.append(True))
    viewer.window.remove_dock_widget(panel)
    qtbot.waitUntil(lambda: bool(gone), timeout=LONG_MS)
    engines = lambda: [one for one in set(threading.enumerate()) - before if "engine" in one.name]  # noqa: E731
    qtbot.waitUntil(lambda: not engines(), timeout=LONG_MS)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    assert not said()


@pytest.fixture
def faulty(panel, qtbot, monkeypatch, tmp_path):
    """Connected to the simulated rig, whose camera sees what goes wrong; the slit offset is accepted."""
    fault, moves = tmp_path / "fault", tmp_path / "moves"
    fault.write_text("")
    command = (sys.executable, str(Path(__file__).with_name("faulty_engine.py")), str(fault), str(moves))
    monkeypatch.setattr("napari_elsplus.widgets.shared.connection.EngineClient", partial(EngineClient, command))
    panel.form.connect_button.click()
    idle(qtbot, panel)
    panel.form.voltages.setValue(VOLTAGES)
    measure(qtbot, panel, "offset")
    panel.form.accept.click()
    return panel, fault, moves


FAULTS = (
    ("over-exposed", "offset", "is saturated"),
    ("laser off", "galvo", "is the laser on"),
    ("right view blocked", "offset", "residual view: no laser line"),
    ("right view blocked", "pair", "two bundle images expected, 1 found"),
    ("laser off", "pair", "is the probe lit from the far end"),
    ("unplugged", "galvo", "the camera was unplugged"),
)


def test_faults_half_way_are_told_keep_the_last_good_calibration_and_park(faulty, qtbot, said):
    panel, file, moves = faulty
    known = panel.draft
    for fault, step, words in FAULTS:
        told = len(said())
        moves.write_text("")
        file.write_text(fault)
        measure(qtbot, panel, step)
        assert panel.candidate is None, fault
        assert panel.draft is known
        assert state(panel, "offset") is StepState.DONE
        (severity, message), *more = said()[told:]
        assert severity == "error"
        assert words in message
        assert not more
        assert moves.read_text().split()[-1] == "park", fault
        assert not panel.connection.client.status.live
    file.write_text("")
    measure(qtbot, panel, "offset")
    assert panel.candidate is not None, "it goes on once all is mended"


def test_plots_are_saved_and_the_script_makes_the_same_calibration(
    panel, qtbot, open_recording, tmp_path, monkeypatch, said
):
    assert not panel.form.save_plots.isEnabled()
    assert not panel.form.script.isEnabled()
    volts = open_recording / "sweep_volts.csv"
    for step, name in (("offset", "line.tif"), ("galvo", "sweep.tif"), ("pair", "transmission.tif")):
        from_file(qtbot, panel, step, open_recording / name, volts if step == "galvo" else None)
        panel.form.accept.click()
    panel.form.steps["galvo"].click()
    assert panel.form.save_plots.isEnabled()
    panel.save_plots(tmp_path / "galvo.csv")
    panel.save_plots(tmp_path / "galvo.png")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "galvo-2.csv", "galvo-2.png", "galvo.csv", "galvo.png",
    ]  # fmt: skip
    table = np.genfromtxt(tmp_path / "galvo.csv", delimiter=",", names=True)
    galvo = panel.draft.found["galvo"]
    assert np.allclose(table["measured"][: len(galvo.rows)], galvo.rows, rtol=1e-4)
    panel.form.script.click()
    script = QApplication.clipboard().text()
    monkeypatch.chdir(tmp_path)
    exec(compile(script, "script.py", "exec"), {"__name__": "__main__"})
    again = read_calibration(tmp_path / "calibration.json")
    for section in ("offset", "galvo", "bundle"):
        assert getattr(again, section) == getattr(panel.draft.calibration, section)
    assert [severity for severity, _ in said()] == ["info"]


def test_what_another_panel_changes_makes_steps_stale(live, qtbot):
    for step in ("galvo", "pair", "background"):
        measure(qtbot, live, step)
        live.form.accept.click()
    button = live.form.steps["background"]
    assert "✓" in button.text()
    live.connection.client.configure(Settings("240hz", gain_db=6.0)).result()
    qtbot.waitUntil(lambda: "⚠" in button.text(), timeout=LONG_MS)
    assert button.toolTip() == "stale: gain changed from 0 to 6 dB"
    assert "✓" in live.form.steps["pair"].text()
    live.connection.client.configure(Settings("240hz")).result()
    qtbot.waitUntil(lambda: "✓" in button.text(), timeout=LONG_MS)


def test_micrometres_and_times_are_absent_until_they_are_entered_and_read_from_a_file(
    viewer, panel, qtbot, open_recording, tmp_path, monkeypatch
):
    form = panel.form
    from_file(qtbot, panel, "pair", open_recording / "transmission.tif")
    assert "micrometres unknown" in form.numbers.text()
    form.accept.click()
    assert panel.draft.um_per_px is None
    assert {form.bundle_um.text(), form.line_period_us.text(), form.periods_per_frame.text()} == {"unknown"}
    form.bundle_um.setValue(1000.0)
    form.line_period_us.setValue(10.0)
    form.periods_per_frame.setValue(400.0)
    known = panel.draft.calibration
    assert known.um_per_px == pytest.approx(1000 / known.bundle.diameter_px)
    assert known.frame_period_s == pytest.approx(4e-3)
    form.script.click()
    monkeypatch.chdir(tmp_path)
    exec(compile(QApplication.clipboard().text(), "script.py", "exec"), {"__name__": "__main__"})
    assert read_calibration(tmp_path / "calibration.json").optics == known.optics
    panel.save(tmp_path / "cal.json")
    form.bundle_um.setValue(0)
    assert panel.draft.um_per_px is None
    form.undo.click()
    assert form.bundle_um.value() == 1000
    panel.session = type(panel.session)()
    panel.load(tmp_path / "cal.json")
    assert (form.bundle_um.value(), form.line_period_us.value(), form.periods_per_frame.value()) == (1000, 10, 400)
    assert panel.draft.um_per_px == known.um_per_px


def test_a_diameter_in_millimetres_is_refused_and_the_last_one_stays(panel):
    form = panel.form
    for entered_um, kept_um, told in ((620, 620, ""), (0.6, 620, "a bundle of 0.6 um across"), (700, 700, "")):
        form.bundle_um.setValue(entered_um)
        assert told in problems.newest
        assert bool(told) is bool(problems.newest)
        assert (form.bundle_um.value(), panel.draft.bundle_um) == (kept_um, kept_um)


def test_the_steps_have_the_font_that_the_user_sets_in_napari(viewer, panel):
    """Before: that of the system, as of all tool buttons, at any size of the others."""
    for font_pt in (8, 15):
        get_settings().appearance.font_size = font_pt
        QApplication.processEvents()
        buttons = [*panel.form.steps.values(), panel.form.measure]
        assert len({button.fontInfo().pixelSize() for button in buttons}) == 1


def test_closing_with_an_unsaved_calibration_asks(viewer, panel, qtbot, open_recording, tmp_path, questions):
    window = panel.window()
    window.show()
    qtbot.waitUntil(lambda: window.isVisible(), timeout=60_000)
    qtbot.wait(100)
    from_file(qtbot, panel, "offset", open_recording / "line.tif")
    panel.form.accept.click()
    questions.answer = False
    window.close()
    assert questions == ["The calibration was not saved. Discard it?"]
    assert window.isVisible()
    panel.save(tmp_path / "cal.json")
    assert panel.unsaved() == ""
    from_file(qtbot, panel, "offset", open_recording / "line.tif")
    panel.form.accept.click()
    questions.answer = True
    viewer.close()
    assert len(questions) == 2, "and not once more where the window takes the dock with it"


@pytest.mark.parametrize("title", ["Calibration", "ELS+"])
def test_closing_the_dock_with_an_unsaved_calibration_asks_and_may_be_cancelled(
    viewer, qtbot, open_recording, questions, title
):
    """Before: a click on the dock's cross discarded all steps without a question."""
    dock, widget = viewer.window.add_plugin_dock_widget(PLUGIN, title)
    if title == "ELS+":
        qtbot.waitUntil(lambda: all(tab.built for tab in widget.by_title.values()), timeout=60_000)
    panel = widget.by_title["Calibration"].panel if title == "ELS+" else widget
    from_file(qtbot, panel, "offset", open_recording / "line.tif")
    panel.form.accept.click()
    questions.answer = False
    viewer.window.remove_dock_widget(dock)
    assert questions == ["The calibration was not saved. Discard it?"]
    qtbot.waitUntil(lambda: widget.parent() is not None)
    assert panel.session.sources
    assert panel.form.undo.isEnabled()
    again, same = viewer.window.add_plugin_dock_widget(PLUGIN, title)
    assert same is widget
    questions.answer = True
    viewer.window.remove_dock_widget(again)
    assert len(questions) == 2
    _, new = viewer.window.add_plugin_dock_widget(PLUGIN, title)
    assert new is not widget


def test_accepting_goes_on_to_the_next_step_that_is_not_done(panel, qtbot, open_recording):
    from_file(qtbot, panel, "pair", open_recording / "transmission.tif")
    panel.form.accept.click()
    assert panel.key == "background", "the scan lag is measured live"
    from_file(qtbot, panel, "offset", open_recording / "line.tif")
    panel.form.accept.click()
    assert panel.key == "galvo"


def test_voltages_beside_a_sweep_are_found(panel, qtbot, open_recording):
    from_file(qtbot, panel, "galvo", open_recording / "sweep.tif")
    assert panel.candidate.source.volts == open_recording / "sweep_volts.csv"
    assert panel.candidate.found.r_squared > 0.999


def test_steps_are_measured_from_layers(viewer, panel, qtbot, open_recording, said):
    panel.choose("offset")
    panel.form.from_layer.click()
    assert "select one" in said()[-1][1]
    viewer.open(str(open_recording / "line.tif"), plugin=PLUGIN)
    viewer.layers.selection.active = viewer.layers[-1]
    panel.form.from_layer.click()
    idle(qtbot, panel)
    assert panel.candidate.source.path == open_recording / "line.tif"
    by_layer = panel.candidate.found.rows
    from_file(qtbot, panel, "offset", open_recording / "line.tif")
    assert by_layer == panel.candidate.found.rows


def test_the_bundle_is_displayed_alone_in_the_units_of_the_other_layers(viewer, panel, qtbot, open_recording, tmp_path):
    """Its pixels beside micrometres cost the viewer its scale bar."""
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    before = [layer for layer in viewer.layers if layer.visible]
    from_file(qtbot, panel, "pair", open_recording / "transmission.tif")
    assert [layer.name for layer in viewer.layers if layer.visible] == ["calibration: bundle", "calibration: outlines"]
    assert {str(unit) for layer in viewer.layers for unit in layer.units[-2:]} == {"micrometer"}
    shown = viewer.layers["calibration: bundle"]
    panel.form.bundle_um.setValue(620)
    assert viewer.layers["calibration: bundle"] == shown, "a number changes its scale alone"
    assert shown.scale[0] == pytest.approx(620 / panel.candidate.found.confocal.diameter_px)
    panel.form.discard.click()
    assert [layer for layer in viewer.layers if layer.visible] == before


def test_the_selected_layer_is_selected_again_after_the_bundle(viewer, panel, qtbot, open_recording):
    mine = viewer.add_image(np.zeros((8, 8)))
    viewer.add_image(np.zeros((8, 8)))
    viewer.layers.selection.active = mine
    from_file(qtbot, panel, "pair", open_recording / "transmission.tif")
    assert viewer.layers.selection.active.name == OUTLINES
    panel.form.discard.click()
    assert viewer.layers.selection.active == mine


def test_a_calibration_made_from_files_has_no_scan_lag_background_or_flat_field_of_zero(
    panel, qtbot, open_recording, tmp_path
):
    from_file(qtbot, panel, "galvo", open_recording / "sweep.tif")
    panel.form.accept.click()
    panel.save(tmp_path / "cal.json")
    saved = json.loads((tmp_path / "cal.json").read_text())
    assert "lag_s" not in saved["galvo"]
    assert not (tmp_path / "cal.npz").exists()
    found = read_calibration(tmp_path / "cal.json")
    assert (found.galvo.lag_s, found.background, found.flat) == (None, None, None)


def test_the_history_plots_a_number_over_the_calibrations_of_a_folder(panel, qtbot, open_recording, tmp_path, said):
    assert not panel.form.report.isEnabled()
    from_file(qtbot, panel, "offset", open_recording / "line.tif")
    panel.form.accept.click()
    panel.save(tmp_path / "today.json")
    earlier = panel.draft.calibration.model_copy(update={"created": "2026-01-31T12:00:00Z"})
    write_calibration(tmp_path / "january.json", earlier)
    panel.form.history.click()
    (shown,) = panel.findChildren(HistoryDialog)
    assert shown.quantity.currentText() == "slit offset / rows"
    assert len(shown.plot.curves[0].x) == 2
    assert "2 calibrations" in shown.notes.text()
    shown.quantity.setCurrentIndex(1)
    assert shown.plot.curves[0].name == shown.history.trends[1].name
    shown.plot.save(tmp_path / "history.csv")
    panel.save_report(tmp_path / "report.pdf")
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=LONG_MS)
    assert (tmp_path / "report.pdf").read_bytes().count(b"/Type /Page ") == 3
    shown.close()


def test_the_number_of_voltages_is_the_range_of_the_progress_bar(panel, qtbot, open_recording):
    ranges = set()
    panel.work._poll.timeout.connect(lambda: ranges.add(panel.work._bar.maximum()))
    from_file(qtbot, panel, "galvo", open_recording / "sweep.tif")
    assert max(ranges) == len(np.loadtxt(open_recording / "sweep_volts.csv", skiprows=1))
