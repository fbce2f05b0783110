"""The engine in a process of its own: ``python -m napari_elsplus.acquisition.link.server``.

A frozen or killed napari then neither loses frames nor leaves the mirror moving. The process is told a key on its
standard input, says on its standard output where it listens, and then takes commands over one connection: the name of a
method of :class:`Server` or of the engine, and its arguments. Ten times a second it says its status, and before each
reply, so that whoever has the reply knows what the command changed. When the connection ends, so does the process, in
order: mirror parked, recording finished, memory given back.
"""

from __future__ import annotations

import os
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection, Listener
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.acquisition.calibrating import procedures
from napari_elsplus.acquisition.calibrating import stepwise as guided
from napari_elsplus.acquisition.calibrating.simulated import calibrate_simulated, open_live
from napari_elsplus.acquisition.calibrating.whole import span_of_the_bundle
from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.live_mosaic import LiveMosaic
from napari_elsplus.acquisition.engine.status import Progress, Status
from napari_elsplus.acquisition.link.messages import QUIT, Command, Reply
from napari_elsplus.acquisition.link.newest import Newest
from napari_elsplus.acquisition.streaming import shared_memory as shared
from napari_elsplus.acquisition.streaming.priority import keep_pace, settle_memory
from napari_elsplus.acquisition.streaming.shared_memory import SharedRing
from napari_elsplus.errors import DeviceError, ElsPlusError, InputError, MeasurementError
from napari_elsplus.hardware.guardian import Guardian

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from types import FrameType

    from napari_elsplus.acquisition.calibrating.procedures import Watch
    from napari_elsplus.acquisition.engine.rig import EngineRig
    from napari_elsplus.acquisition.streaming.ring import Layout, Ring
    from napari_elsplus.processing.calibration.calibrate import SlitOffset

STATUS_PERIOD_S: Final = 0.1
COMMANDS: Final = frozenset(
    {
        "configure", "use", "show", "start", "stop", "hold", "park", "scan", "record", "stop_recording",
        "finish_recording", "fresh_frames", "latencies", "usage",
    }
)  # fmt: skip
"""Methods of the engine that may be called over the connection."""
_THREADS: Final = 4


class Server:
    """Executes commands on an engine until the other side is gone.

    Parameters
    ----------
    connection : Connection
        To the client.
    open_rig : callable
        Opens a rig by its name.
    """

    def __init__(self, connection: Connection, open_rig: Callable[[str], EngineRig]) -> None:
        self._connection, self._open_rig = connection, open_rig
        self._sending = Lock()
        self._ended = Event()
        self._engine: Engine | None = None
        self._mosaic: LiveMosaic | None = None
        self._rig: EngineRig | None = None
        self._guardian: Guardian | None = None
        self._cancelled = Event()
        self._offsets: Newest[SlitOffset | MeasurementError] = Newest()
        self._progress: Progress | None = None

    def serve(self) -> None:
        """Take commands until the connection ends; then close the engine."""
        teller = Thread(target=self._tell, name="status", daemon=True)
        teller.start()
        try:
            with ThreadPoolExecutor(_THREADS, "command") as pool:
                while True:
                    try:
                        command = self._connection.recv()
                    except (EOFError, OSError):
                        break
                    if command.name == QUIT:
                        break
                    pool.submit(self._execute, command)
                self.close()
        finally:
            self._ended.set()
            teller.join()
            self.close()

    def open(self, rig: str) -> None:
        """Open a rig; one that is open is closed first.

        Raises
        ------
        DeviceError
            If it cannot be opened.
        """
        self.close()
        with ExitStack() as held:
            self._rig = opened = self._open_rig(rig)
            held.callback(opened.close)
            self._guardian = None if opened.park is None else Guardian(opened.park)
            held.pop_all()
        self._engine = engine = Engine(opened, make_ring=_shared_ring, guardian=self._guardian)
        self._mosaic = LiveMosaic(engine)
        settle_memory()

    def close(self) -> None:
        """Close the rig."""
        engine, self._engine = self._engine, None
        mosaic, self._mosaic = self._mosaic, None
        guardian, self._guardian = self._guardian, None
        self._cancelled.set()
        if engine is not None:
            engine.close()
        if mosaic is not None:
            mosaic.clear()
        if guardian is not None:
            guardian.dismiss()

    def cancel(self) -> None:
        """Give up the procedure that runs."""
        self._cancelled.set()

    def _execute(self, command: Command) -> None:
        try:
            reply = Reply(command.number, self._method(command.name)(*command.arguments))
        except (ElsPlusError, OSError) as error:
            reply = Reply(command.number, error=error)
        except Exception as error:  # noqa: BLE001 a defect of ours: the other side shall hear of it, not wait for ever
            sys.excepthook(type(error), error, error.__traceback__)
            reply = Reply(command.number, error=RuntimeError(f"{type(error).__name__} in {command.name}: {error}"))
        self._send(self._status, lambda: reply)

    def _method(self, name: str) -> Callable[..., Any]:
        own: dict[str, Callable[..., Any]] = {
            "open": self.open,
            "close": self.close,
            "cancel": self.cancel,
            "newest_offset": self._offsets.after,
        }
        if name in own:
            return own[name]
        engine, rig, mosaic = self._engine, self._rig, self._mosaic
        if engine is None or rig is None or mosaic is None:
            raise DeviceError("no rig is open", "connect to a rig first")
        steps: dict[str, Callable[..., Any]] = {
            "measure_offset": partial(procedures.offset, engine),
            "follow_offset": partial(
                procedures.follow_offset, engine, tell=self._offsets.put, go_on=lambda: not self._cancelled.is_set()
            ),
            "map_galvo": partial(
                procedures.sweep, engine, watch=self._watch("sweep"), watch_fit=self._watch("fit of the lines")
            ),
            "locate_pair": partial(procedures.bundle, engine),
            "measure_background": partial(procedures.background, engine),
            "setup": partial(guided.setup, engine),
            "prepare": partial(guided.prepare, rig),
            "find_span": partial(span_of_the_bundle, engine, self._watch("search for the bundle")),
            "lit_pair": partial(guided.lit_pair, engine),
            "lag_by": partial(guided.lag_by, engine, watch=self._watch("scan lag")),
            "background_by": partial(guided.background_by, engine),
            "flat_by": partial(guided.flat_by, engine),
            "calibrate_simulated": partial(calibrate_simulated, rig, engine, watch=self._watch),
        }
        if name in steps:
            return partial(self._go_through, name, steps[name])
        of_mosaic: dict[str, Callable[..., Any]] = {
            "track": mosaic.track,
            "undo_segment": mosaic.undo,
            "clear_mosaic": mosaic.clear,
        }
        if name in of_mosaic:
            return of_mosaic[name]
        if name not in COMMANDS:
            raise ValueError(f"there is no command {name!r}")
        method: Callable[..., Any] = getattr(engine, name)
        return method

    def _go_through(self, name: str, step: Callable[..., Any], *arguments: Any) -> Any:
        self._cancelled.clear()
        self._progress = Progress(name.replace("_", " "), 0, 1)
        try:
            return step(*arguments)
        finally:
            self._progress = None

    def _watch(self, step: str) -> Watch:
        """Make what tells the progress of a step, and ends it when it was cancelled."""

        def counted(numbers: Iterable[int]) -> Iterator[int]:
            every = list(numbers)
            for done, number in enumerate(every):
                if self._cancelled.is_set():
                    raise InputError(f"the {step} was cancelled", "start it again when you like")
                self._progress = Progress(step, done, len(every))
                yield number

        return counted

    def _tell(self) -> None:
        while not self._ended.wait(STATUS_PERIOD_S):
            self._send(self._status)

    def _status(self) -> Status:
        engine, mosaic = self._engine, self._mosaic
        status = Status() if engine is None else engine.status()
        return replace(status, progress=self._progress, track=None if mosaic is None else mosaic.state)

    def _send(self, *making: Callable[[], object]) -> None:
        """Send messages that are made while no other may be sent: an older status never comes after a newer one."""
        try:
            with self._sending:
                for make in making:
                    self._connection.send(make())
        except OSError:  # the other side is gone; `serve` notices by itself
            self._ended.set()


def _shared_ring(layout: Layout) -> tuple[str, Ring]:
    ring = SharedRing.create(layout)
    return ring.name, ring


def run(open_rig: Callable[[str], EngineRig]) -> None:
    """Be the engine's process: meet the client, serve it, leave nothing behind.

    Parameters
    ----------
    open_rig : callable
        Opens a rig by its name.
    """
    shared.sweep()
    keep_pace()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the client, who then hangs up
    key = bytes.fromhex(sys.stdin.readline())
    met = Event()
    Thread(target=_leave_with_the_client, args=(met,), name="orphan-watch", daemon=True).start()
    with Listener(authkey=key) as listener:
        sys.stdout.write(f"{listener.address!r}\n")
        sys.stdout.flush()
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # whatever prints from now on must not fill the pipe
        connection = listener.accept()
    met.set()

    def hang_up(_signal: int, _frame: FrameType | None) -> None:
        connection.close()

    signal.signal(signal.SIGTERM, hang_up)
    with connection:
        Server(connection, open_rig).serve()


def _leave_with_the_client(met: Event) -> None:
    """End this process if the client dies before it has come."""
    sys.stdin.read()
    if not met.is_set():
        os._exit(1)


if __name__ == "__main__":
    run(partial(open_live, own_process=True))
