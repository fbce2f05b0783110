"""An engine in a process of its own, commanded through futures; its images lie in shared memory."""

from __future__ import annotations

import ast
import pickle
import secrets
import signal
import subprocess
import sys
import time
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from itertools import count
from multiprocessing.connection import Client
from queue import SimpleQueue
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.acquisition.engine.status import Status
from napari_elsplus.acquisition.link.commands import Commands
from napari_elsplus.acquisition.link.messages import HEARTBEAT_S, QUIT, Activated, Heartbeat, Reply, Request
from napari_elsplus.acquisition.streaming.faults import Fault
from napari_elsplus.acquisition.streaming.shared_memory import SharedRing
from napari_elsplus.closing import ClosedOnExit
from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.detached import DETACHED
from napari_elsplus.hardware.parking import ParkState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from napari_elsplus.acquisition.link.messages import Channel
    from napari_elsplus.errors import MeasurementError
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.draft import Draft
    from napari_elsplus.processing.calibration.slit_offset import SlitOffset

ENGINE: Final = (sys.executable, "-m", "napari_elsplus.acquisition.link.server")
SILENT_S: Final = 3.0
"""Seconds without a status, which comes ten times a second, after which an engine does not answer; chosen: longer than
a busy computer delays one, and than its guardian waits to park."""
SILENT_REMEDY: Final = "its guardian parks the galvo; disconnect, which ends the engine, and connect again"
_CLOSING_TIMEOUT_S: Final = 30.0
"""Chosen: a recording behind by all 2 s of frames in memory is finished on a disk of a tenth of the usual speed."""


class EngineClient(ClosedOnExit, Commands):
    """Starts the engine's process; its methods are the commands of :mod:`napari_elsplus.acquisition.link.commands`.

    A context manager: leaving it ends the process in order. Commands return futures, so that a window need not wait;
    ``.result()`` waits and raises what the engine raised.

    Parameters
    ----------
    command : sequence of str
        Starts the process.

    Attributes
    ----------
    calibration : Calibration or None
        The active one, as of the newest reply.
    died : DeviceError or None
        Why there is no engine any more; None while its process lives.

    Raises
    ------
    DeviceError
        If the process does not start.
    """

    def __init__(self, command: Sequence[str] = ENGINE) -> None:
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **DETACHED)
        self._connection = self._connect()
        self._numbers = count()
        self._waiting: dict[int, Future[Any]] = {}
        self._lock = Lock()
        self._status = Status()
        self.calibration: Calibration | None = None
        self.died: DeviceError | None = None
        self._closing = False
        self._ring: SharedRing | None = None
        self._attended: Callable[[], bool] = lambda: True
        self._unheard = 0
        self._ended = Event()
        self._to_send: SimpleQueue[bytes | None] = SimpleQueue()
        self._threads = [
            Thread(target=work, name=f"engine-{name}", daemon=True)
            for name, work in (("client", self._receive), ("sender", self._send), ("heartbeat", self._beat))
        ]
        for thread in self._threads:
            thread.start()

    def call(self, name: str, *arguments: Any, **options: Any) -> Future[Any]:
        """Return the future result of a command, by its name."""
        future: Future[Any] = Future()
        number = next(self._numbers)
        request = pickle.dumps(Request(number, name, arguments, options))
        with self._lock:
            if self.died is not None:
                future.set_exception(self.died)
                return future
            self._waiting[number] = future
            self._to_send.put(request)
        return future

    @property
    def pid(self) -> int:
        """Of the engine's process."""
        return self._process.pid

    @property
    def status(self) -> Status:
        """The newest status of the engine; with a fault, and nothing known of the galvo, where it does not answer.

        Of a galvo that was parked nothing is known either once the process has ended otherwise than by `close`.
        """
        status = self._status
        if self.died is not None:
            in_order = self._closing and self._process.returncode == 0
            return status if in_order or not status.park_state.parked else replace(status, park_state=ParkState())
        if self._unheard * HEARTBEAT_S < SILENT_S:
            return status
        silent = Fault("engine", f"the engine has not answered for {SILENT_S:g} s", SILENT_REMEDY, time.time())
        return replace(status, park_state=ParkState(), faults=(*status.faults, silent))

    def display(self) -> SharedRing | None:
        """Return the ring of the newest images; to be used by one thread, until the next call."""
        where = self._status.display
        if where is None or self._closing or self.died is not None:
            return None
        name, layout = where
        if self._ring is None or self._ring.name != name:
            self._detach()
            try:
                self._ring = SharedRing.attach(name, layout)
            except FileNotFoundError:  # replaced a moment ago; the next status has the name of the new one
                return None
        return self._ring

    def close(self) -> None:
        """End the engine: recording finished, galvo parked, nothing left; `status` then tells whether it was parked."""
        if self._closing:
            return
        self._closing = True
        self._detach()
        self.call(QUIT)
        try:
            self._process.wait(_CLOSING_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self._process.communicate()
        for thread in self._threads:
            thread.join()
        self._connection.close()
        self._detach()

    def beat_while(self, attended: Callable[[], bool]) -> None:
        """Send heartbeats only while a function returns True: that the window's events are processed, for instance.

        Parameters
        ----------
        attended : callable
            Called twice a second in a thread of the client. True always by default: then only a process that is stopped
            sends no heartbeats.
        """
        self._attended = attended

    # inside

    def _connect(self) -> Channel:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        key = secrets.token_bytes(32)
        try:
            self._process.stdin.write(key.hex() + "\n")
            self._process.stdin.flush()
            address = self._process.stdout.readline()
            if not address:
                raise EOFError
            return Client(ast.literal_eval(address), authkey=key)
        except (OSError, EOFError):
            self._process.kill()
            self._process.communicate()
            raise DeviceError(
                f"the engine's process did not start (exit code {self._process.returncode})",
                "see what it wrote to the terminal",
            ) from None

    def _receive(self) -> None:
        while True:
            try:
                message = self._connection.recv()
            except (EOFError, OSError):
                break
            self._unheard = 0
            match message:
                case Status():
                    self._status = message
                case Activated(calibration):
                    self.calibration = calibration
                case Reply():
                    self._answer(message)
        self._end()

    def _send(self) -> None:
        """Send in a thread of its own: of an engine that reads nothing, only this one waits."""
        while (message := self._to_send.get()) is not None:
            with suppress(OSError):  # the reader notices, too, and answers every future
                self._connection.send_bytes(message)

    def _beat(self) -> None:
        heartbeat = pickle.dumps(Heartbeat())
        while not self._ended.wait(HEARTBEAT_S):
            self._unheard += 1
            if self._attended():
                self._to_send.put(heartbeat)

    def _answer(self, reply: Reply) -> None:
        with self._lock:
            future = self._waiting.pop(reply.number)
        if reply.error is not None:
            future.set_exception(reply.error)
        else:
            future.set_result(reply.result)

    def _end(self) -> None:
        """Note why the process ended, and raise that from every future that waits."""
        self._ended.set()
        error = DeviceError("the engine was closed", "connect again")
        if not self._closing:
            code = self._process.wait()
            how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
            error = DeviceError(
                f"the engine's process ended ({how})",
                "its guardian parks the galvo, and what was recorded is kept: connect again, which confirms that",
            )
        with self._lock:
            self.died = error
            waiting, self._waiting = self._waiting, {}
        self._to_send.put(None)
        for future in waiting.values():
            future.set_exception(error)

    def _detach(self) -> None:
        ring, self._ring = self._ring, None
        if ring is not None:
            ring.close()


def followed_offsets(
    client: EngineClient, draft: Draft, keep_on: Callable[[], bool]
) -> Iterator[tuple[int, SlitOffset | MeasurementError]]:
    """Yield the newest slit offset, which the engine measures in frame after frame.

    Parameters
    ----------
    client : EngineClient
        With a rig that is open and configured.
    draft : Draft
        Results so far; the place of the line and the background are taken from it.
    keep_on : callable
        Called before each; False ends the measurement.

    Yields
    ------
    int
        Frames measured so far.
    SlitOffset or MeasurementError
        The newest offset, or the reason why there is none.

    Raises
    ------
    DeviceError
        If camera or galvo fail.
    """
    old = client.newest_offset(-1).result()
    first = seen = 0 if old is None else old[0]
    followed = client.follow_offset(draft)
    try:
        while keep_on() and not followed.done():
            newest = client.newest_offset(seen).result()
            if newest is not None:
                seen, found = newest
                yield seen - first, found
    finally:
        client.cancel().result()
        followed.result()
