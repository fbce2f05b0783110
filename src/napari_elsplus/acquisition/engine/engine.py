"""The live engine: camera and mirror in step, every frame sectioned, recorded if asked, nothing lost unsaid.

The same engine runs inside a script and, for napari, in a process of its own
(:mod:`napari_elsplus.acquisition.link.server`).
"""

from __future__ import annotations

from threading import Event, RLock, Thread
from typing import TYPE_CHECKING, Final, Self

from napari_elsplus.acquisition.engine.camera_setup import CameraSetup
from napari_elsplus.acquisition.engine.display import Display, on_the_heap
from napari_elsplus.acquisition.engine.galvo import GalvoController
from napari_elsplus.acquisition.engine.live_images import LiveView
from napari_elsplus.acquisition.engine.run import Run
from napari_elsplus.acquisition.engine.status import Status
from napari_elsplus.acquisition.streaming.faults import FaultLog
from napari_elsplus.acquisition.streaming.tally import Latencies
from napari_elsplus.acquisition.streaming.usage import Usage, usage
from napari_elsplus.errors import DeviceError, ElsPlusError, InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.acquisition.engine.status import Settings
    from napari_elsplus.acquisition.engine.workers import FrameConsumer
    from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
    from napari_elsplus.acquisition.streaming.ring import Layout, Ring
    from napari_elsplus.hardware.rig import Rig
    from napari_elsplus.instrument.calibration import Calibration

BUFFER_S: Final = 2.0
"""Seconds of raw frames that stay in memory."""
_WATCH_PERIOD_S: Final = 0.05
_FRAME_TIMEOUT_S: Final = 2.0


class Engine:
    """Runs a rig. A context manager: leaving it ends recordings, parks the mirror and closes the rig.

    Every method may be called from any thread; one command is executed at a time.

    Parameters
    ----------
    rig : Rig
        Open; owned by the engine from now on.
    make_ring : callable
        Makes the ring in which images are shown, and says its name; on the heap by default.
    buffer_s : float
        Seconds of raw frames that stay in memory, for slow disks and for recordings that begin in the past.

    Attributes
    ----------
    setup : CameraSetup
        How the camera runs.
    mirror : GalvoController
        The mirror and its limits; told to move by the engine's methods alone.
    """

    def __init__(
        self,
        rig: Rig,
        *,
        make_ring: Callable[[Layout], tuple[str, Ring]] = on_the_heap,
        buffer_s: float = BUFFER_S,
    ) -> None:
        self._rig, self._buffer_s = rig, buffer_s
        self.setup = CameraSetup(rig)
        self.mirror = GalvoController(rig, self.setup)
        self._display = Display(make_ring)
        self._lock = RLock()
        self._faults = FaultLog()
        self._calibration: Calibration | None = None
        self._view = LiveView()
        self._tracker: FrameConsumer | None = None
        self._run: Run | None = None
        self._live = False
        self._closing = Event()
        self._watcher = Thread(target=self._watch, name="engine-watch", daemon=True)
        self._watcher.start()

    # what is in force

    def configure(self, settings: Settings) -> None:
        """Set up camera and timing; a running stream is stopped, and started again with a ramp that fits.

        Raises
        ------
        InputError
            If the camera cannot do that.
        DeviceError
            If the camera does not answer.
        """
        with self._lock:
            again = self._live
            self._end_run()
            self.setup.configure(settings)
            self._renew_images()
            if again:
                self.start()

    def use(self, calibration: Calibration | None) -> None:
        """Take a calibration into force: images are made, the mirror is driven and parked by it.

        Raises
        ------
        CalibrationError
            If it does not fit the frames; the one before stays in force.
        InputError
            If the ramp or the place to park that it asks for is impossible; the one before stays in force.
        """
        with self._lock:
            before = self._calibration
            try:
                self._take(calibration)
                if self._live:
                    self.mirror.follow(calibration)
            except ElsPlusError:
                self._take(before)
                raise

    def show(self, view: LiveView) -> None:
        """Choose how live images are made.

        Raises
        ------
        CalibrationError
            If the calibration lacks what the view needs; the view before stays.
        """
        with self._lock:
            before, self._view = self._view, view
            try:
                self._renew_images()
            except BaseException:
                self._view = before
                raise

    def track(self, tracker: FrameConsumer | None) -> None:
        """Hand every frame to a tracker, too."""
        with self._lock:
            self._tracker = tracker
            if self._run is not None:
                self._run.processing.tracker = tracker

    @property
    def calibration(self) -> Calibration | None:
        """The active calibration."""
        return self._calibration

    # streaming

    def start(self) -> None:
        """Scan and stream; with a calibration that knows galvo and bundle, else with the mirror at rest.

        Raises
        ------
        DeviceError
            If camera or mirror fail; the mirror is parked then.
        InputError
            If the camera was not configured, or the ramp does not fit.
        """
        with self._lock:
            if self._live:
                return
            self.setup.require()
            self._faults.clear()
            self.finish_recording()
            assert self._display.shown is not None
            self._run = run = Run(
                self.setup.camera,
                self._display.shown,
                self._faults,
                tracker=self._tracker,
                frame_rate_hz=self.setup.frame_rate_hz,
                buffer_s=self._buffer_s,
                settling=self.setup.settling,
            )
            try:
                self.mirror.follow(self._calibration)
                run.start()
            except BaseException:
                self._park()
                run.stop()
                raise
            self._live, self.setup.settling = True, 0

    def stop(self) -> None:
        """Park the mirror and end the stream; a recording is finished in the background."""
        with self._lock:
            self._end_run()

    def hold(self, volts: float) -> None:
        """Let the line stand while frames stream; the rig parks it when that goes on too long."""
        with self._lock:
            self.mirror.hold(volts)

    def park(self) -> None:
        """Take the line off the bundle; frames go on streaming."""
        with self._lock:
            self.mirror.park()

    def scan(self, by: Calibration | None = None) -> None:
        """Scan as a calibration says; as the one in force if none is given.

        Raises
        ------
        CalibrationError
            If galvo or bundle was not measured.
        InputError
            If there is no calibration, or the ramp does not fit.
        """
        with self._lock:
            calibration = by or self._calibration
            if calibration is None:
                raise InputError("there is no calibration to scan by", "calibrate, or load a calibration")
            calibration.require("galvo", "bundle")
            self.mirror.follow(calibration)

    # recording

    def record(self, plan: RecordingPlan) -> None:
        """Record raw frames, the calibration in force beside them.

        Raises
        ------
        InputError
            If nothing streams, another recording runs, or the file may not be written.
        """
        with self._lock:
            if self._run is None or not self._live:
                raise InputError("nothing to record", "start the stream first")
            self._run.record(plan, self._calibration, self.setup.described())

    def stop_recording(self) -> None:
        """Finish the recording with the newest frame; returns when the file is in order."""
        run = self._run
        if run is not None:
            run.stop_recording()

    def finish_recording(self) -> None:
        """After :meth:`stop`: wait until the recording is in order."""
        if self._run is not None and not self._live:
            self._run.finish_recording()

    # looking

    @property
    def display(self) -> Ring | None:
        """The ring in which images are shown."""
        return self._display.shown.ring if self._display.shown is not None else None

    def fresh_frames(self, count: int, after_s: float = 0.0) -> NDArray[np.uint8]:
        """Copy the next frames, (count, rows, cols), whose exposure begins after a moment of ``time.perf_counter``.

        Raises
        ------
        DeviceError
            If nothing streams, or the frames do not come.
        """
        run = self._run
        if run is None or not self._live:
            raise DeviceError("no frames stream", "start the stream first")
        return run.fresh_frames(count, after_s, _FRAME_TIMEOUT_S)

    def status(self) -> Status:
        """Say how it goes."""
        run = self._run
        if run is None:
            return Status(display=self._display.where, faults=self._faults.all())
        tally = run.tally
        return Status(
            live=self._live,
            scanning=self.mirror.scanning,
            acquired=tally.acquired,
            processed=tally.processed,
            recorded=tally.recorded,
            dropped=dict(tally.dropped),
            camera_hz=tally.recent_hz if self._live else 0.0,
            mean_hz=tally.mean_hz,
            latency_ms=tally.latency.summary(),
            measures=run.processing.measures,
            recording=run.recording,
            disk_bytes_per_s=self.setup.bytes_per_s,
            display=self._display.where,
            faults=self._faults.all(),
            stale=self.setup.stale(self._calibration),
        )

    def latencies(self) -> Latencies:
        """Return how many frames of this run had which latency."""
        return Latencies() if self._run is None else self._run.tally.latency.counts()

    def usage(self) -> Usage:
        """Return what the engine's process has used."""
        return usage()

    # the end

    def close(self) -> None:
        """Stop, finish the recording, park, and let the rig go."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._watcher.join()
        with self._lock:
            try:
                self._end_run()
                self.finish_recording()
            finally:
                self._rig.close()
                self._display.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # inside

    def _take(self, calibration: Calibration | None) -> None:
        self._calibration = calibration
        self._renew_images()
        self.mirror.park_by(calibration)

    def _renew_images(self) -> None:
        if not self.setup.configured:
            return
        shown = self._display.renew(self.setup.frame_shape, self._calibration, self._view)
        if self._run is not None:
            self._run.processing.shown = shown

    def _end_run(self) -> None:
        """Park first, so that the light leaves the tissue; then end the stream."""
        if not self._live:
            return
        self._live = False
        self._park()
        assert self._run is not None
        self._run.stop()
        self._display.forget_retired()

    def _park(self) -> None:
        try:
            self.mirror.park()
        except DeviceError as error:
            self._faults.add("scanner", error)

    def _watch(self) -> None:
        """Notice what fails while nobody asks; stop and park then, keep the data."""
        while not self._closing.wait(_WATCH_PERIOD_S):
            with self._lock:
                if not self._live:
                    continue
                try:
                    self.mirror.check()
                except DeviceError as error:
                    self._faults.add("scanner", error)
                    self._end_run()
                    continue
                if self._run is not None and self._run.broken:
                    if not self._faults.all():
                        self._faults.add(
                            "engine", DeviceError("a thread of the engine ended", "start the stream again")
                        )
                    self._end_run()
