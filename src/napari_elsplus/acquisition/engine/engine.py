"""The live engine: camera and galvo in step, every frame sectioned and recorded if required, every loss counted.

It runs inside a script and, for napari, in a process of its own (:mod:`napari_elsplus.acquisition.link.server`).
"""

from __future__ import annotations

from contextlib import ExitStack, contextmanager
from dataclasses import replace
from threading import RLock
from typing import TYPE_CHECKING, Final

from napari_elsplus.acquisition.engine.camera_setup import CameraSetup, SlowBusError
from napari_elsplus.acquisition.engine.display import Display, on_the_heap
from napari_elsplus.acquisition.engine.galvo import GalvoController
from napari_elsplus.acquisition.engine.operations import Operations
from napari_elsplus.acquisition.engine.run import Run
from napari_elsplus.acquisition.engine.status import Status
from napari_elsplus.acquisition.engine.watcher import Watcher
from napari_elsplus.acquisition.streaming.faults import FaultLog
from napari_elsplus.closing import ClosedOnExit
from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.instrument.arguments import require_calibration

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.acquisition.engine.live_images import LiveView
    from napari_elsplus.acquisition.engine.status import Settings
    from napari_elsplus.acquisition.engine.workers import FrameConsumer
    from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
    from napari_elsplus.acquisition.streaming.ring import Layout, Ring
    from napari_elsplus.hardware.rig import Rig
    from napari_elsplus.instrument.calibration import Calibration

BUFFER_S: Final = 2.0
"""Seconds of raw frames that stay in memory; chosen: disks pause for less."""
_FRAME_TIMEOUT_S: Final = 2.0
"""Time in which a procedure's next frame has to come; chosen: hundreds of frame periods."""


class Engine(ClosedOnExit):
    """Runs a rig. A context manager: leaving it ends recordings, parks the galvo and closes the rig.

    Every method may be called from any thread. `configure`, `use`, `start`, `stop`, `hold`, `scan` and the procedures
    of a calibration are executed one at a time, and succeed or leave what was before; `park` waits for none of them.

    Parameters
    ----------
    rig : Rig
        Open; owned by the engine from now on.
    make_ring : callable
        Makes the display's ring of a layout; on the heap by default.
    buffer_s : float
        Seconds of raw frames that stay in memory, for slow disks and for recordings that begin in the past.

    Attributes
    ----------
    setup : CameraSetup
        Settings of the camera.
    galvo : GalvoController
        The galvo and its limits; moved by the engine's methods alone.
    operations : Operations
        The exclusive operation that runs.
    """

    def __init__(
        self,
        rig: Rig,
        *,
        make_ring: Callable[[Layout], Ring] = on_the_heap,
        buffer_s: float = BUFFER_S,
    ) -> None:
        self._rig, self._buffer_s = rig, buffer_s
        self._run: Run | None = None
        self.operations = Operations()
        self.setup = CameraSetup(rig)
        self._display = Display(self.setup, make_ring)
        self._faults = FaultLog()
        self.galvo = GalvoController(rig, self.setup, self.operations, self._faults)
        self._lock = RLock()
        self._tracker: FrameConsumer | None = None
        self._live = self._closed = False
        self._watcher = Watcher(self._check, self._fail)

    def configure(self, settings: Settings) -> None:
        """Configure camera and timing by settings; a running stream starts again, and scans if it scanned before.

        Raises
        ------
        InputError
            If the camera cannot do that, the ramp does not fit, or a recording or another operation runs.
        CalibrationError
            If the stream runs, and the calibration does not fit the new frames.
        DeviceError
            If the camera does not answer. As in all cases, what was before is restored, or the engine unconfigured.
        """
        with self._changing("the camera's configuration"):
            self.refuse_while_recording()
            before = self.setup.settings if self.setup.configured else None
            live, scan = self._live, self.galvo.scanning
            self._end_run()
            try:
                self._configure(settings, live, scan)
            except BaseException:
                self._restore(before, live, scan)
                raise

    def use(self, calibration: Calibration | None, *, scan: bool = True) -> None:
        """Activate a calibration: images are made, and the galvo is driven and parked by it.

        Parameters
        ----------
        calibration : Calibration or None
            None: raw frames only, the galvo parked where the rig parks.
        scan : bool
            Scan by it if frames stream.

        Raises
        ------
        CalibrationError
            If it does not fit the frames; the one before stays active, as in all cases.
        InputError
            If it is none, its ramp or parking position is impossible, or a recording or another operation runs.
        """
        if calibration is not None:
            require_calibration(calibration)
        with self._changing("the activation of a calibration"):
            self.refuse_while_recording()
            before = self.calibration
            try:
                self._activate(calibration)
                if self._live and scan:
                    self.galvo.follow(self.galvo.waveform(calibration), calibration)
            except BaseException:
                self._activate(before, restoring=True)
                raise

    def show(self, view: LiveView | None) -> None:
        """Make live images for a view, none for None; a calibration that lacks what it needs is a CalibrationError."""
        with self._lock:
            self._display.show(view)

    def track(self, tracker: FrameConsumer | None) -> None:
        """Pass every frame to a tracker, too."""
        with self._lock:
            self._tracker = tracker
            if self._run is not None:
                self._run.processing.tracker = tracker

    @property
    def tracking(self) -> bool:
        """True while frames that stream are passed to a tracker; one that has failed receives none any more."""
        return self._tracker is not None and (self._run is None or self._run.processing.tracker is self._tracker)

    @property
    def calibration(self) -> Calibration | None:
        """The active calibration."""
        return self._display.calibration

    def start(self, *, scan: bool = True) -> None:
        """Scan and stream; at the default rate as fast as the bus carries, which the first start measures.

        Parameters
        ----------
        scan : bool
            Scan if the calibration has galvo and bundle; else the galvo stays parked.

        Raises
        ------
        DeviceError
            If camera or card fail; the galvo is parked.
        InputError, CalibrationError
            If the camera is unconfigured, ramp or calibration do not fit the frames, or another operation runs.
        """
        with self._changing("the start"):
            if self._live:
                return
            self.setup.require()
            try:
                self._start(scan)
            except SlowBusError:
                self._configure(self.setup.settings)
                self._start(scan)

    def stop(self) -> None:
        """Park the galvo and end the stream; a recording is finished in the background."""
        with self._changing("the stop"):
            self._end_run()

    def hold(self, volts: float) -> None:
        """Hold the line still at some volts while frames stream; the rig parks it after its time limit."""
        with self._changing("the hold"):
            self.galvo.hold(volts)

    def park(self) -> None:
        """Move the line off the bundle at once, whatever else goes on; frames go on streaming.

        An operation that runs in another thread, or waits to, ends: it does not move the galvo again.
        """
        self.operations.interrupt("the galvo was parked")
        self.galvo.park()

    def secure(self, error: DeviceError) -> None:
        """Park and end a recording, if there is anything to, because of an error found elsewhere. Waits for no lock."""
        idle = self.operations.running is None and not (self._run is not None and self._run.recorded)
        self.operations.interrupt(error.problem)
        if idle and self.galvo.park_state.parked:
            return
        self._faults.add("engine", error)
        self.galvo.try_to_park()
        if self._run is not None:
            self._run.end_recording()

    def scan(self, by: Calibration | None = None) -> None:
        """Scan by a calibration with galvo and bundle; by the active one if none is given.

        Raises
        ------
        InputError, CalibrationError
            If there is none, a section was not measured, or the ramp does not fit.
        """
        with self._changing("the scan"):
            calibration = by or self.calibration
            if calibration is None:
                raise InputError("there is no calibration to scan by", "calibrate, or load a calibration")
            calibration.require("galvo", "bundle")
            self.galvo.follow(self.galvo.waveform(calibration), calibration)

    def record(self, plan: RecordingPlan) -> None:
        """Record raw frames by a plan, the active calibration beside them.

        Raises
        ------
        InputError
            If nothing streams, another recording runs, or the file may not be written.
        DeviceError
            If a fault has ended the stream.
        """
        with self._lock:
            if self._run is None or not self._live:
                if self._run is not None:
                    self._run.raise_ending_fault()
                raise InputError("nothing to record", "start the stream first")
            self._run.record(plan, self.calibration, self.setup.described())

    def refuse_while_recording(self) -> None:
        """Raise an InputError while frames are recorded: what would change them has to wait."""
        if self._run is not None and self._live and self._run.recorded:
            raise InputError(f"{self._run.recorded} is being recorded", "end the recording first")

    def stop_recording(self) -> None:
        """Finish the recording with the newest frame; returns when the file is complete."""
        if self._run is not None:
            self._run.stop_recording()

    def finish_recording(self) -> None:
        """Wait after :meth:`stop` until the recording is complete."""
        if self._run is not None and not self._live:
            self._run.finish_recording()

    def _scanned_by(self) -> Calibration | None:
        """Return the active calibration if the line scans by it; None during trials."""
        by = self.galvo.scanned_by
        return by if by is self.calibration else None

    @property
    def display(self) -> Ring | None:
        """The ring of the newest images."""
        sink = self._display.sink
        return None if sink is None else sink.ring

    def fresh_frames(self, count: int, after_s: float = 0.0) -> NDArray[np.uint8]:
        """Copy a count of frames, (count, rows, cols), whose exposure begins after a time of ``time.perf_counter``.

        Raises
        ------
        DeviceError, InputError
            If nothing streams, or the frames do not come; if the operation was interrupted.
        """
        self.operations.check()
        run = self._run
        if run is None or not self._live:
            if run is not None:
                run.raise_ending_fault()
            raise DeviceError("no frames stream", "start the stream first")
        return run.fresh_frames(count, after_s, _FRAME_TIMEOUT_S, self.operations.check)

    def status(self) -> Status:
        """Return counts, faults and what is in operation."""
        status = Status() if self._run is None else self._run.status(live=self._live)
        ring = self.display
        return replace(
            status,
            configured=self.setup.configured,
            notice=self.setup.notice,
            live=self._live,
            scanning=self.galvo.scanning,
            park_state=self.galvo.park_state,
            disk_bytes_per_s=self.setup.bytes_per_s,
            display=None if ring is None else (ring.name, ring.layout),
            faults=self._faults.all(),
            stale={} if self._run is None else self.setup.stale(self.calibration),
        )

    def close(self) -> None:
        """Stop, finish the recording, park, and close the rig; an operation that runs ends."""
        if self._closed:
            return
        self._closed = True
        self.operations.interrupt("the engine was closed")
        with ExitStack() as held:  # last in, first out, whatever fails
            held.callback(self._release)
            held.callback(self._watcher.stop)
            self.galvo.try_to_park()  # before whatever holds the lock, or the watch up

    def _release(self) -> None:
        with self._lock, ExitStack() as held:
            for release in (self._display.close, self.galvo.close, self._rig.close):
                held.callback(release)
            self._end_run()
            self.finish_recording()

    @contextmanager
    def _changing(self, name: str) -> Iterator[None]:
        with self.operations.alone(name), self._lock:
            yield

    def _start(self, scan: bool) -> None:
        if scan:
            self._display.require_fit()
        waveform = self.galvo.waveform(self.calibration) if scan else None
        self._faults.clear()
        self.finish_recording()
        display = self._display
        run = Run(self.setup, display, self._faults, self._scanned_by, tracker=self._tracker, buffer_s=self._buffer_s)
        try:
            self.galvo.watch_frames(lambda: run.received)
            self.galvo.follow(waveform, self.calibration)
            run.start()
        except BaseException:
            self.galvo.try_to_park()
            run.stop()
            raise
        self._run, self._live, self.setup.settling = run, True, 0

    def _configure(self, settings: Settings, live: bool = False, scan: bool = False) -> None:
        self.setup.configure(settings)
        self._display.renew(raw_if_misfit=True)
        if live:
            self.start(scan=scan)

    def _restore(self, settings: Settings | None, live: bool, scan: bool) -> None:
        try:
            if settings is None:
                self.setup.configured = False
            else:
                self._configure(settings, live, scan)
        except Exception as error:  # noqa: BLE001 - what is being raised already is the cause
            self._faults.add("camera", error)
            self.setup.configured = False

    def _activate(self, calibration: Calibration | None, *, restoring: bool = False) -> None:
        self._display.activate(calibration, restoring=restoring)
        try:
            self.galvo.park_by(calibration)
        except DeviceError as error:
            if not restoring:
                raise
            self._faults.add("scanner", error)

    def _end_run(self) -> None:
        """Park first, so that the light leaves the tissue; then end the stream, or what is left of it."""
        if self._run is None or self._run.stopped:
            return
        self._live = False
        self.galvo.try_to_park()
        self.galvo.watch_frames(None)
        self._run.stop()
        self._display.close_retired()

    def _check(self) -> None:
        """Raise what has failed in a stream that should run."""
        with self._lock:
            if not self._live:
                return
            self.galvo.check()
            if self._run is not None and self._run.broken:
                raise DeviceError("a thread of the engine ended", "start the stream again")

    def _fail(self, error: BaseException) -> None:
        """Stop and park after a failure; the data are kept."""
        with self._lock, ExitStack() as held:
            held.callback(self._end_run)
            broken = self._run is not None and self._run.broken
            if not (broken and self._faults.all() and isinstance(error, DeviceError)):  # else the cause is there
                self._faults.add("engine" if broken else "scanner", error)
