"""One run of the stream, from start to stop: the camera's thread, processing, and at most one recorder."""

from __future__ import annotations

import time
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.acquisition.engine.status import RecordingState, Status
from napari_elsplus.acquisition.engine.watcher import AgreementWatch
from napari_elsplus.acquisition.engine.workers import CameraWorker, ProcessingWorker
from napari_elsplus.acquisition.streaming.recorder import Recorder
from napari_elsplus.acquisition.streaming.stream import FrameStream
from napari_elsplus.acquisition.streaming.tally import Tally
from napari_elsplus.acquisition.streaming.usage import process_age_s, thread_times_s
from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.priority import full_collections_deferred

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from napari_elsplus.acquisition.engine.camera_setup import CameraSetup
    from napari_elsplus.acquisition.engine.display import Display
    from napari_elsplus.acquisition.engine.workers import FrameConsumer
    from napari_elsplus.acquisition.streaming.faults import FaultLog
    from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
    from napari_elsplus.instrument.calibration import Calibration

ENDING: Final = frozenset({"camera", "scanner", "engine"})
"""Sources of faults that end a stream."""
AGREEMENT_TIMEOUT_S: Final = 0.5
"""Time in which a frame has to come that is compared with the calibration; chosen: a stream then ends without delay."""
AWAITED_PERIODS: Final = 5
"""Frame periods in which a frame has to come at least; chosen: a slow camera discards two, and reads out one."""
MIN_DEPTH: Final = 64
"""Frames in the stream at least; chosen: for rates at which 2 s are few frames."""


class Run:
    """The threads of one run.

    Parameters
    ----------
    setup : CameraSetup
        Its camera is configured; started and stopped by the run.
    display : Display
        Receives the live images.
    faults : FaultLog
        Receives faults.
    scanned_by : callable
        Returns the active calibration if the line scans by it, else None; frames are compared with it.
    tracker : FrameConsumer, optional
        Receives every frame, too.
    buffer_s : float
        Seconds of raw frames that are kept in memory.
    """

    def __init__(
        self,
        setup: CameraSetup,
        display: Display,
        faults: FaultLog,
        scanned_by: Callable[[], Calibration | None],
        *,
        tracker: FrameConsumer | None,
        buffer_s: float,
    ) -> None:
        camera, frame_rate_hz = setup.camera, setup.frame_rate_hz
        self.tally = Tally()
        self.frame_rate_hz = frame_rate_hz
        self._setup, self._camera, self._faults = setup, camera, faults
        self._stream = FrameStream(camera.frame_shape, max(MIN_DEPTH, round(buffer_s * frame_rate_hz)))
        self._camera_worker = CameraWorker(camera, self._stream, self.tally, faults, setup.settling)
        self.processing = ProcessingWorker(self._stream, display, self.tally, faults, tracker)
        self._agreement = AgreementWatch(scanned_by, self._newest_frames, partial(faults.add, "processing"))
        self._recorder: Recorder | None = None
        self._held = ExitStack()
        self._age_s = process_age_s() - time.perf_counter()
        self._times_s: dict[str, float] = {}
        self._cpu_us_per_frame: dict[str, float] = {}
        self.stopped = False
        """True once :meth:`stop` has come to its end."""

    def start(self) -> None:
        """Begin to stream.

        Raises
        ------
        DeviceError
            If the camera fails; a `SlowBusError` if it has the default frame rate and the bus carries less.
        """
        self._times_s = thread_times_s()
        self._held.enter_context(full_collections_deferred())
        self.processing.start()
        try:
            self._camera.start()
        except BaseException:
            self._stream.end()
            raise
        self._camera_worker.start()
        self._agreement.start()
        self._setup.require_bus()

    @property
    def received(self) -> int:
        """Number of frames that the camera has delivered since its start, lost ones included."""
        return self._camera_worker.received

    @property
    def broken(self) -> bool:
        """True if a thread has ended that should not have."""
        return not (self._camera_worker.is_alive() and self.processing.is_alive())

    def stop(self) -> None:
        """End the stream; every frame that came has its result then, and the recorder goes on to its end.

        One that was interrupted is completed by the next.
        """
        frames = max(1, self.tally.acquired)
        self._cpu_us_per_frame = {
            name: 1e6 * (end_s - self._times_s.get(name, 0.0)) / frames for name, end_s in thread_times_s().items()
        }
        self._agreement.stop()
        self._camera_worker.stop()
        if self._camera_worker.ident is not None:
            self._camera_worker.join()
        try:
            self._camera.stop()
        except Exception as error:  # noqa: BLE001 - drivers of others raise what they will
            self._faults.add("camera", error)
        self._stream.end()
        for worker in (self.processing, self._agreement):
            if worker.ident is not None:
                worker.join()
        self._held.close()
        self.stopped = True

    def record(self, plan: RecordingPlan, calibration: Calibration | None, settings: Mapping[str, Any]) -> None:
        """Begin to record by a plan, with calibration and settings in the file.

        Raises
        ------
        InputError
            If a recording runs, the file exists, or its folder is missing.
        """
        if self._recorder is not None and self._recorder.is_alive():
            raise InputError(f"{self._recorder.plan.path.name} is still being recorded", "stop that recording first")
        self.tally.recorded = 0
        self._recorder = Recorder(
            self._stream,
            plan,
            frame_rate_hz=self.frame_rate_hz,
            calibration=calibration,
            settings=settings,
            tally=self.tally,
            faults=self._faults,
        )

    def stop_recording(self) -> None:
        """Finish the recording with the newest frame; returns when the file is complete."""
        self.end_recording()
        self.finish_recording()

    def end_recording(self) -> None:
        """End the recording with the newest frame; returns at once."""
        if self._recorder is not None:
            self._recorder.stop()

    def finish_recording(self) -> None:
        """Wait until the recording is complete; only after :meth:`stop` or :meth:`end_recording`."""
        if self._recorder is not None:
            self._recorder.join()

    @property
    def recording(self) -> RecordingState | None:
        """The recording, if there was one in this run."""
        recorder = self._recorder
        if recorder is None:
            return None
        path = str(recorder.plan.path)
        return RecordingState(path, recorder.frames, recorder.is_alive(), recorder.seconds, recorder.missing)

    @property
    def recorded(self) -> str:
        """Name of the file that is being recorded; empty without a recording."""
        recorder = self._recorder
        return recorder.plan.path.name if recorder is not None and recorder.is_alive() else ""

    def status(self, *, live: bool) -> Status:
        """Return the counts of the run, with the camera's rate while it is live."""
        tally = self.tally
        return Status(
            acquired=tally.acquired,
            processed=tally.processed,
            recorded=tally.recorded,
            dropped=dict(tally.dropped),
            camera_hz=tally.camera_hz if live else 0.0,
            mean_hz=tally.mean_hz,
            saturated=tally.saturated,
            latency_ms=tally.latency.summary(),
            cpu_us_per_frame=self._cpu_us_per_frame,
            started_s=self._age_s + tally.first_s,
            measures=self.processing.measures,
            recording=self.recording,
            disagreement=self._agreement.disagreement,
        )

    def _newest_frames(self, count: int) -> NDArray[np.uint8]:
        return self.fresh_frames(count, time.perf_counter(), AGREEMENT_TIMEOUT_S)

    def raise_ending_fault(self) -> None:
        """Raise the fault that ended the stream as a DeviceError, if there was one: the cause, not its consequence."""
        for fault in self._faults.all():
            if fault.source in ENDING:
                raise DeviceError(fault.problem, fault.remedy)

    def fresh_frames(
        self, count: int, after_s: float, timeout_s: float, check: Callable[[], None] = lambda: None
    ) -> NDArray[np.uint8]:
        """Copy the next frames whose exposure began after a moment, however long their transfer took.

        Parameters
        ----------
        count : int
            Number of frames.
        after_s : float
            On the clock of ``time.perf_counter``.
        timeout_s : float
            Time to wait for each, once that moment has come, beside some frame periods.
        check : callable
            Called between frames; what it raises ends the wait.

        Returns
        -------
        numpy.ndarray
            (count, rows, cols) uint8.

        Raises
        ------
        DeviceError
            If they do not come.
        """
        cursor = self._stream.join()
        timeout_s += AWAITED_PERIODS / self.frame_rate_hz
        frames = np.empty((count, *self._stream.frame_shape), np.uint8)
        got = 0
        try:
            due_s = max(after_s, time.perf_counter()) + timeout_s
            while got < count:
                check()
                taken = cursor.take(max(0.0, due_s - time.perf_counter()))
                if taken is None:
                    self.raise_ending_fault()
                    raise DeviceError(f"{got} of {count} frames came", "check the camera, then start again")
                if taken[1].readout_start_s + self._camera_worker.camera_clock_s >= after_s:
                    frames[got] = taken[0]
                    got += 1
                    due_s = time.perf_counter() + timeout_s
                elif time.perf_counter() > due_s:
                    raise DeviceError(
                        f"{got} of {count} frames came, the others were exposed before by the camera's clock",
                        "start the stream again, which compares the clocks anew",
                    )
        finally:
            cursor.close()
        return frames
