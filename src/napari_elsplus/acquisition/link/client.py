"""Command an engine that runs in a process of its own, and look at what it shows."""

from __future__ import annotations

import ast
import secrets
import signal
import subprocess
import sys
from concurrent.futures import Future
from contextlib import suppress
from itertools import count
from multiprocessing.connection import Client, Connection
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any, Final, Self

from napari_elsplus.acquisition.engine.status import Status
from napari_elsplus.acquisition.link.messages import QUIT, Command, Reply
from napari_elsplus.acquisition.streaming.shared_memory import SharedRing
from napari_elsplus.errors import DeviceError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.acquisition.calibrating.whole import Target
    from napari_elsplus.acquisition.engine.live_images import LiveView
    from napari_elsplus.acquisition.engine.status import Settings
    from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
    from napari_elsplus.acquisition.streaming.tally import Latencies
    from napari_elsplus.acquisition.streaming.usage import Usage
    from napari_elsplus.errors import MeasurementError
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.calibrate import Background, BundlePair, Findings, SlitOffset
    from napari_elsplus.processing.calibration.draft import Flat, LitPair, Setup
    from napari_elsplus.processing.calibration.galvo import GalvoMap
    from napari_elsplus.processing.calibration.lag import ScanLag
    from napari_elsplus.workflows.mosaic_plan import MosaicPlan

ENGINE: Final = (sys.executable, "-m", "napari_elsplus.acquisition.link.server")
_PATIENCE_S: Final = 30.0
"""How long the engine may take to finish a recording before it is killed."""


class EngineClient:
    """Starts the engine's process and speaks to it; its methods are those of the engine.

    A context manager: leaving it ends the process in order. Commands return futures, so that a window need not wait;
    ``.result()`` waits and raises what the engine raised.

    Parameters
    ----------
    command : sequence of str
        Starts the process.

    Raises
    ------
    DeviceError
        If the process does not start.
    """

    def __init__(self, command: Sequence[str] = ENGINE) -> None:
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        self._connection = self._meet()
        self._numbers = count()
        self._waiting: dict[int, Future[Any]] = {}
        self._lock = Lock()
        self._status = Status()
        self._calibration: Calibration | None = None
        self._died: DeviceError | None = None
        self._closing = False
        self._ring: SharedRing | None = None
        self._reader = Thread(target=self._listen, name="engine-client", daemon=True)
        self._reader.start()

    # commands

    def open(self, rig: str) -> Future[None]:
        """Open a rig by its name."""
        return self._ask("open", rig)

    def configure(self, settings: Settings) -> Future[None]:
        """Set up camera and timing."""
        return self._ask("configure", settings)

    def use(self, calibration: Calibration | None) -> Future[None]:
        """Take a calibration into force."""
        asked = self._ask("use", calibration)
        asked.add_done_callback(lambda done: self._keep(done, lambda _: calibration))
        return asked

    def show(self, view: LiveView) -> Future[None]:
        """Choose how live images are made."""
        return self._ask("show", view)

    def start(self) -> Future[None]:
        """Scan and stream."""
        return self._ask("start")

    def stop(self) -> Future[None]:
        """Park the mirror and end the stream."""
        return self._ask("stop")

    def hold(self, volts: float) -> Future[None]:
        """Let the line stand."""
        return self._ask("hold", volts)

    def park(self) -> Future[None]:
        """Take the line off the bundle."""
        return self._ask("park")

    def scan(self) -> Future[None]:
        """Scan as the calibration says."""
        return self._ask("scan")

    def record(self, plan: RecordingPlan) -> Future[None]:
        """Record raw frames."""
        return self._ask("record", plan)

    def track(self, plan: MosaicPlan | None) -> Future[None]:
        """Lay every frame into a mosaic from now on, a new one; None lets the one there is rest."""
        return self._ask("track", plan)

    def undo_segment(self) -> Future[bool]:
        """Forget the mosaic's last segment; whether there was one."""
        return self._ask("undo_segment")

    def clear_mosaic(self) -> Future[None]:
        """End tracking, and forget track and mosaic."""
        return self._ask("clear_mosaic")

    def stop_recording(self) -> Future[None]:
        """Finish the recording."""
        return self._ask("stop_recording")

    def measure_offset(
        self, volts: float, background: NDArray[np.float32] | None = None, pair: BundlePair | None = None
    ) -> Future[SlitOffset]:
        """Measure the slit offset, the line held at a voltage."""
        return self._ask("measure_offset", volts, background, pair)

    def follow_offset(self, volts: float, background: NDArray[np.float32] | None = None) -> Future[None]:
        """Measure the slit offset in frame after frame, the line held at a voltage, until :meth:`cancel`."""
        return self._ask("follow_offset", volts, background)

    def newest_offset(self, number: int) -> Future[tuple[int, SlitOffset | MeasurementError] | None]:
        """Wait shortly for what :meth:`follow_offset` found after that number; None if nothing came."""
        return self._ask("newest_offset", number)

    def map_galvo(
        self,
        volts: NDArray[np.floating],
        background: NDArray[np.float32] | None = None,
        pair: BundlePair | None = None,
    ) -> Future[GalvoMap]:
        """Sweep the line over voltages, and fit the galvo's map."""
        return self._ask("map_galvo", volts, background, pair)

    def locate_pair(self) -> Future[BundlePair]:
        """Locate the pair of bundle images, lit from the far end."""
        return self._ask("locate_pair")

    def measure_background(self) -> Future[Background]:
        """Take the background in the dark tube."""
        return self._ask("measure_background")

    def calibrate_simulated(self) -> Future[tuple[Findings, ScanLag]]:
        """Let the simulated rig calibrate itself."""
        asked = self._ask("calibrate_simulated")
        asked.add_done_callback(lambda done: self._keep(done, lambda found: found[0].calibration))
        return asked

    def setup(self) -> Future[Setup]:
        """Say what frames are taken with now."""
        return self._ask("setup")

    def prepare(self, target: Target | None) -> Future[bool]:
        """Put a target before the simulated rig's probe; False for a real one, whose user has to."""
        return self._ask("prepare", target)

    def find_span(self) -> Future[tuple[float, float]]:
        """Find the voltages between which the line stands on the bundle."""
        return self._ask("find_span")

    def lit_pair(self) -> Future[LitPair]:
        """Locate the pair of bundle images, and return the frame in which they were found."""
        return self._ask("lit_pair")

    def lag_by(self, calibration: Calibration) -> Future[ScanLag]:
        """Measure the scan's lag by a calibration, which is taken into force."""
        return self._ask("lag_by", calibration)

    def background_by(self, calibration: Calibration) -> Future[Background]:
        """Take the background, scanning by a calibration, which is taken into force."""
        return self._ask("background_by", calibration)

    def flat_by(self, calibration: Calibration) -> Future[Flat]:
        """Take a flat field, scanning by a calibration, which is taken into force."""
        return self._ask("flat_by", calibration)

    def cancel(self) -> Future[None]:
        """Give up the procedure that runs."""
        return self._ask("cancel")

    def latencies(self) -> Future[Latencies]:
        """Say how many frames of this run had which latency."""
        return self._ask("latencies")

    def usage(self) -> Future[Usage]:
        """Say what the engine's process has used."""
        return self._ask("usage")

    # looking

    @property
    def pid(self) -> int:
        """Of the engine's process."""
        return self._process.pid

    @property
    def calibration(self) -> Calibration | None:
        """The calibration in force, as far as this client has put it there."""
        return self._calibration

    @property
    def died(self) -> DeviceError | None:
        """What happened, if the engine's process ended without being told to."""
        return self._died

    @property
    def status(self) -> Status:
        """What the engine said last."""
        return self._status

    def display(self) -> SharedRing | None:
        """Return the ring in which images are shown; to be used by one thread, until the next call."""
        shown = self._status.display
        if shown is None or self._died is not None:
            return None
        name, layout = shown
        if self._ring is None or self._ring.name != name:
            self._let_go()
            try:
                self._ring = SharedRing.attach(name, layout)
            except FileNotFoundError:  # replaced a moment ago; the next status says by what
                return None
        return self._ring

    def close(self) -> None:
        """End the engine: recording finished, mirror parked, nothing left."""
        if self._closing:
            return
        self._closing = True
        self._let_go()
        self._ask(QUIT)
        try:
            self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self._process.communicate()
        self._reader.join()
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # inside

    def _meet(self) -> Connection:
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

    def _ask(self, name: str, *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        with self._lock:
            if self._died is not None:
                future.set_exception(self._died)
                return future
            number = next(self._numbers)
            self._waiting[number] = future
            with suppress(OSError):  # the reader notices, too, and answers every future
                self._connection.send(Command(number, name, arguments))
        return future

    def _keep(self, done: Future[Any], calibration_of: Callable[[Any], Calibration | None]) -> None:
        if done.exception() is None:
            self._calibration = calibration_of(done.result())

    def _listen(self) -> None:
        while True:
            try:
                message = self._connection.recv()
            except (EOFError, OSError):
                break
            if isinstance(message, Status):
                self._status = message
            elif isinstance(message, Reply):
                self._answer(message)
        self._say_that_it_ended()

    def _answer(self, reply: Reply) -> None:
        with self._lock:
            future = self._waiting.pop(reply.number)
        if reply.error is not None:
            future.set_exception(reply.error)
        else:
            future.set_result(reply.result)

    def _say_that_it_ended(self) -> None:
        error = DeviceError("the engine was closed", "connect again")
        if not self._closing:
            code = self._process.wait()
            how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
            error = DeviceError(
                f"the engine's process ended ({how})",
                "the mirror was parked and what was recorded is kept: connect again",
            )
        with self._lock:
            self._died = error
            waiting, self._waiting = self._waiting, {}
        for future in waiting.values():
            future.set_exception(error)

    def _let_go(self) -> None:
        ring, self._ring = self._ring, None
        if ring is not None:
            ring.close()
