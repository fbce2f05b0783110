"""The two threads that must keep the camera's pace: one takes frames from the camera, one works on them."""

from __future__ import annotations

import time
from math import inf
from threading import Event, Thread
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from napari_elsplus.acquisition.engine.live_images import LiveImages, Measures
from napari_elsplus.errors import DeviceError, ElsPlusError
from napari_elsplus.processing.images.elsa import elsa_pair

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.acquisition.streaming.faults import FaultLog
    from napari_elsplus.acquisition.streaming.ring import Ring, Stamp
    from napari_elsplus.acquisition.streaming.stream import FrameStream
    from napari_elsplus.acquisition.streaming.tally import Tally
    from napari_elsplus.hardware.protocols import Camera

DISPLAY_HZ: Final = 60.0
PROCESSING_LIMIT: Final = 120
"""Frames that processing may be behind before it skips: half a second at 240 Hz."""
_PATIENCE_S: Final = 0.1
_START_TAKES_S: Final = 5e-3
"""A camera may be exposing for so long when it answers that it was started."""
_LONGEST_SETTLING_S: Final = 1.0
_SILENCE_S: Final = 3.0


class Shown(NamedTuple):
    """How live images are made, and the ring in which they are shown; the two fit each other."""

    images: LiveImages
    ring: Ring


class FrameConsumer(Protocol):
    """Whatever else is done with every frame, in the order of frames."""

    def add(self, raw: NDArray[np.uint8], stamp: Stamp) -> None:
        """Work on a frame; it is overwritten later."""


class CameraWorker(Thread):
    """Takes frames from a streaming camera into the stream until it is told to stop or the camera fails.

    Parameters
    ----------
    camera : Camera
        Streaming.
    stream : FrameStream
        Where the frames go; ended when this thread ends.
    tally : Tally
        Counts frames.
    faults : FaultLog
        Hears of a camera that failed.
    settling : int
        Frames to throw away first: a camera's first two after a change of region are invalid. Those that queued up
        while camera and mirror were started are thrown away, too, so that the stream begins with a frame in time.

    Attributes
    ----------
    camera_clock_s : float
        Earliest moment, on the clock of ``time.perf_counter``, at which the camera's own clock can have stood at zero:
        its first frame was not exposed before it was started. However late a frame comes, it is known by this not to be
        older than it says.
    """

    def __init__(self, camera: Camera, stream: FrameStream, tally: Tally, faults: FaultLog, settling: int) -> None:
        super().__init__(name="camera", daemon=True)
        self._camera, self._stream, self._tally, self._faults = camera, stream, tally, faults
        self.camera_clock_s = -inf
        self._settling = settling
        self._stop_asked = Event()

    def stop(self) -> None:
        """End with the frame that is being read."""
        self._stop_asked.set()

    def run(self) -> None:
        """Read frames."""
        try:
            self._read()
        except DeviceError as error:
            self._faults.add("camera", error)
        finally:
            self._stream.end()

    def _read(self) -> None:
        camera, stream, tally = self._camera, self._stream, self._tally
        started_s = heard_s = time.perf_counter()
        frame_period_s = camera.line_periods_per_frame * camera.line_period_s
        settled = False
        before: dict[str, int] = {}
        expected: int | None = None
        missing = 0
        while not self._stop_asked.is_set():
            slot = stream.acquire()
            try:
                info = camera.read_into(slot.arrays["raw"], _PATIENCE_S)
            except TimeoutError:
                if time.perf_counter() - heard_s > _SILENCE_S:
                    raise DeviceError(
                        f"the camera has sent no frame for {_SILENCE_S:g} s", "check its cable, then connect again"
                    ) from None
                continue
            heard_s = info.received_s
            if self.camera_clock_s == -inf:
                first_exposed_s = info.readout_start_s - info.frame_number * frame_period_s
                self.camera_clock_s = started_s - _START_TAKES_S - first_exposed_s
            if not settled:
                late_s = (
                    info.received_s - (info.readout_start_s + self.camera_clock_s) - _START_TAKES_S - frame_period_s
                )
                settled = late_s < frame_period_s or info.received_s - started_s > _LONGEST_SETTLING_S
                settled = settled and info.frame_number >= self._settling
                before = dict(camera.dropped)  # what was lost before the first frame that counts does not count
                if not settled:
                    continue
            if expected is not None and info.frame_number > expected:
                missing += info.frame_number - expected
            expected = info.frame_number + 1
            known = {cause: count - before.get(cause, 0) for cause, count in camera.dropped.items()}
            tally.lost_by_camera(known, missing)
            stream.finalize(
                slot, frame_number=info.frame_number, received_s=info.received_s, readout_start_s=info.readout_start_s
            )
            tally.arrived(info.received_s)


class ProcessingWorker(Thread):
    """Sections every frame, hands it to the tracker if there is one, and shows the newest at the display's pace.

    Parameters
    ----------
    stream : FrameStream
        Where the frames come from.
    shown : Shown
        How images are made and where they are shown; may be replaced while frames stream.
    tally : Tally
        Counts frames and latencies.
    faults : FaultLog
        Hears of what went wrong.
    tracker : FrameConsumer, optional
        Also gets every frame.
    """

    def __init__(
        self,
        stream: FrameStream,
        shown: Shown,
        tally: Tally,
        faults: FaultLog,
        tracker: FrameConsumer | None,
    ) -> None:
        super().__init__(name="processing", daemon=True)
        self._stream, self._tally, self._faults = stream, tally, faults
        self.shown, self.tracker = shown, tracker
        self.measures = Measures()
        self._due_s = 0.0
        self._begun = -1
        self._cursor = stream.join(limit=min(PROCESSING_LIMIT, stream.depth))

    def run(self) -> None:
        """Work until the stream has ended and every frame has its result."""
        cursor, tally = self._cursor, self._tally
        while True:
            taken = cursor.take(_PATIENCE_S)
            if taken is None:
                if self._stream.ended:
                    break
                continue
            raw, stamp = taken
            tracker, shown = self.tracker, self.shown
            if tracker is not None:
                self._track(tracker, raw, stamp)
            show = self._section(shown.images, raw, stamp.frame_number, each=tracker is None)
            tally.latency.add(time.perf_counter() - stamp.received_s)
            tally.processed += 1
            tally.skipped("processing slow", cursor.skipped)
            if show:
                self._show(shown, raw, stamp)
        cursor.close()

    def _section(self, images: LiveImages, raw: NDArray[np.uint8], frame_number: int, *, each: bool) -> bool:
        """Section a frame, and say whether it shall be shown.

        Where a tracker gives every frame its result, only those are sectioned that are shown: the confocal and the
        residual frame of one ELSA image.
        """
        last = self._stream.ended
        due = time.perf_counter() >= self._due_s
        confocal, residual = elsa_pair(frame_number)
        if each or images.averages or last:
            images.add(raw, frame_number)
            return due or last
        if due and frame_number == confocal:
            images.add(raw, frame_number)
            self._begun = frame_number
        elif frame_number == residual and self._begun == confocal:
            images.add(raw, frame_number)
            return True
        return False

    def _track(self, tracker: FrameConsumer, raw: NDArray[np.uint8], stamp: Stamp) -> None:
        try:
            tracker.add(raw, stamp)
        except ElsPlusError as error:
            self._faults.add("tracking", error)
            self.tracker = None

    def _show(self, shown: Shown, raw: NDArray[np.uint8], stamp: Stamp) -> None:
        self._due_s = max(self._due_s + 1 / DISPLAY_HZ, time.perf_counter())
        slot = shown.ring.acquire()
        self.measures = shown.images.fill(raw, slot.arrays)
        shown.ring.finalize(
            slot, frame_number=stamp.frame_number, received_s=stamp.received_s, readout_start_s=stamp.readout_start_s
        )
