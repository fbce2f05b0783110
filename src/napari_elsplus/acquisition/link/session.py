"""The rig that the engine's process has open: its engine, its mosaic, and the procedure that runs."""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import replace
from math import inf
from threading import Condition, Lock
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import ProcedureProgress, Status
from napari_elsplus.acquisition.link.supervision import Supervision
from napari_elsplus.acquisition.mosaic.board import MosaicBoard
from napari_elsplus.acquisition.mosaic.tracking import LiveTrack, TrackState
from napari_elsplus.acquisition.streaming.shared_memory import SharedRing
from napari_elsplus.errors import CalibrationError, CancelledError, DeviceError, MeasurementError
from napari_elsplus.hardware.parking import ParkState
from napari_elsplus.hardware.priority import settle_memory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from napari_elsplus.hardware.protocols import Scanner
    from napari_elsplus.hardware.rig import Rig
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.slit_offset import SlitOffset
    from napari_elsplus.workflows.mosaic_plan import MosaicPlan

T = TypeVar("T")


class LiveMosaic:
    """At most one track of an engine, on a board in shared memory.

    Parameters
    ----------
    engine : Engine
        Source of the frames.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._lock = Lock()
        self._track: LiveTrack | None = None

    @property
    def state(self) -> TrackState | None:
        """The track at this moment; None while there is none."""
        track = self._track
        return None if track is None else replace(track.state, running=self._engine.tracking)

    def track(self, plan: MosaicPlan | None) -> None:
        """Begin a new mosaic by a plan; None ends tracking, all loops closed, and keeps the mosaic.

        Raises
        ------
        CalibrationError
            If the bundle was not located.
        InputError
            If the images cannot be made live.
        DeviceError
            If there is no shared memory left.
        """
        with self._lock:
            if plan is None:
                self._engine.track(None)
                if self._track is not None:
                    self._track.settle()
                return
            calibration = self._engine.calibration
            if calibration is None:
                raise CalibrationError("there is no calibration to track by", "calibrate, or load a calibration")
            board = MosaicBoard()
            try:
                track = LiveTrack(calibration, self._engine.setup.frame_shape, plan, board)
            except BaseException:
                board.close()
                raise
            self._engine.track(track)
            before, self._track = self._track, track
            if before is not None:
                before.close()

    def undo(self) -> bool:
        """Remove the last segment; return True if there was one."""
        track = self._track
        return track is not None and track.undo()

    def clear(self) -> None:
        """End tracking, and release its memory."""
        with self._lock:
            self._engine.track(None)
            track, self._track = self._track, None
            if track is not None:
                track.close()


class Newest(Generic[T]):
    """Holds the newest value for readers that wait for one; older ones are lost.

    Examples
    --------
    >>> newest = Newest()
    >>> newest.put("first"); newest.put("second")
    >>> newest.after(0), newest.after(2, timeout_s=0.01)
    ((2, 'second'), None)
    """

    def __init__(self) -> None:
        self._come = Condition()
        self._number = 0
        self._value: T | None = None

    def put(self, value: T) -> None:
        """Replace the value."""
        with self._come:
            self._value = value
            self._number += 1
            self._come.notify_all()

    def after(self, number: int, timeout_s: float = 0.5) -> tuple[int, T] | None:
        """Wait for a value after a number; return it with its own number, None if none comes within the timeout."""
        with self._come:
            if not self._come.wait_for(lambda: self._number > number, timeout_s) or self._value is None:
                return None
            return self._number, self._value


class _Opened(NamedTuple):
    rig: Rig
    engine: Engine
    mosaic: LiveMosaic


class Session:
    """At most one open rig; commands are executed on it.

    Parameters
    ----------
    open_rig : callable
        Opens a rig by its name.

    Attributes
    ----------
    supervision : Supervision
        Parks the galvo when the client is frozen.
    offsets : Newest
        Results of the procedure that follows the slit offset.
    """

    def __init__(self, open_rig: Callable[[str], Rig]) -> None:
        self._open_rig = open_rig
        self._opening = Lock()
        self._opened: _Opened | None = None
        self._cancelled_s = self._given_s = -inf
        self._progress: ProcedureProgress | None = None
        self._compiling = ""
        self._scanner: Scanner | None = None  # of the rig that was opened last: its state counts also while it closes
        self.supervision = Supervision(self._secure)
        self.offsets: Newest[SlitOffset | MeasurementError] = Newest()

    def open(self, rig: str) -> None:
        """Open a rig; one that is open is closed first.

        Raises
        ------
        DeviceError
            If it cannot be opened.
        """
        with self._opening:
            self.close()
            opened = self._open_rig(rig)
            try:
                engine = Engine(opened, make_ring=SharedRing.create)
            except BaseException:
                opened.close()
                raise
            self._opened, self._scanner = _Opened(opened, engine, LiveMosaic(engine)), opened.scanner
        settle_memory()

    def close(self) -> None:
        """Close the rig."""
        opened, self._opened = self._opened, None
        self.cancel()
        if opened is not None:
            try:
                opened.engine.close()
            finally:
                opened.mosaic.clear()

    @property
    def rig(self) -> Rig:
        """The open rig; as `engine` and `mosaic` a DeviceError where there is none."""
        return self._require().rig

    @property
    def engine(self) -> Engine:
        """The engine of the open rig."""
        return self._require().engine

    @property
    def mosaic(self) -> LiveMosaic:
        """The live mosaic of the open rig."""
        return self._require().mosaic

    @property
    def calibration(self) -> Calibration | None:
        """The active calibration; None without a rig."""
        return None if self._opened is None else self._opened.engine.calibration

    @property
    def status(self) -> Status:
        """Return the status of the engine, the mosaic and the procedure; of a rig that was closed its galvo's."""
        if self._opened is None:
            parking = ParkState() if self._scanner is None else self._scanner.park_state
            return Status(progress=self._progress, compiling=self._compiling, park_state=parking)
        _, engine, mosaic = self._opened
        return replace(engine.status(), progress=self._progress, compiling=self._compiling, track=mosaic.state)

    # procedures

    @property
    def cancelled(self) -> bool:
        """True if the procedure that runs was cancelled."""
        return self._cancelled_s > self._given_s

    def cancel(self) -> None:
        """Cancel the procedure that runs, and those that were commanded before."""
        self._cancelled_s = time.perf_counter()

    def _secure(self, fault: DeviceError) -> None:
        """Park and end a recording for a fault."""
        opened = self._opened
        if opened is not None:
            opened.engine.secure(fault)

    @contextmanager
    def procedure(self, name: str, given_s: float, *, activates: bool) -> Iterator[None]:
        """Run a procedure alone, with its progress in the status.

        Parameters
        ----------
        name : str
            For messages.
        given_s : float
            When it was commanded, by ``time.perf_counter``.
        activates : bool
            The calibration that it activated stays active; else, and if it fails, that of before is restored.
        """
        engine, before = self.engine, self.engine.calibration
        with engine.operations.alone(name, long=True, given_s=given_s):
            self._given_s = given_s
            self._progress = ProcedureProgress("preparing", 0, 0)
            done = False
            try:
                yield
                done = activates
            finally:
                self._progress = None
                if not done and engine.calibration is not before and self._opened is not None:
                    engine.use(before, scan=False)

    def report_progress(self, step: str, done: float, total: float) -> None:
        """Put a step and its progress in whole seconds, `done` of `total`, into the status."""
        self._progress = ProcedureProgress(step, int(done), max(round(total), 1))

    def report_compilation(self, kernel: str) -> None:
        """Put the name of a `kernel` that is being compiled into the status; an empty one at its end."""
        self._compiling = kernel

    def watch(self, numbers: Iterable[int], step: str) -> Iterator[int]:
        """Yield the numbers of a step's parts: count them in the status, and end when cancelled."""
        every = list(numbers)
        for done, number in enumerate(every):
            if self.cancelled:
                raise CancelledError(f"the {step} was cancelled", "start it again when you like")
            self._progress = ProcedureProgress(step, done, len(every))
            yield number

    def _require(self) -> _Opened:
        if self._opened is None:
            raise DeviceError("no rig is open", "connect to a rig first")
        return self._opened
