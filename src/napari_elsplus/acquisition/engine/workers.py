"""The two threads at the camera's rate: one reads frames from the camera, one processes them."""

from __future__ import annotations

import time
from dataclasses import replace
from math import inf
from threading import Event, Thread
from typing import TYPE_CHECKING, Final, Protocol

from napari_elsplus.acquisition.engine.live_images import Measures
from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.priority import Rank, join_frame_core
from napari_elsplus.hardware.protocols import HasClock
from napari_elsplus.processing.images.modes import elsa_pair

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.acquisition.engine.display import Display, DisplaySink
    from napari_elsplus.acquisition.engine.live_images import LiveImages
    from napari_elsplus.acquisition.streaming.faults import FaultLog
    from napari_elsplus.acquisition.streaming.ring import Slot, Stamp
    from napari_elsplus.acquisition.streaming.stream import FrameStream
    from napari_elsplus.acquisition.streaming.tally import Tally
    from napari_elsplus.hardware.protocols import Camera, FrameInfo

AHEAD_S: Final = 3.0
"""Seconds that a frame may be later than its number says; chosen: one that sends nothing for so long has failed."""
BACK_S: Final = 0.1
"""Seconds that it may be earlier; chosen: many times what software timestamps vary by."""
DISPLAY_HZ: Final = 60.0
"""Rate of the display; chosen: that of a screen."""
PROCESSING_LIMIT: Final = 120
"""Frames that processing may be behind before it skips; chosen: half a second at 240 Hz."""
_POLL_S: Final = 0.1
"""Chosen: how long to wait for a frame before the end of the stream is tested."""
_START_TAKES_S: Final = 5e-3
"""Time between the start of exposure and the camera's acknowledgement; chosen: more than a frame of 240 Hz."""
_MAX_SETTLING_S: Final = 1.0
"""Time after which frames are used although they are late; chosen: a busy computer catches up in less."""
_NO_FRAME_LIMIT_S: Final = 3.0
"""Time without a frame after which the camera has failed; chosen: many frame periods of the slowest rate."""


class EvenClock:
    """Makes up for jumps of the camera's clock, so that times go on as the frame numbers do.

    Parameters
    ----------
    frame_period_s : float
        Seconds from one frame to the next.

    Examples
    --------
    >>> from napari_elsplus.hardware.protocols import FrameInfo
    >>> clock = EvenClock(0.01)
    >>> [clock.readout_start_s(FrameInfo(number, 0.0, time_s)) for number, time_s in enumerate((0.0, 0.01, 3600.02))]
    [0.0, 0.01, 0.02]
    >>> round(clock.jump_s)
    3600
    """

    def __init__(self, frame_period_s: float) -> None:
        self._period_s = frame_period_s
        self._last: tuple[int, float] | None = None
        self._offset_s = 0.0
        self.jump_s = 0.0
        """By how much the clock had jumped at the newest frame; 0 if it did not."""

    def readout_start_s(self, info: FrameInfo) -> float:
        """Return the start of the readout of the next frame by its number and times in `info`, in seconds.

        Raises
        ------
        DeviceError
            If its number is not above the last one: the camera counts anew.
        """
        start_s = info.readout_start_s - self._offset_s
        self.jump_s = 0.0
        if self._last is not None:
            number, last_s = self._last
            if info.frame_number <= number:
                raise DeviceError(
                    f"the camera counts its frames anew, {info.frame_number} after {number}",
                    "nobody can say how many are missing: start the stream again",
                )
            due_s = last_s + (info.frame_number - number) * self._period_s
            if not -BACK_S < start_s - due_s < AHEAD_S:
                self.jump_s = start_s - due_s
                self._offset_s += self.jump_s
                start_s = due_s
        self._last = info.frame_number, start_s
        return start_s


class FrameConsumer(Protocol):
    """Receives every frame in order, such as a tracker."""

    def add(self, raw: NDArray[np.uint8], stamp: Stamp) -> None:
        """Process a raw frame by its stamp; the frame is overwritten later."""


class CameraWorker(Thread):
    """Reads frames from a streaming camera into the stream until :meth:`stop`, or the camera fails.

    Parameters
    ----------
    camera : Camera
        Streaming.
    stream : FrameStream
        Receives the frames; ended when this thread ends.
    tally : Tally
        Counts frames.
    faults : FaultLog
        Receives the failure of the camera.
    settling : int
        Frames to discard first: a camera's first two after a change of region are invalid. Those that queued up while
        camera and galvo were started are discarded, too, so that the stream begins with a frame in time.

    Attributes
    ----------
    camera_clock_s : float
        Earliest time of zero of the camera's clock, on the clock of ``time.perf_counter``: measured by the camera, or
        derived from its first frame, which was not exposed before the start. So a frame that comes late is not taken
        for a newer one; where the camera's clock gains on the computer's, every frame corrects it.
    received : int
        Frames that the camera has delivered since its start, lost ones included.
    """

    def __init__(self, camera: Camera, stream: FrameStream, tally: Tally, faults: FaultLog, settling: int) -> None:
        super().__init__(name="camera", daemon=True)
        self._camera, self._stream, self._tally, self._faults = camera, stream, tally, faults
        self.camera_clock_s = -inf
        self.received = 0
        self._settling = settling
        self._stopping = Event()
        self._frame_period_s = self._readout_s = 0.0
        self._started_s = self._last_s = 0.0
        self._start_takes_s = 0.0
        self._lost_before: dict[str, int] = {}
        self._next_number: int | None = None
        self._missing = 0

    def stop(self) -> None:
        """End after the frame that is being read."""
        self._stopping.set()

    def run(self) -> None:
        """Read frames."""
        join_frame_core(Rank.CAMERA)
        try:
            self._read()
        except Exception as error:  # noqa: BLE001 - also a driver's defect must end the stream in order
            self._faults.add("camera", error)
        finally:
            self._stream.end()

    def _read(self) -> None:
        camera, stream = self._camera, self._stream
        self._started_s = self._last_s = time.perf_counter()
        self._frame_period_s = camera.line_periods_per_frame * camera.line_period_s
        self._readout_s = camera.frame_shape[0] * camera.line_period_s
        clock, settled = EvenClock(self._frame_period_s), False
        while not self._stopping.is_set():
            slot = stream.acquire()
            info = self._received_into(slot)
            if info is None:
                continue
            info = replace(info, readout_start_s=clock.readout_start_s(info))
            if clock.jump_s:
                jumped = DeviceError("the clock of the camera jumped", "times follow its frame numbers")
                self._faults.add("clock", jumped)
            self.received = info.frame_number + 1
            self._relate_clocks(info)
            if not settled:
                settled = self._settles_with(info)
                self._lost_before = dict(camera.dropped)  # frames lost before the first one used do not count
                if not settled:
                    continue
            self._count_losses(info.frame_number)
            self._tally.arrived(info)
            stream.finalize(slot, info)  # last: it wakes the threads that wait for the frame

    def _received_into(self, slot: Slot) -> FrameInfo | None:
        """Read the next frame into a slot; None if none comes shortly, a DeviceError if none comes any more."""
        try:
            info = self._camera.read_into(slot.arrays["raw"], _POLL_S)
        except TimeoutError:
            if time.perf_counter() - self._last_s > _NO_FRAME_LIMIT_S:
                raise DeviceError(
                    f"the camera has sent no frame for {_NO_FRAME_LIMIT_S:g} s", "check its cable, then connect again"
                ) from None
            return None
        self._last_s = info.received_s
        return info

    def _relate_clocks(self, info: FrameInfo) -> None:
        """Estimate where zero of the camera's clock lies on the computer's, by the first frame and by later ones."""
        if self.camera_clock_s == -inf:
            measured_s = self._camera.clock_zero_s if isinstance(self._camera, HasClock) else None
            if measured_s is None:
                self._start_takes_s = _START_TAKES_S
                first_exposed_s = info.readout_start_s - info.frame_number * self._frame_period_s
                measured_s = self._started_s - _START_TAKES_S - first_exposed_s
            self.camera_clock_s = measured_s
        latest_s = info.received_s - info.readout_start_s - self._readout_s  # no frame comes before it was read
        self.camera_clock_s = min(self.camera_clock_s, latest_s)

    def _settles_with(self, info: FrameInfo) -> bool:
        """Return True if the stream may begin with a frame: it is valid, and in time unless the computer stays busy."""
        received_s = info.received_s
        due_s = info.readout_start_s + self.camera_clock_s + self._start_takes_s + self._frame_period_s
        in_time = received_s - due_s < self._frame_period_s or received_s - self._started_s > _MAX_SETTLING_S
        return in_time and info.frame_number >= self._settling

    def _count_losses(self, frame_number: int) -> None:
        """Count the frames that the camera lost since the first one used, by its own counts and by its numbers."""
        if self._next_number is not None:
            self._missing += max(frame_number - self._next_number, 0)
        self._next_number = frame_number + 1
        dropped = self._camera.dropped
        if self._missing or dropped != self._lost_before or self._tally.dropped:
            before = self._lost_before
            known = {cause: max(dropped.get(cause, 0) - before.get(cause, 0), 0) for cause in {**before, **dropped}}
            self._tally.lost_by_camera(known, self._missing)


class ProcessingWorker(Thread):
    """Passes every frame to the tracker if there is one, and sections and publishes the newest at the display's rate.

    Parameters
    ----------
    stream : FrameStream
        Source of the frames.
    display : Display
        Its sink makes and receives the images; may be replaced while frames stream.
    tally : Tally
        Counts frames and latencies.
    faults : FaultLog
        Receives faults.
    tracker : FrameConsumer, optional
        Receives every frame, too.
    """

    def __init__(
        self,
        stream: FrameStream,
        display: Display,
        tally: Tally,
        faults: FaultLog,
        tracker: FrameConsumer | None,
    ) -> None:
        super().__init__(name="processing", daemon=True)
        self._stream, self._tally, self._faults = stream, tally, faults
        self._display, self.tracker = display, tracker
        self.measures = Measures()
        self._due_s = 0.0
        self._begun = -1
        self._cursor = stream.join(limit=min(PROCESSING_LIMIT, stream.depth))

    def run(self) -> None:
        """Process until the stream has ended and every frame has its result."""
        join_frame_core(Rank.PROCESSING)
        cursor, tally = self._cursor, self._tally
        while True:
            taken = cursor.take(_POLL_S)
            if taken is None:
                if self._stream.ended:
                    break
                continue
            raw, stamp = taken
            tracker, sink = self.tracker, self._display.sink
            assert sink is not None, "a camera that streams is configured"
            if tracker is not None:
                self._track(tracker, raw, stamp)
            displayed = False
            try:
                displayed = self._section(sink.images, raw, stamp.frame_number)
                if displayed:
                    self._publish(sink, raw, stamp)
            except Exception as error:  # noqa: BLE001 - frames go on being acquired and recorded
                self._faults.add("processing", error)
            if displayed or tracker is not None:  # other frames have no result that could be late
                tally.latency.add(time.perf_counter() - stamp.received_s)
            tally.processed += 1
            tally.skipped("processing slow", cursor.skipped)
        cursor.close()

    def _section(self, images: LiveImages, raw: NDArray[np.uint8], frame_number: int) -> bool:
        """Return True if a frame is to be displayed, and section it unless its images are made of it alone.

        Only those frames are sectioned that contribute to what is displayed: one frame, the confocal and the residual
        one of an ELSA image, or all that are averaged.
        """
        last = self._stream.ended
        due = last or time.perf_counter() >= self._due_s
        confocal, residual = elsa_pair(frame_number)
        if images.of_one_frame:
            return due  # sectioned into the display's ring
        if images.averages or last:
            images.add(raw, frame_number)
            return due
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
        except Exception as error:  # noqa: BLE001 - frames go on being acquired and recorded
            self._faults.add("tracking", error)
            self.tracker = None

    def _publish(self, sink: DisplaySink, raw: NDArray[np.uint8], stamp: Stamp) -> None:
        self._due_s = max(self._due_s + 1 / DISPLAY_HZ, time.perf_counter())
        slot = sink.ring.acquire()
        self.measures = sink.images.fill(raw, slot.arrays)
        self._tally.displayed(self.measures.saturated)
        sink.ring.finalize(slot, stamp)
