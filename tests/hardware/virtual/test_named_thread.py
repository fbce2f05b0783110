from __future__ import annotations

import threading

import pytest

from napari_elsplus.hardware.virtual.named_thread import NamedThread


def named(name: str) -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == name]


def test_calls_run_in_the_thread_in_turn_and_their_errors_are_raised() -> None:
    worker, names = NamedThread("simulated test"), []
    assert not named("simulated test")
    for _ in range(3):
        worker.run(lambda: names.append(threading.current_thread().name))
    assert names == ["simulated test"] * 3
    assert worker.run(lambda: 7) == 7
    with pytest.raises(ZeroDivisionError):
        worker.run(lambda: 1 // 0)
    worker.run(lambda: names.append("after"))
    assert names[-1] == "after"


def test_the_thread_ends_with_its_owner() -> None:
    class Owner:
        def __init__(self) -> None:
            self.worker, self.calls = NamedThread("simulated end"), 0

        def count(self) -> None:
            self.worker.run(lambda: setattr(self, "calls", self.calls + 1))

    owner = Owner()
    owner.count()
    assert owner.calls == 1
    (thread,) = named("simulated end")
    del owner
    thread.join(100)
    assert not thread.is_alive()
