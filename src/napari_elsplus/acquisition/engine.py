"""The live engine: camera and mirror in step, every frame sectioned, recorded if asked, nothing lost unsaid.

The same engine runs inside a script and, for napari, in a process of its own
(:mod:`napari_elsplus.acquisition.process`).
"""

from __future__ import annotations

from threading import Event, RLock, Thread
from typing import TYPE_CHECKING, Any, Final, Protocol, Self

from napari_elsplus.acquisition.faults import FaultLog
from napari_elsplus.acquisition.live_images import LiveImages, View
from napari_elsplus.acquisition.ring import Ring
from napari_elsplus.acquisition.run import Run
from napari_elsplus.acquisition.status import Settings, Status
from napari_elsplus.acquisition.workers import FrameConsumer, Shown
from napari_elsplus.calibration import AcquiredWith, FrameSection
from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.protocols import Camera, Region, Scanner
from napari_elsplus.hardware.waveform import MirrorLimits, ScanTiming, StrobePhase, els_waveform
from napari_elsplus.optics import preset

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.acquisition.recorder import RecordingPlan
    from napari_elsplus.acquisition.ring import Layout
    from napari_elsplus.calibration import Calibration
    from napari_elsplus.hardware.parking import ParkOrder
    from napari_elsplus.hardware.rigs import VirtualBench

BUFFER_S: Final = 2.0
"""Seconds of raw frames that stay in memory."""
SETTLING_FRAMES: Final = 2
"""Frames that are invalid after the camera was given another region or exposure."""
_WATCH_PERIOD_S: Final = 0.05
_FRAME_TIMEOUT_S: Final = 2.0


class Rig(Protocol):
    """What the engine asks of a rig."""

    @property
    def name(self) -> str:
        """Name by which the rig is chosen."""

    @property
    def camera(self) -> Camera:
        """The camera."""

    @property
    def scanner(self) -> Scanner:
        """The mirror."""

    @property
    def limits(self) -> MirrorLimits:
        """What the mirror may be asked for."""

    @property
    def strobe(self) -> StrobePhase:
        """What the camera's strobe marks."""

    @property
    def park(self) -> ParkOrder | None:
        """What has to be done if this process dies; None if nothing moves."""

    @property
    def bench(self) -> VirtualBench | None:
        """What is behind a simulated rig; None for a real one."""

    def close(self) -> None:
        """Park and let everything go."""


def on_the_heap(layout: Layout) -> tuple[str, Ring]:
    """Make a display ring that only this process sees."""
    return "", Ring(bytearray(layout.nbytes), layout)


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
    """

    def __init__(
        self, rig: Rig, *, make_ring: Callable[[Layout], tuple[str, Ring]] = on_the_heap, buffer_s: float = BUFFER_S
    ) -> None:
        self._rig, self._make_ring, self._buffer_s = rig, make_ring, buffer_s
        self._lock = RLock()
        self._faults = FaultLog()
        self._settings = Settings()
        self._calibration: Calibration | None = None
        self._view = View()
        self._tracker: FrameConsumer | None = None
        self._run: Run | None = None
        self._shown: Shown | None = None
        self._display: tuple[str, Layout] | None = None
        self._retired: list[Ring] = []
        self._live = self._scanning = False
        self._settling = 0
        self._configured = False
        self._closing = Event()
        self._watcher = Thread(target=self._watch, name="engine-watch", daemon=True)
        self._watcher.start()

    # settings

    def configure(self, settings: Settings) -> None:
        """Set up camera and timing; a running stream is stopped, and started again with a ramp that fits.

        Raises
        ------
        InputError
            If the camera cannot do that.
        DeviceError
            If the camera does not answer.
        """
        chosen = preset(settings.preset)
        with self._lock:
            again = self._live
            self._end_run()
            row, col = chosen.sensor_origin
            rows, cols = chosen.frame_shape
            rate = settings.frame_rate_hz or chosen.optics.frame_rate_hz
            self._rig.camera.configure(
                Region(row, col, rows, cols), slit_rows=settings.slit_rows, frame_rate_hz=rate, gain_db=settings.gain_db
            )
            self._settings, self._configured = settings, True
            self._settling = SETTLING_FRAMES
            self._renew_images()
            if again:
                self.start()

    def use(self, calibration: Calibration | None) -> None:
        """Take a calibration into force: images are made and the mirror is driven by it.

        Raises
        ------
        CalibrationError
            If it does not fit the frames; the one before stays in force.
        InputError
            If the ramp that it asks for is impossible.
        """
        with self._lock:
            before = self._calibration
            self._calibration = calibration
            try:
                self._renew_images()
                if self._live:
                    self._scan()
            except BaseException:
                self._calibration = before
                raise

    def show(self, view: View) -> None:
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
            if not self._configured:
                raise InputError("the camera has no settings", "configure the engine first")
            self._faults.clear()
            self._finish_run()
            assert self._shown is not None
            camera = self._rig.camera
            run = Run(
                camera,
                self._shown,
                self._faults,
                tracker=self._tracker,
                frame_rate_hz=1 / (camera.rows_per_frame * camera.line_period_s),
                buffer_s=self._buffer_s,
                settling=self._settling,
            )
            self._run = run
            try:
                self._scan()
                run.start()
            except BaseException:
                self._park()
                run.stop()
                raise
            self._live, self._settling = True, 0

    def stop(self) -> None:
        """Park the mirror and end the stream; a recording is finished in the background."""
        with self._lock:
            self._end_run()

    def hold(self, volts: float) -> None:
        """Let the line stand while frames stream; the rig parks it when that goes on too long."""
        with self._lock:
            self._rig.scanner.hold(volts)
            self._scanning = False

    def park(self) -> None:
        """Take the line off the bundle; frames go on streaming."""
        with self._lock:
            self._scanning = False
            self._rig.scanner.park()

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
            self._scan(calibration)

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
            self._run.record(plan, self._calibration, self._described())

    def stop_recording(self) -> None:
        """Finish the recording with the newest frame; returns when the file is in order."""
        run = self._run
        if run is not None:
            run.stop_recording()

    def finish_recording(self) -> None:
        """After :meth:`stop`: wait until the recording is in order."""
        self._finish_run()

    # looking

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

    @property
    def display(self) -> Ring | None:
        """The ring in which images are shown."""
        return self._shown.ring if self._shown is not None else None

    @property
    def frame_shape(self) -> tuple[int, int]:
        """Rows and columns of a raw frame."""
        return self._rig.camera.frame_shape

    @property
    def sensor_origin(self) -> tuple[int, int]:
        """Row and column of the sensor at which frames begin."""
        return preset(self._settings.preset).sensor_origin

    @property
    def limits(self) -> MirrorLimits:
        """What the mirror may be asked for."""
        return self._rig.limits

    @property
    def line_period_s(self) -> float:
        """Seconds from the readout of one row to that of the next."""
        return self._rig.camera.line_period_s

    @property
    def frame_period_s(self) -> float:
        """Seconds from one frame to the next."""
        return self._rig.camera.rows_per_frame * self._rig.camera.line_period_s

    @property
    def acquired_with(self) -> AcquiredWith:
        """The rig's settings, as a calibration keeps them."""
        chosen = preset(self._settings.preset)
        return AcquiredWith(
            rig=self._rig.name,
            objective=chosen.objective,
            slit_rows=self._settings.slit_rows,
            frame_rate_hz=self._settings.frame_rate_hz or chosen.optics.frame_rate_hz,
            gain_db=self._settings.gain_db,
        )

    @property
    def calibration(self) -> Calibration | None:
        """The calibration in force."""
        return self._calibration

    @property
    def settings(self) -> Settings:
        """How the rig runs."""
        return self._settings

    def status(self) -> Status:
        """Say how it goes."""
        run = self._run
        if run is None:
            return Status(display=self._display, faults=self._faults.all())
        tally = run.tally
        rows, cols = self._rig.camera.frame_shape
        return Status(
            live=self._live,
            scanning=self._scanning,
            acquired=tally.acquired,
            processed=tally.processed,
            recorded=tally.recorded,
            dropped=dict(tally.dropped),
            camera_hz=tally.recent_hz if self._live else 0.0,
            mean_hz=tally.mean_hz,
            latency_ms=tally.latency.summary(),
            measures=run.processing.measures,
            recording=run.recording,
            disk_bytes_per_s=rows * cols * run.frame_rate_hz,
            display=self._display,
            faults=self._faults.all(),
            stale=self._stale(),
        )

    def close(self) -> None:
        """Stop, finish the recording, park, and let the rig go."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._watcher.join()
        with self._lock:
            try:
                self._end_run()
                self._finish_run()
            finally:
                self._rig.close()
                for ring in (*self._retired, *([self._shown.ring] if self._shown is not None else ())):
                    ring.close()
                self._shown, self._display = None, None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # inside

    def _renew_images(self) -> None:
        """Build how images are made anew, and the ring that shows them where its layout has changed."""
        if not self._configured:
            return
        images = LiveImages(self._rig.camera.frame_shape, self._calibration, self._view)
        if self._shown is not None and self._display is not None and self._display[1] == images.layout:
            ring = self._shown.ring
        else:
            if self._shown is not None:
                self._retired.append(self._shown.ring)
            name, ring = self._make_ring(images.layout)
            self._display = (name, images.layout)
        self._shown = Shown(images, ring)
        if self._run is not None:
            self._run.processing.shown = self._shown

    def _scan(self, by: Calibration | None = None) -> None:
        """Put the mirror into step with the camera, as far as the calibration knows how."""
        calibration, camera = by or self._calibration, self._rig.camera
        self._scanning = False
        if calibration is None or calibration.galvo is None or calibration.bundle is None:
            return
        timing = ScanTiming(camera.line_period_s, camera.rows_per_frame, self._settings.slit_rows, self._rig.strobe)
        self._rig.scanner.scan(els_waveform(calibration, timing, self._rig.limits))
        self._scanning = True

    def _end_run(self) -> None:
        """Park first, so that the light leaves the tissue; then end the stream."""
        if not self._live:
            return
        self._live = self._scanning = False
        self._park()
        assert self._run is not None
        self._run.stop()
        while self._retired:
            self._retired.pop().close()

    def _park(self) -> None:
        try:
            self._rig.scanner.park()
        except DeviceError as error:
            self._faults.add("scanner", error)

    def _finish_run(self) -> None:
        if self._run is not None and not self._live:
            self._run.finish_recording()

    def _watch(self) -> None:
        """Notice what fails while nobody asks; stop and park then, keep the data."""
        while not self._closing.wait(_WATCH_PERIOD_S):
            with self._lock:
                if not self._live:
                    continue
                try:
                    self._rig.scanner.check()
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

    def _described(self) -> dict[str, Any]:
        """Return the rig's settings as they are kept in a recording."""
        camera = self._rig.camera
        return {
            **self.acquired_with.model_dump(),
            "preset": self._settings.preset,
            "line_period_s": camera.line_period_s,
            "rows_per_frame": camera.rows_per_frame,
        }

    def _stale(self) -> dict[str, str]:
        if self._calibration is None or not self._configured:
            return {}
        chosen = preset(self._settings.preset)
        frame = FrameSection(shape=chosen.frame_shape, sensor_origin=chosen.sensor_origin)
        return self._calibration.stale_sections(self.acquired_with, frame)
