"""The watch of a running stream: whatever it meets ends the stream with the galvo parked, and is stated."""

from __future__ import annotations

import sys
from typing import Any, NoReturn

import pytest

from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.errors import DeviceError
from waiting import until


class UnprintableError(Exception):
    """A defect whose own text cannot be made."""

    def __str__(self) -> str:
        raise ValueError("no text")


@pytest.fixture
def streaming(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> Engine:
    """An engine that streams with its line held off the parking position."""
    monkeypatch.setattr(sys, "excepthook", lambda *_: None)
    engine.start(scan=False)
    engine.hold(0.2)
    return engine


def stated(engine: Engine) -> str:
    return "; ".join(fault.problem for fault in engine.status().faults)


@pytest.mark.parametrize(("defect", "problem"), [(SystemExit, "SystemExit"), (UnprintableError, "no text")])
def test_a_defect_of_the_watch_is_stated_and_the_galvo_parked(
    streaming: Engine, rig: Any, monkeypatch: pytest.MonkeyPatch, defect: type[BaseException], problem: str
) -> None:
    """Before: it ended the watch; the line stood on the bundle, and nothing was stated."""

    def fail() -> NoReturn:
        raise defect

    monkeypatch.setattr(rig.scanner, "check", fail)
    until(lambda: problem in stated(streaming))
    until(lambda: not streaming.status().live)
    assert rig.scanner.park_state.parked
    until(lambda: not rig.camera.streams)
    monkeypatch.undo()
    streaming.start(scan=False)
    assert streaming.status().live


def test_a_fault_whose_handling_fails_is_handled_again_and_both_are_stated(
    streaming: Engine, rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before: the watch ended, with the camera streaming; later faults were not seen."""
    run = streaming._run
    assert run is not None
    stop, defects = run.stop, [ZeroDivisionError("half way")]

    def stop_later() -> None:
        if defects:
            raise defects.pop()
        stop()

    def lose_strobe() -> NoReturn:
        raise DeviceError("the strobe is lost", "check its cable")

    monkeypatch.setattr(run, "stop", stop_later)
    monkeypatch.setattr(rig.scanner, "check", lose_strobe)
    until(lambda: "half way" in stated(streaming))
    until(lambda: not rig.camera.streams)
    assert "the strobe is lost" in stated(streaming)
    assert rig.scanner.park_state.parked
    monkeypatch.undo()
    streaming.start(scan=False)
    streaming.hold(0.2)
    monkeypatch.setattr(rig.scanner, "check", lose_strobe)
    until(lambda: not streaming.status().live)
    assert rig.scanner.park_state.parked
