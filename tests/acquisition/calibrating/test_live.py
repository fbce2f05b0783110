"""The calibration's steps on the simulated rig, against its truth."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

from napari_elsplus.acquisition.calibrating import live
from napari_elsplus.acquisition.calibrating.capture import find_span, take_frames
from napari_elsplus.acquisition.calibrating.simulated import calibrate_simulated
from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.errors import DeviceError, InputError, MeasurementError
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.scan.waveform import GalvoLimits
from napari_elsplus.instrument.optics import preset
from napari_elsplus.processing.calibration.draft import Draft
from napari_elsplus.simulation.specimen.scenes import empty


def test_the_simulated_rig_is_calibrated_to_its_truth_and_scans_by_it() -> None:
    with open_rig("simulated") as rig, Engine(rig) as engine:
        engine.configure(Settings("240hz"))
        draft = calibrate_simulated(rig, engine)
        assert rig.bench is not None
        true, found = rig.bench.optics.calibration(preset("240hz")), engine.calibration
        assert found == draft.calibration
        assert found is not None
        assert found.offset is not None
        assert found.offset.rows == pytest.approx(true.offset.rows, abs=0.05)  # type: ignore[union-attr]
        assert found.galvo is not None
        assert found.galvo.row(0.1) == pytest.approx(true.galvo.row(0.1), abs=0.1)  # type: ignore[union-attr]
        assert draft.lag is not None
        assert draft.lag.lag_s == found.galvo.lag_s
        assert draft.lag.lag_s / engine.setup.line_period_s == pytest.approx(
            true.galvo.lag_s / engine.setup.line_period_s,  # type: ignore[union-attr]
            abs=0.3,
        )
        assert found.background is not None
        assert found.acquired_with == engine.setup.acquired_with
        assert not engine.status().stale


def test_without_a_line_the_search_says_so_and_the_calibration_before_stays(calibration: object) -> None:
    with open_rig("simulated") as rig, Engine(rig) as engine:
        engine.configure(Settings("240hz"))
        assert rig.bench is not None
        rig.bench.optics.show(empty())
        with pytest.raises(MeasurementError, match="no voltage"):
            find_span(engine)
        assert not engine.status().live
        assert rig.bench.card.last_volts == pytest.approx(rig.scanner.park_v)


def test_a_sweep_by_a_known_galvo_map_stays_within_the_limits_of_the_rig(
    engine: Engine, calibration, monkeypatch
) -> None:
    """Before: a voltage beyond them was commanded and refused, though the first calibration had gone no further."""
    low, high = live.LiveMeasurement(engine)._span(Draft(calibration))
    monkeypatch.setattr(engine.galvo, "limits", GalvoLimits(min_v=low + 0.02, max_v=high - 0.01))
    assert live.LiveMeasurement(engine)._span(Draft(calibration)) == (low + 0.02, high - 0.01)


def test_a_stream_that_was_begun_for_frames_ends_though_the_galvo_does_not_park(engine, rig, monkeypatch) -> None:
    """Before: it went on, a line on the bundle in its frames."""

    def refuse() -> None:
        raise DeviceError("NOT PARKED: switch the laser off", "free the card")

    monkeypatch.setattr(rig.scanner, "park", refuse)
    with pytest.raises(DeviceError, match="NOT PARKED"):
        take_frames(engine, lambda: None, 1)
    monkeypatch.undo()
    assert not engine.status().live


@pytest.mark.parametrize("scan", [False, True])
def test_after_a_calibration_that_fails_the_galvo_does_what_it_did_before(
    engine, rig, calibration, monkeypatch, scan
) -> None:
    """Before: a galvo that had been parked while frames streamed scanned afterwards."""

    def find_nothing(*_: object) -> None:
        raise MeasurementError("no line", "is the laser on?")

    monkeypatch.setattr(live.LiveMeasurement, "measure", find_nothing)
    engine.use(calibration)
    engine.start(scan=scan)
    with pytest.raises(MeasurementError):
        live.calibrate_rig(engine, lambda target: None)
    assert engine.calibration is calibration
    assert engine.status().scanning == scan
    assert ("scan" in rig.scanner.calls) == scan


def test_a_real_rig_does_not_calibrate_itself(rig: object, engine: Engine) -> None:
    with pytest.raises(InputError, match="cannot be calibrated without its user"):
        calibrate_simulated(rig, engine)  # type: ignore[arg-type]


def test_a_bundle_of_unknown_diameter_gives_no_micrometres(engine, monkeypatch):
    """620 um were assumed."""
    drafts = []

    def step_that_keeps_its_draft(first):
        return [SimpleNamespace(optional=False, target=None, accept=lambda draft, *_: drafts.append(draft) or draft)]

    monkeypatch.setattr(live, "calibration_steps", step_that_keeps_its_draft)
    monkeypatch.setattr(live.LiveMeasurement, "measure", lambda *_: None)
    live.calibrate_rig(engine, lambda target: None)
    assert [draft.bundle_um for draft in drafts] == [None]


def test_following_the_offset_parks_before_the_hold_limit_and_holds_again(engine, rig, calibration, monkeypatch):
    monkeypatch.setattr(live, "REST_S", 0.05)
    engine.galvo.hold_limit_s = 0.3
    reports, published, end_s = [], [], time.monotonic() + 30
    live.follow_offset(
        engine,
        Draft(calibration),
        published.append,
        lambda: rig.scanner.calls.count("hold") < 3 and time.monotonic() < end_s,
        lambda text, done_s, total_s: reports.append(text),
    )
    moves = [call for call in rig.scanner.calls if call in ("hold", "park")]
    assert moves[moves.index("hold") :][:5] == ["hold", "park", "hold", "park", "hold"]
    assert rig.scanner.volts == rig.scanner.park_v
    assert published
    assert any("(hold limit 0.3 s)" in text for text in reports)
    assert any("held again" in text for text in reports)
