"""What a client knows of the galvo when the engine has ended, or does not answer: parked, not parked, or nothing."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from threading import Barrier, BrokenBarrierError, Thread

import numpy as np
import pytest

from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.link.client import EngineClient
from napari_elsplus.acquisition.link.session import Session
from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.parking import ParkStage
from napari_elsplus.hardware.virtual.card.process import RemoteCard, start_card
from small_rig import SmallRig, small_calibration
from waiting import until

ENGINE = Path(__file__).parents[1] / "engine_process.py"


@pytest.fixture
def card() -> Iterator[RemoteCard]:
    with start_card() as card:
        yield card


@pytest.fixture
def client(card: RemoteCard, tmp_path: Path) -> Iterator[EngineClient]:
    with EngineClient((sys.executable, str(ENGINE), str(tmp_path / "log"), card.address)) as client:
        client.open("small").result(60)
        client.configure(Settings("240hz", frame_rate_hz=100.0)).result(60)
        client.start().result(60)
        client.hold(0.25).result(60)
        yield client


def test_a_client_that_has_closed_its_engine_knows_that_the_galvo_is_parked(client: EngineClient) -> None:
    """Before: the last that it knew was from before."""
    client.close()
    assert client.status.park_state.stage is ParkStage.PARKED


def test_a_client_that_has_closed_its_engine_knows_that_the_galvo_is_not_parked(client, card) -> None:
    """Before: that was said on the terminal alone."""
    card.inject(refuse_s=60.0)
    client.close()
    assert client.status.park_state.message.startswith("NOT PARKED: switch the laser off")
    card.inject(refuse_until_s=0.0)
    until(lambda: card.last_volts == pytest.approx(-0.7), seconds=30.0)  # by the guardian


@pytest.mark.skipif(os.name != "posix", reason="stops processes as POSIX does")
def test_of_an_engine_that_does_not_answer_nothing_is_claimed(client: EngineClient) -> None:
    """Before: its last status was displayed without end, as if frames streamed."""
    os.kill(client.pid, signal.SIGSTOP)
    try:
        until(lambda: any("has not answered" in fault.problem for fault in client.status.faults), seconds=30.0)
        assert client.status.park_state.stage is ParkStage.UNKNOWN
    finally:
        os.kill(client.pid, signal.SIGCONT)
    until(lambda: client.status.park_state.parked, seconds=30.0)
    assert any("stood still" in fault.problem for fault in client.status.faults)
    assert not any("has not answered" in fault.problem for fault in client.status.faults)


@pytest.mark.skipif(os.name != "posix", reason="stops processes as POSIX does")
def test_a_large_command_to_an_engine_that_does_not_answer_holds_no_window_up(own_client: EngineClient) -> None:
    """Before: the window waited until the engine read it, and could not even disconnect."""
    large = small_calibration().model_copy(update={"background": np.zeros((524, 1328), np.float32)})
    os.kill(own_client.pid, signal.SIGSTOP)
    commanded: list[Future[None]] = []
    window = Thread(target=lambda: commanded.append(own_client.use(large)), daemon=True)
    try:
        window.start()
        window.join(5.0)
        assert not window.is_alive()
        parked = own_client.park()
    finally:
        os.kill(own_client.pid, signal.SIGCONT)
    commanded[0].result(30)
    parked.result(30)


def test_rigs_that_are_opened_at_once_do_not_forget_one_another() -> None:
    """Before: the one that opened first was neither closed nor parked any more."""
    together, opened = Barrier(2), list[SmallRig]()

    def open_slowly(_: str) -> SmallRig:
        with suppress(BrokenBarrierError):
            together.wait(1.0)
        opened.append(SmallRig())
        return opened[-1]

    session = Session(open_slowly)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(session.open, ("first", "second")))
    session.close()
    assert [rig.scanner.calls.count("close") for rig in opened] == [1, 1]


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
def test_of_an_engine_that_was_killed_while_the_galvo_was_parked_nothing_is_claimed(client: EngineClient) -> None:
    """Before: parked, although the engine may have moved it since its last status."""
    client.park().result(60)
    until(lambda: client.status.park_state.parked)
    os.kill(client.pid, signal.SIGKILL)
    until(lambda: client.died is not None)
    assert client.status.park_state.stage is ParkStage.UNKNOWN


def test_while_a_rig_is_closed_its_own_galvo_is_told_and_not_that_of_the_rig_before() -> None:
    """Before: parked as the rig before was, while this one was driven and refused to park."""
    rigs = [SmallRig(), SmallRig()]
    session = Session(lambda _: rigs.pop())
    session.open("first")
    session.close()
    assert session.status.park_state.parked
    session.open("second")
    scanner, told = session.rig.scanner, []

    def refuse() -> None:
        told.append(session.status.park_state.parked)
        raise DeviceError("the card is in use", "free it")

    scanner.park, scanner.close = refuse, lambda: None  # type: ignore[method-assign]
    session.engine.hold(0.3)
    session.close()
    told.append(session.status.park_state.parked)
    assert len(told) > 1
    assert not any(told)
