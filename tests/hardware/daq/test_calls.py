"""Calls to a card and resets around those that do not return, kept apart."""

from __future__ import annotations

import threading
import time

import pytest

from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.daq import calls as calls_module
from napari_elsplus.hardware.daq.calls import Calls, CardThread
from napari_elsplus.hardware.daq.scanner import DaqScanner


def test_a_call_that_has_returned_is_not_gone_around(cards) -> None:
    """Before: a late reset took the tasks from the command that followed, which failed with -200088."""
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        with scanner._output.calls():
            late = scanner._output.calls.pending
        scanner.hold(0.3)
        assert not scanner._go_around(late)
        scanner.check()
        assert bench.card.last_volts == 0.3
        scanner.hold(0.2)


def test_a_call_that_returns_during_a_reset_waits_for_its_end_and_raises() -> None:
    calls = Calls("Dev1")
    returns, resetting, ended = threading.Event(), threading.Event(), []

    def call() -> None:
        try:
            with calls():
                returns.wait(5)
        except DeviceError as error:
            ended.append((str(error), resetting.is_set()))

    thread = threading.Thread(target=call)
    thread.start()
    while not calls.pending:
        time.sleep(0.001)
    with calls.resetting_around(calls.pending) as stuck:
        assert stuck
        returns.set()
        time.sleep(0.05)
        assert not ended
        resetting.set()
    thread.join(5)
    ((problem, after_reset),) = ended
    assert "it was reset" in problem
    assert after_reset
    with calls():  # once
        assert calls.pending
    assert not calls.pending


@pytest.fixture
def card_thread(monkeypatch: pytest.MonkeyPatch):
    """A card's thread with short limits, its calls, and the calls that were gone around."""
    monkeypatch.setattr(calls_module, "STUCK_S", 0.1)
    monkeypatch.setattr(calls_module, "GIVE_UP_S", 0.2)
    calls, around, over = Calls("Dev1"), [], threading.Event()
    thread = CardThread(
        calls,
        lambda: None if over.is_set() else 0.02,
        lambda _: 0.02,
        lambda: None,
        lambda call: around.append(call) or True,
    )
    thread.start()
    yield thread, calls, around
    over.set()
    thread.join(5)


def test_a_command_whose_call_nothing_ends_is_given_up_and_gone_around_once(card_thread) -> None:
    thread, calls, around = card_thread
    returns = threading.Event()

    def hang() -> None:
        with calls():
            returns.wait(5)

    done = []
    with pytest.raises(DeviceError, match="does not return"):
        thread.execute(hang)
    with pytest.raises(DeviceError, match="does not return"):
        thread.execute(lambda: done.append(1))
    assert len(around) == 1
    returns.set()
    assert thread.execute(lambda: 7) == 7
    assert not done, "a command that was given up is not executed later"


def test_a_call_is_gone_around_at_the_next_check_where_that_fails(monkeypatch) -> None:
    """Before: the first error but the card's own ended the thread that watches calls."""
    monkeypatch.setattr(calls_module, "STUCK_S", 0.1)
    calls, around, over, returns = Calls("Dev1"), [], threading.Event(), threading.Event()

    def go_around(call: int) -> bool:
        around.append(call)
        if len(around) == 1:
            raise MemoryError
        returns.set()
        return True

    def hang() -> None:
        with calls():
            returns.wait(5)

    thread = CardThread(calls, lambda: None if over.is_set() else 0.02, lambda _: 0.02, lambda: 1 // 0, go_around)
    thread.start()
    thread.execute(hang)
    assert len(around) == 2
    monkeypatch.setattr(threading, "excepthook", lambda _: None)
    over.set()
    thread.join(5)
    with pytest.raises(DeviceError, match="was closed"):
        thread.execute(hang)


def test_commands_are_executed_in_turn_and_raise_where_they_were_given(card_thread) -> None:
    thread, *_ = card_thread
    assert thread.execute(lambda: thread.execute(lambda: 3)) == 3
    with pytest.raises(ZeroDivisionError):
        thread.execute(lambda: 1 // 0)


def test_a_routine_that_fails_is_reported_and_called_again_and_commands_are_executed() -> None:
    reports, over = [], threading.Event()

    def routine() -> float | None:
        if over.is_set():
            return None
        raise SystemExit

    def report(error: BaseException) -> float:
        reports.append(error)
        return 0.001

    thread = CardThread(Calls("Dev1"), routine, report, lambda: None, lambda _: True)
    thread.start()
    while len(reports) < 3:
        time.sleep(0.001)
    assert thread.execute(lambda: 3) == 3
    over.set()
    thread.join(5)
    with pytest.raises(DeviceError, match="was closed"):
        thread.execute(lambda: 3)
