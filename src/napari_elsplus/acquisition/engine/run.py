"""One run of the stream, from start to stop: the camera's thread, processing, and at most one recorder."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.acquisition.engine.status import RecordingState
from napari_elsplus.acquisition.engine.workers import CameraWorker, ProcessingWorker
from napari_elsplus.acquisition.streaming.recorder import Recorder
from napari_elsplus.acquisition.streaming.stream import FrameStream
from napari_elsplus.acquisition.streaming.tally import Tally
from napari_elsplus.errors import DeviceError, InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from napari_elsplus.acquisition.engine.workers import FrameConsumer, Shown
    from napari_elsplus.acquisition.streaming.faults import FaultLog
    from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
    from napari_elsplus.hardware.protocols import Camera
    from napari_elsplus.instrument.calibration import Calibration

SHALLOWEST: Final = 64
"""Frames that the stream holds at least."""


class Run:
    """The threads of one run.

    Parameters
    ----------
    camera : Camera
        Configured; started and stopped by the run.
    shown : Shown
        How live images are made and where they are shown.
    faults : FaultLog
        Where faults are kept.
    tracker : FrameConsumer, optional
        Also gets every frame.
    frame_rate_hz : float
        For counting in seconds.
    buffer_s : float
        How many seconds of raw frames are kept in memory.
    settling : int
        Frames to throw away first.
    """

    def __init__(
        self,
        camera: Camera,
        shown: Shown,
        faults: FaultLog,
        *,
        tracker: FrameConsumer | None,
        frame_rate_hz: float,
        buffer_s: float,
        settling: int,
    ) -> None:
        self.tally = Tally()
        self.frame_rate_hz = frame_rate_hz
        self._camera, self._faults = camera, faults
        self._stream = FrameStream(camera.frame_shape, max(SHALLOWEST, round(buffer_s * frame_rate_hz)))
        self._taking = CameraWorker(camera, self._stream, self.tally, faults, settling)
        self.processing = ProcessingWorker(self._stream, shown, self.tally, faults, tracker)
        self._recorder: Recorder | None = None

    def start(self) -> None:
        """Begin to stream."""
        self.processing.start()
        try:
            self._camera.start()
        except BaseException:
            self._stream.end()
            raise
        self._taking.start()

    @property
    def broken(self) -> bool:
        """Whether a thread has ended that should not have."""
        return not (self._taking.is_alive() and self.processing.is_alive())

    def stop(self) -> None:
        """End the stream; every frame that came has its result then, the recorder still writes what it has."""
        self._taking.stop()
        if self._taking.ident is not None:
            self._taking.join()
        self._camera.stop()
        self._stream.end()
        self.processing.join()

    def record(self, plan: RecordingPlan, calibration: Calibration | None, settings: Mapping[str, Any]) -> None:
        """Begin to record.

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
        self._recorder.start()

    def stop_recording(self) -> None:
        """Finish the recording with the newest frame; returns when the file is in order."""
        if self._recorder is not None:
            self._recorder.stop()
            self._recorder.join()

    def finish_recording(self) -> None:
        """Wait until everything that the recording still wants has been written; only after :meth:`stop`."""
        if self._recorder is not None:
            self._recorder.join()

    @property
    def recording(self) -> RecordingState | None:
        """The recording, if there was one in this run."""
        if self._recorder is None:
            return None
        return RecordingState(str(self._recorder.plan.path), self._recorder.frames, self._recorder.is_alive())

    def fresh_frames(self, count: int, after_s: float, timeout_s: float) -> NDArray[np.uint8]:
        """Copy the next frames whose exposure began after a moment, however long they were on their way.

        Parameters
        ----------
        count : int
            How many.
        after_s : float
            On the clock of ``time.perf_counter``.
        timeout_s : float
            How long to wait for each.

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
        frames = np.empty((count, *self._stream.frame_shape), np.uint8)
        got = 0
        try:
            while got < count:
                taken = cursor.take(timeout_s)
                if taken is None:
                    for fault in self._faults.all():
                        if fault.source == "camera":  # the cause, not what follows from it
                            raise DeviceError(fault.problem, fault.remedy)
                    raise DeviceError(f"{got} of {count} frames came", "check the camera, then start again")
                if taken[1].readout_start_s + self._taking.camera_clock_s >= after_s:
                    frames[got] = taken[0]
                    got += 1
        finally:
            cursor.close()
        return frames
