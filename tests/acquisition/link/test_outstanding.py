"""A command that waits for one that is stuck is stated, with what can be done."""

from __future__ import annotations

from multiprocessing import Pipe
from threading import Event, Thread

import pytest

from napari_elsplus.acquisition.engine.status import Status
from napari_elsplus.acquisition.link import server
from napari_elsplus.acquisition.link.messages import QUIT, Reply, Request
from napari_elsplus.acquisition.link.outstanding import OutstandingCommands

TO_DO = "; Park acts at once, and disconnecting ends the engine"


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["configure", "stop"], "stop waits for configure, which has not ended for 5 s"),
        (["configure", "start", "stop"], "stop waits for configure, which has not ended for 5 s"),
        (["record", "stop"], "stop waits for record, which has not ended for 5 s"),
        (["stop"], "stop has not ended for 5 s"),
        (["stop", "clear_mosaic"], "stop has not ended for 5 s"),
        (["clear_mosaic"], ""),
        (["measure_step"], ""),
    ],
)
def test_what_waits_for_what(names: list[str], said: str) -> None:
    clock = Clock()
    outstanding = OutstandingCommands(clock)
    requests = [Request(number, name) for number, name in enumerate(names)]
    for request in requests:
        outstanding.add(request)
    assert outstanding.waiting() == ""
    clock.now_s += 5.0
    assert outstanding.waiting() == (said + TO_DO if said else "")
    for request in requests:
        outstanding.remove(request)
    assert outstanding.waiting() == ""


def test_the_status_states_what_stop_waits_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before: stop waited behind a stuck command without a word."""
    stuck = Event()
    monkeypatch.setattr(server, "execute", lambda _session, request, _given_s: request.name == "stop" or stuck.wait(60))
    monkeypatch.setattr("napari_elsplus.acquisition.link.outstanding.MAX_SILENT_S", 0.0)
    ours, its = Pipe()
    serving = Thread(target=server.Server(its, lambda _: None).serve, daemon=True)  # type: ignore[arg-type,return-value]
    serving.start()
    ours.send(Request(1, "configure"))
    ours.send(Request(2, "stop"))

    def received(kind: type) -> object:
        while ours.poll(20):
            message = ours.recv()
            if isinstance(message, kind) and (kind is Reply or message.waiting):
                return message
        raise AssertionError(kind)

    status = received(Status)
    while not status.waiting.startswith("stop waits for configure, which has not ended for "):  # type: ignore[attr-defined]
        status = received(Status)
    stuck.set()
    assert [received(Reply).number for _ in range(2)] == [1, 2]  # type: ignore[attr-defined]
    while (status := ours.recv()).waiting:
        pass
    ours.send(Request(3, QUIT))
    serving.join(20)
    assert not serving.is_alive()
