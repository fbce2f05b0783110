"""The engine in a process of its own: ``python -m napari_elsplus.acquisition.link.server``.

A frozen or killed napari then neither loses frames nor leaves the galvo moving. The process reads a key from its
standard input, writes the address at which it listens to its standard output, and executes the commands of
:mod:`napari_elsplus.acquisition.link.commands` over one connection. It sends its status ten times a second, and before
each reply, so that whoever has the reply has what the command changed. When the connection ends, so does the process,
in order: galvo parked, recording finished, memory released.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Listener
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Final

from napari_elsplus.acquisition.calibrating.simulated import open_live
from napari_elsplus.acquisition.link.commands import COMMANDS, Scheduling, execute
from napari_elsplus.acquisition.link.messages import QUIT, Activated, Heartbeat, Reply, Request
from napari_elsplus.acquisition.link.outstanding import OutstandingCommands
from napari_elsplus.acquisition.link.session import Session
from napari_elsplus.acquisition.streaming import shared_memory as shared
from napari_elsplus.errors import ElsPlusError
from napari_elsplus.hardware.priority import keep_pace
from napari_elsplus.processing.compilation import reported_compilation

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.acquisition.engine.status import Status
    from napari_elsplus.acquisition.link.messages import Channel
    from napari_elsplus.hardware.rig import Rig
    from napari_elsplus.instrument.calibration import Calibration

STATUS_PERIOD_S: Final = 0.1
"""Chosen: a tenth of a second is at once for whoever reads it."""
_THREADS: Final = 4
"""Commands that run at once at most, beside those that run one at a time; chosen: a procedure, and three to spare."""


class Server:
    """Executes commands until the connection ends.

    Parameters
    ----------
    connection : multiprocessing.connection.Connection
        To the client.
    open_rig : callable
        Opens a rig by its name.
    """

    def __init__(self, connection: Channel, open_rig: Callable[[str], Rig]) -> None:
        self._connection, self._session = connection, Session(open_rig)
        self._sending = Lock()
        self._ended = Event()
        self._calibration: Calibration | None = None
        self._status_fails = False
        self._outstanding = OutstandingCommands()

    def serve(self) -> None:
        """Execute commands until the connection ends; then close the rig."""
        sender = Thread(target=self._send_status, name="status", daemon=True)
        sender.start()
        self._session.supervision.start()
        try:
            compiling = reported_compilation(self._session.report_compilation)
            with (
                compiling,
                ThreadPoolExecutor(_THREADS, "command") as pool,
                ThreadPoolExecutor(1, "exclusive") as queue,
            ):
                try:
                    self._receive(queue, pool)
                finally:
                    self._session.close()  # which ends what runs
        finally:
            self._ended.set()
            self._session.supervision.stop()
            self._session.close()  # what was opened meanwhile
            sender.join()
            self._send()  # whether the galvo was parked

    def _receive(self, exclusive: ThreadPoolExecutor, others: ThreadPoolExecutor) -> None:
        """Execute requests until the connection ends, exclusive ones in their order."""
        while True:
            try:
                request = self._connection.recv()
            except (EOFError, OSError):
                return
            if isinstance(request, Heartbeat):
                self._session.supervision.beat()
            elif request.name == QUIT:
                return
            elif (scheduling := COMMANDS[request.name].scheduling) is Scheduling.IMMEDIATE:
                self._execute(request, time.perf_counter())
            else:
                self._outstanding.add(request)
                (exclusive if scheduling is Scheduling.EXCLUSIVE else others).submit(
                    self._execute, request, time.perf_counter()
                )

    def _execute(self, request: Request, given_s: float) -> None:
        try:
            reply = pickle.dumps(Reply(request.number, execute(self._session, request, given_s)))
        except (ElsPlusError, OSError) as error:
            reply = pickle.dumps(Reply(request.number, error=error))
        except Exception as error:  # noqa: BLE001 - a defect, or a result of no use: the client must not wait for ever
            sys.excepthook(type(error), error, error.__traceback__)
            raised = RuntimeError(f"{type(error).__name__} in {request.name}: {error}")
            reply = pickle.dumps(Reply(request.number, error=raised))
        finally:
            self._outstanding.remove(request)
        self._send(reply)

    def _send_status(self) -> None:
        while not self._ended.wait(STATUS_PERIOD_S):
            self._send()

    def _send(self, *replies: bytes) -> None:
        """Send status, calibration if it has changed, and pickled replies; a status never follows a newer one."""
        try:
            with self._sending:
                status = self._status()
                if status is not None:
                    self._connection.send(status)
                calibration = self._session.calibration
                if replies and calibration is not self._calibration:
                    self._connection.send(Activated(calibration))
                    self._calibration = calibration
                for reply in replies:
                    self._connection.send_bytes(reply)
        except OSError:  # the client is gone; `serve` notices by itself
            self._ended.set()

    def _status(self) -> Status | None:
        """Return the status; None where it fails, a defect of ours, which is printed once: replies are sent anyway."""
        try:
            status = replace(self._session.status, waiting=self._outstanding.waiting())
        except Exception as error:  # noqa: BLE001 - see above
            if not self._status_fails:
                sys.excepthook(type(error), error, error.__traceback__)
            self._status_fails = True
            return None
        self._status_fails = False
        return status


def run(open_rig: Callable[[str], Rig]) -> None:
    """Run the engine's process: accept the client, serve it, leave nothing behind.

    Parameters
    ----------
    open_rig : callable
        Opens a rig by its name.
    """
    shared.sweep()
    keep_pace()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the client, which then closes the connection
    key = bytes.fromhex(sys.stdin.readline())
    accepted = Event()
    Thread(target=_end_with_the_client, args=(accepted,), name="orphan-watch", daemon=True).start()
    with Listener(authkey=key) as listener:
        sys.stdout.write(f"{listener.address!r}\n")
        sys.stdout.flush()
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # whatever prints from now on must not fill the pipe
        connection = listener.accept()
    accepted.set()
    signal.signal(signal.SIGTERM, lambda *_: connection.close())
    with connection:
        Server(connection, open_rig).serve()


def _end_with_the_client(accepted: Event) -> None:
    """End this process if the client dies before it has connected."""
    sys.stdin.read()
    if not accepted.is_set():
        os._exit(1)


if __name__ == "__main__":
    run(partial(open_live, own_process=True))
