"""Threads and clocks on simulated time: one thread runs at a time, and time passes only while all of them wait.

`SimulatedTime` stands in for the modules `threading` and `time` in code under test; nothing sleeps.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from math import inf
from typing import Any, Self

from napari_elsplus.hardware.virtual.timeline import BenchClock


class Ended(BaseException):
    """Unwinds the threads of a simulated process that was killed."""


class Worker:
    """A thread that runs only while it holds the baton."""

    def __init__(self, world: SimulatedTime, run: Callable[[], object], name: str) -> None:
        self.world, self.name, self._run = world, name, run
        self.turn = threading.Semaphore(0)
        self.ready: Callable[[], bool] = lambda: True
        self.due_s = 0.0
        self.alive = False
        self.killed = False

    def start(self) -> None:
        self.alive = True
        self.world.workers.append(self)
        threading.Thread(target=self._live, name=f"simulated {self.name}", daemon=True).start()

    def is_alive(self) -> bool:
        return self.alive

    def join(self, timeout: float | None = None) -> None:
        self.world.wait(lambda: not self.alive, timeout)

    def _live(self) -> None:
        self.turn.acquire()
        try:
            if not self.killed:
                self._run()
        except Ended:
            pass
        except BaseException as error:  # noqa: BLE001 - raised by the test
            self.world.errors.append(error)
        self.alive = False
        self.world.workers.remove(self)
        self.world.pass_on()


class SimulatedTime:
    """A clock, and the threads that wait on it; the thread that makes it takes part."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.errors: list[BaseException] = []
        self.main = Worker(self, lambda: None, "main")
        self.main.alive = True
        self.workers = [self.main]
        self.running = self.main
        self.stuck: list[str] = []
        self._turn = 0

    # stand-ins for `time` and `threading`

    def perf_counter(self) -> float:
        return self.now_s

    monotonic = perf_counter

    def sleep(self, seconds: float) -> None:
        self.wait(lambda: False, seconds)

    def Thread(self, *, target: Callable[..., object], name: str = "", args: tuple[Any, ...] = (), **_: Any) -> Worker:
        return Worker(self, lambda: target(*args), name)

    def current_thread(self) -> Worker:
        return self.running

    def Event(self) -> Event:
        return Event(self)

    def RLock(self) -> RLock:
        return RLock(self)

    def Lock(self) -> RLock:
        return RLock(self)

    def Condition(self, lock: RLock | None = None) -> Condition:
        return Condition(self, lock or RLock(self))

    # the baton

    def wait(self, ready: Callable[[], bool], timeout_s: float | None = None) -> bool:
        """Let others run until a condition holds, or simulated time has passed; return the condition."""
        me = self.running
        me.ready, me.due_s = ready, inf if timeout_s is None else self.now_s + max(0.0, timeout_s)
        self.pass_on()
        me.turn.acquire()
        if me.killed:
            raise Ended
        if self.stuck:
            stuck, self.stuck = self.stuck, []
            raise AssertionError(f"threads that wait for ever: {stuck}")
        return ready()

    def pass_on(self) -> None:
        """Give the baton to the next thread that can run, in turn; where none can, time passes."""
        able = [w for w in self.workers if w.killed or w.due_s <= self.now_s or w.ready()]
        if not able:
            soonest = min(self.workers, key=lambda w: w.due_s)
            if soonest.due_s == inf:
                self.stuck, soonest = [worker.name for worker in self.workers], self.main
            else:
                self.now_s = soonest.due_s
            able = [soonest]
        self._turn += 1
        self.running = able[self._turn % len(able)]
        self.running.turn.release()

    def kill(self, *workers: Worker) -> None:
        """End threads where they wait, as the end of their process does."""
        for worker in workers:
            worker.killed = True
        self.wait(lambda: not any(worker.alive for worker in workers))


class Event:
    def __init__(self, world: SimulatedTime) -> None:
        self._world, self._set = world, False

    def set(self) -> None:
        self._set = True

    def clear(self) -> None:
        self._set = False

    def is_set(self) -> bool:
        return self._set

    def wait(self, timeout: float | None = None) -> bool:
        return self._world.wait(self.is_set, timeout)


class RLock:
    def __init__(self, world: SimulatedTime) -> None:
        self._world = world
        self.owner: Worker | None = None
        self.count = 0

    def acquire(self, blocking: bool = True) -> bool:
        me = self._world.running
        if self.owner not in (None, me):
            if not blocking:
                return False
            self._world.wait(lambda: self.owner is None)
        self.owner = me
        self.count += 1
        return True

    def release(self) -> None:
        self.count -= 1
        if not self.count:
            self.owner = None

    def __enter__(self) -> Self:
        self.acquire()
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


class Condition:
    def __init__(self, world: SimulatedTime, lock: RLock) -> None:
        self._world, self._lock, self._notified = world, lock, 0

    def __enter__(self) -> Self:
        self._lock.acquire()
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def notify_all(self) -> None:
        self._notified += 1

    def wait(self, timeout: float | None = None) -> bool:
        before = self._notified
        return self._released(lambda: self._notified != before, timeout)

    def wait_for(self, predicate: Callable[[], bool], timeout: float | None = None) -> bool:
        return self._released(predicate, timeout) if not predicate() else True

    def _released(self, ready: Callable[[], bool], timeout: float | None) -> bool:
        count, self._lock.count, self._lock.owner = self._lock.count, 0, None
        try:
            return self._world.wait(ready, timeout)
        finally:
            if self._lock.owner is not None:
                self._world.wait(lambda: self._lock.owner is None)
            self._lock.owner, self._lock.count = self._world.running, count


class SimulatedBenchClock(BenchClock):
    """The bench's clock on simulated time."""

    def __init__(self, world: SimulatedTime) -> None:
        super().__init__(real_time=False)
        self._world = world

    def now_s(self) -> float:
        return self._world.now_s

    def wait_until(self, time_s: float) -> None:
        self._world.sleep(time_s - self._world.now_s)
