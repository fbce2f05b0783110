"""What a defect in the engine's process must not hinder: replies, supervision, parking."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from itertools import count
from multiprocessing import Pipe
from threading import Event, Thread
from types import SimpleNamespace

import pytest

from napari_elsplus.acquisition.calibrating.live import LiveMeasurement
from napari_elsplus.acquisition.engine.display import Display
from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import Settings, Status
from napari_elsplus.acquisition.link.messages import QUIT, Reply, Request
from napari_elsplus.acquisition.link.server import Server
from napari_elsplus.acquisition.link.session import LiveMosaic, Session
from napari_elsplus.acquisition.link.supervision import Supervision
from napari_elsplus.acquisition.mosaic.tracking import TrackState
from napari_elsplus.errors import CancelledError, DeviceError, InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.calibration.draft import Draft
from napari_elsplus.processing.calibration.steps import GALVO
from napari_elsplus.workflows.mosaic_plan import MosaicPlan

SOON_S = 10.0


def failing(_: object) -> Status:
    raise RuntimeError("a defect in the status")


def test_a_camera_that_answers_nothing_while_it_is_configured_takes_no_status_away(engine: Engine, rig) -> None:
    """Before: the status raised what the camera did."""

    class Silent(type(rig.camera)):
        @property
        def frame_shape(self) -> tuple[int, int]:
            raise DeviceError("the camera was not configured", "configure it first")

        @property
        def line_periods_per_frame(self) -> float:
            raise DeviceError("the camera was not configured", "configure it first")

    engine.start()
    expected = engine.status().disk_bytes_per_s
    assert expected == pytest.approx(524 * 1328 * 100.0)
    rig.camera.__class__, before = Silent, rig.camera.__class__
    try:
        assert engine.status().disk_bytes_per_s == expected
    finally:
        rig.camera.__class__ = before
    engine.configure(Settings("240hz", frame_rate_hz=50.0))
    assert engine.status().disk_bytes_per_s == pytest.approx(524 * 1328 * 50.0)


def test_replies_come_though_the_status_fails(monkeypatch) -> None:
    """Before: the thread that executed the command ended, and the client waited without end."""
    printed: list[BaseException] = []
    monkeypatch.setattr(sys, "excepthook", lambda _kind, error, _trace: printed.append(error))
    ours, its = Pipe()
    with monkeypatch.context() as defective:
        defective.setattr(Session, "status", property(failing))
        server = Thread(target=Server(its, lambda _: None).serve, daemon=True)
        server.start()
        for number in range(2):
            ours.send(Request(number, "cancel", (), {}))
            assert ours.poll(SOON_S)
            reply = ours.recv()
            assert isinstance(reply, Reply)
            assert (reply.number, reply.error) == (number, None)
    assert ours.poll(SOON_S), "the thread that sends the status has ended"
    assert isinstance(ours.recv(), Status)
    ours.send(Request(9, QUIT, (), {}))
    server.join(SOON_S)
    assert not server.is_alive()
    assert [str(error) for error in printed] == ["a defect in the status"]


def test_a_rig_without_an_engine_is_closed(rig, monkeypatch) -> None:
    """Before: its card and its camera stayed in use, and its guardian on guard."""
    monkeypatch.setattr(rig.scanner, "on_park_state", failing)
    session = Session(lambda _: rig)
    with pytest.raises(RuntimeError):
        session.open("small")
    assert rig.scanner.calls[-1] == "close"


def test_a_rig_that_fails_as_it_is_closed_leaves_no_mosaic_in_memory(rig, monkeypatch) -> None:
    """Before: the tracks of such rigs, and their shared memory, were kept as long as the engine's process."""
    session, released = Session(lambda _: rig), Event()
    session.open("small")
    session.mosaic._track = SimpleNamespace(close=released.set)
    monkeypatch.setattr(type(rig), "close", failing)
    with pytest.raises(RuntimeError):
        session.close()
    assert released.is_set()


def test_a_track_that_has_failed_does_not_run(engine: Engine, monkeypatch) -> None:
    """Before: the mosaic was growing for ever, by the status."""

    def fail(*_: object) -> None:
        raise RuntimeError("a defect in the tracker")

    monkeypatch.setattr(sys, "excepthook", lambda *_: None)
    mosaic = LiveMosaic(engine)
    mosaic._track = SimpleNamespace(state=TrackState(MosaicPlan(), "", 1.0, 1.0, {}, None))
    engine.track(SimpleNamespace(add=lambda raw, stamp: None))
    engine.start(scan=False)
    assert mosaic.state.running
    engine.track(SimpleNamespace(add=fail))
    end_s = time.monotonic() + SOON_S
    while not engine.status().faults and time.monotonic() < end_s:
        time.sleep(0.01)
    assert not mosaic.state.running


def test_a_frozen_window_parks_though_the_status_fails(rig, monkeypatch) -> None:
    """Before: the supervision ended with the error, the galvo went on."""
    session = Session(lambda _: rig)
    session.open("small")
    session.engine.configure(Settings("240hz", frame_rate_hz=100.0))
    session.engine.start()
    session.engine.hold(0.2)
    monkeypatch.setattr(Engine, "status", failing)
    session._secure(DeviceError("the window was frozen", "start again"))
    monkeypatch.undo()
    assert rig.scanner.park_state.parked
    assert "frozen" in session.engine.status().faults[0].problem
    session.close()


def test_a_galvo_at_rest_is_no_fault_of_a_frozen_window(rig) -> None:
    session = Session(lambda _: rig)
    session.open("small")
    session._secure(DeviceError("the window was frozen", "start again"))
    assert not session.engine.status().faults
    session.close()


def test_a_procedure_that_prepares_names_no_command_and_counts_nothing(rig) -> None:
    """Before: `use simulated calibration, 0 of 1`, for half a minute where the rig is calibrated for the first time."""
    session = Session(lambda _: rig)
    session.open("small")
    session.engine.configure(Settings("240hz", frame_rate_hz=100.0))
    with session.procedure("use simulated calibration", time.perf_counter(), activates=True):
        assert str(session.status.progress) == "preparing"
    session.close()


def test_a_procedure_that_is_cancelled_before_it_begins_is_cancelled(rig) -> None:
    """Before: its beginning forgot the command, and following the slit offset went on without end."""
    session = Session(lambda _: rig)
    session.open("small")
    given_s = time.perf_counter()
    session.cancel()
    with session.procedure("the sweep", given_s, activates=False):
        assert session.cancelled
        with pytest.raises(CancelledError, match="the sweep was cancelled"):
            list(session.watch(range(3), "sweep"))
    with session.procedure("the next one", time.perf_counter(), activates=False):
        assert not session.cancelled
    session.close()


def test_a_frozen_window_ends_a_procedure_whose_galvo_is_parked_at_the_moment(rig) -> None:
    """Before: it moved the galvo afterwards, as the slit offset is followed with rests, and nothing acted again."""
    session = Session(lambda _: rig)
    session.open("small")
    session.engine.configure(Settings("240hz", frame_rate_hz=100.0))
    session.engine.start(scan=False)
    resting, frozen = Event(), Event()
    raised: list[Exception] = []

    def rest_and_hold() -> None:
        try:
            with session.procedure("the offset", time.perf_counter(), activates=False):
                resting.set()
                frozen.wait(SOON_S)
                session.engine.hold(0.2)
        except InputError as error:
            raised.append(error)

    thread = Thread(target=rest_and_hold)
    thread.start()
    resting.wait(SOON_S)
    session._secure(DeviceError("the window was frozen", "start again"))
    frozen.set()
    thread.join(SOON_S)
    assert "the window was frozen" in str(raised[0])
    assert "hold" not in rig.scanner.calls
    assert "frozen" in session.engine.status().faults[0].problem
    session.close()


class Served:
    """A server of the small rig in a thread, and its client."""

    def __init__(self, rig: object) -> None:
        self.connection, its = Pipe()
        self.thread = Thread(target=self._serve, args=(Server(its, lambda _: rig),), daemon=True)
        self.ended_by: list[Exception] = []
        self._replies: dict[int, Reply] = {}
        self._numbers = count()
        self.thread.start()

    def _serve(self, server: Server) -> None:
        try:
            server.serve()
        except Exception as error:  # noqa: BLE001 - judged by the test
            self.ended_by.append(error)

    def send(self, name: str, *arguments: object) -> int:
        number = next(self._numbers)
        self.connection.send(Request(number, name, arguments, {}))
        return number

    def result(self, number: int) -> object:
        while number not in self._replies:
            assert self.connection.poll(SOON_S)
            message = self.connection.recv()
            if isinstance(message, Reply):
                self._replies[message.number] = message
        reply = self._replies[number]
        if reply.error is not None:
            raise reply.error
        return reply.result

    def call(self, name: str, *arguments: object) -> object:
        return self.result(self.send(name, *arguments))


@pytest.fixture
def served(rig) -> Iterator[Served]:
    served = Served(rig)
    served.call("open", "small")
    served.call("configure", Settings("240hz", frame_rate_hz=100.0))
    yield served
    served.connection.close()
    served.thread.join(SOON_S)
    assert not served.thread.is_alive()


def test_requests_of_a_thread_are_no_heartbeats_of_the_window(served: Served, rig) -> None:
    """Before: a panel that follows the slit offset asked for it in a thread, also while its window was frozen."""
    served.call("set_heartbeat_timeout", 1.0)
    served.call("hold", 0.2)
    end_s = time.monotonic() + SOON_S
    while not rig.scanner.park_state.parked and time.monotonic() < end_s:
        served.call("newest_offset", -1)
    assert rig.scanner.park_state.parked


def test_what_waited_when_park_was_commanded_does_not_move_the_galvo_afterwards(served, rig, monkeypatch) -> None:
    """Before: it began as if it had been commanded after Park."""
    leave = Event()
    monkeypatch.setattr(Engine, "scan", lambda _: leave.wait(SOON_S))
    scanned, held = served.send("scan"), served.send("hold", 0.2)
    served.call("park")
    leave.set()
    with pytest.raises(InputError, match="the galvo was parked, so hold has ended"):
        served.result(held)
    assert "hold" not in rig.scanner.calls
    served.result(scanned)
    served.call("hold", 0.2)
    assert rig.scanner.volts == 0.2


@pytest.mark.parametrize("held_s", [0.0, pytest.param(6.0, marks=pytest.mark.slow)])
def test_calibrations_that_are_activated_within_a_moment_take_each_others_place(
    served, calibration, monkeypatch, held_s: float
) -> None:
    """Before: they were refused after 5 s, activated in any order, and kept other commands waiting."""
    activate, leave, seen = Display.activate, Event(), []

    def activate_once_free(display: Display, one: Calibration | None, **options: bool) -> None:
        leave.wait(SOON_S)
        activate(display, one, **options)
        seen.append(one)

    monkeypatch.setattr(Display, "activate", activate_once_free)
    others = [calibration.with_optics(um_per_px=1 + 0.1 * number) for number in range(5)]
    used = [served.send("use", other) for other in others]
    served.call("setup")
    assert not leave.wait(held_s)
    leave.set()
    for number in used:
        served.result(number)
    assert seen == others


def test_an_operation_that_waits_for_another_is_interrupted_by_park_as_well(engine: Engine, rig) -> None:
    """Before: it began as if it had been commanded after Park."""
    entered, leave = Event(), Event()
    raised: list[Exception] = []

    def occupy() -> None:
        with engine.operations.alone("the stop"):
            entered.set()
            leave.wait(SOON_S)

    def hold() -> None:
        try:
            engine.hold(0.2)
        except InputError as error:
            raised.append(error)

    threads = [Thread(target=occupy), Thread(target=hold)]
    threads[0].start()
    entered.wait(SOON_S)
    threads[1].start()
    while not engine.operations._changed._waiters:
        time.sleep(0.01)
    engine.park()
    leave.set()
    for thread in threads:
        thread.join(SOON_S)
    assert "the galvo was parked" in str(raised[0])
    assert "hold" not in rig.scanner.calls


def test_closing_parks_before_it_waits_for_what_holds_the_engine(rig) -> None:
    """Before: a view that was being made, which may compile for seconds, held it up."""
    engine = Engine(rig)
    engine.configure(Settings("240hz", frame_rate_hz=100.0))
    engine.start(scan=False)
    engine.hold(0.2)
    closing = Thread(target=engine.close)
    with engine._lock:
        closing.start()
        end_s = time.monotonic() + SOON_S
        while not rig.scanner.park_state.parked and time.monotonic() < end_s:
            time.sleep(0.01)
        assert rig.scanner.park_state.parked
    closing.join(SOON_S)
    assert rig.scanner.calls[-1] == "close"


def test_closing_that_is_interrupted_while_it_parks_closes_the_rig(rig, monkeypatch) -> None:
    engine = Engine(rig)
    monkeypatch.setattr(engine.galvo, "try_to_park", lambda: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        engine.close()
    assert rig.scanner.calls[-1] == "close"


def test_a_request_that_cannot_be_read_ends_the_process_in_order(served: Served, rig, monkeypatch) -> None:
    """Before: it waited for the procedure that ran, which may go on without end, its galvo moving."""

    def hold_on(measurement: LiveMeasurement, *_: object) -> None:
        engine = measurement._engine
        engine.hold(0.2)
        while True:
            engine.fresh_frames(1)

    monkeypatch.setattr(LiveMeasurement, "measure", hold_on)
    served.call("start")
    served.send("measure_step", GALVO, Draft(), 50)
    end_s = time.monotonic() + SOON_S
    while rig.scanner.volts != 0.2 and time.monotonic() < end_s:
        time.sleep(0.01)
    served.connection.send_bytes(b"no request")
    served.thread.join(SOON_S)
    assert not served.thread.is_alive()
    assert served.ended_by
    assert rig.scanner.calls[-1] == "close"


def test_a_result_that_cannot_be_sent_is_an_error_of_its_command(served: Served, monkeypatch) -> None:
    """Before: the client waited for it without end; another package's step may find anything."""
    monkeypatch.setattr(sys, "excepthook", lambda *_: None)
    monkeypatch.setattr(LiveMeasurement, "measure", lambda *_: Event())
    with pytest.raises(RuntimeError, match="measure_step"):
        served.call("measure_step", GALVO, Draft(), 50)


def test_the_supervision_goes_on_after_an_error_of_what_it_calls() -> None:
    """Before: its thread ended."""
    acted = Event()
    calls: list[DeviceError] = []

    def act(fault: DeviceError) -> None:
        calls.append(fault)
        acted.set()
        raise RuntimeError("a defect")

    supervision = Supervision(act)
    supervision.set_timeout(1.0)
    supervision.start()
    for number in range(1, 3):
        acted.clear()
        supervision.beat()
        assert acted.wait(SOON_S)
        assert len(calls) == number
    assert supervision.is_alive()
    supervision.stop()
