"""What a defect in the engine's process must not hinder: replies, supervision, parking."""

from __future__ import annotations

import sys
from multiprocessing import Pipe
from threading import Event, Thread

import pytest

from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import Settings, Status
from napari_elsplus.acquisition.link.messages import QUIT, Reply, Request
from napari_elsplus.acquisition.link.server import Server
from napari_elsplus.acquisition.link.session import Session
from napari_elsplus.acquisition.link.supervision import Supervision
from napari_elsplus.errors import DeviceError

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
            ours.send(Request(number, "usage", (), {}))
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
