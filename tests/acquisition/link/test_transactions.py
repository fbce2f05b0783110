"""What a client may do while something else runs, and what becomes of a client that is frozen or disconnects."""

from __future__ import annotations

import time
from concurrent.futures import Future
from pathlib import Path

import pytest

from napari_elsplus.acquisition.engine.live_images import LiveView
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.link.client import EngineClient
from napari_elsplus.acquisition.link.commands import COMMANDS, Commands, Scheduling
from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
from napari_elsplus.errors import CancelledError, InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.calibration.draft import Draft
from napari_elsplus.processing.calibration.steps import GALVO
from small_rig import small_calibration
from waiting import until

HERE = Path(__file__).parents[1]
SLOW = Settings("240hz", frame_rate_hz=100.0)
TIMEOUT_S = 1.0


def sweep(client: EngineClient) -> Future[object]:
    """Start a sweep of many seconds, where the bundle is known, and return once it runs."""
    sweeping = client.measure_step(GALVO, Draft(small_calibration()), 2000)
    until(lambda: client.status.progress is not None and client.status.progress.done > 3)
    return sweeping


def test_client_and_server_have_the_same_commands_from_one_table() -> None:
    assert {name for name in vars(EngineClient) if name in COMMANDS} == set()
    assert all(getattr(Commands, name) is command for name, command in COMMANDS.items())
    assert {name for name, command in COMMANDS.items() if command.scheduling is Scheduling.IMMEDIATE} >= {
        "park",
        "cancel",
    }
    assert not any(c.while_recording for c in COMMANDS.values() if c.scheduling is Scheduling.PROCEDURE)


def test_what_would_disturb_a_procedure_is_refused_and_told_what_runs(client: EngineClient) -> None:
    sweeping = sweep(client)
    for refused in (client.configure(SLOW), client.start(), client.use(None), client.measure_step(GALVO, Draft(), 50)):
        with pytest.raises(InputError, match="measure step is running"):
            refused.result(5)
    assert not sweeping.done()
    client.show(LiveView(average=2)).result(5)
    client.cancel().result(5)
    with pytest.raises(CancelledError, match="cancelled"):
        sweeping.result(20)
    client.configure(SLOW).result(20)


def test_park_ends_a_procedure_at_once(client: EngineClient, shared_log: Path) -> None:
    sweeping = sweep(client)
    begun_s = time.monotonic()
    client.park().result(5)
    assert time.monotonic() - begun_s < 1.0
    with pytest.raises(InputError, match="the galvo was parked"):
        sweeping.result(20)
    assert shared_log.read_text().split()[-1] == "park"


def test_a_procedure_leaves_the_calibration_of_before(client: EngineClient, calibration: Calibration) -> None:
    client.use(calibration).result(20)
    sweeping = sweep(client)
    client.cancel().result(5)
    assert sweeping.exception(20) is not None
    assert client.calibration == calibration


def test_nothing_that_changes_frames_is_done_while_they_are_recorded(client: EngineClient, tmp_path: Path) -> None:
    client.start().result(20)
    client.record(RecordingPlan(tmp_path / "r.ome.tif")).result(20)
    for refused in (client.configure(SLOW), client.measure_step(GALVO, Draft(), 50)):
        with pytest.raises(InputError, match="end the recording first"):
            refused.result(20)
    before = client.status.recorded
    until(lambda: client.status.recorded > before + 5)


def test_a_heartbeat_timeout_is_refused_if_it_is_none(client: EngineClient) -> None:
    for timeout_s in (0.0, -1.0, float("inf"), float("nan")):
        with pytest.raises(InputError, match="heartbeat timeout"):
            client.set_heartbeat_timeout(timeout_s).result(20)


def test_a_window_that_processes_no_events_counts_as_frozen(own_client: EngineClient) -> None:
    own_client.set_heartbeat_timeout(TIMEOUT_S).result(20)
    own_client.start().result(20)
    own_client.hold(0.25).result(20)
    own_client.beat_while(lambda: False)
    until(lambda: bool(own_client.status.faults))
    assert "frozen" in own_client.status.faults[0].problem
    assert own_client.status.park_state.parked
    assert own_client.status.live
