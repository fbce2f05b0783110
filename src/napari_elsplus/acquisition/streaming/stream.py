"""The stream of raw frames from the camera to its consumers: one deep ring, a cursor per consumer.

The ring is the bounded queue of every consumer at once: a frame is copied by nobody, a cursor that falls too far behind
skips the oldest frames and counts them, and a recording can begin with frames of the last seconds.
"""

from __future__ import annotations

import mmap
import sys
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.acquisition.streaming.ring import Slot, Stamp

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.hardware.protocols import FrameInfo


class Cursor:
    """A consumer's position in the stream: it holds one frame at a time.

    Parameters
    ----------
    stream : FrameStream
        The stream.
    start : int
        Sequence number of its first frame.
    limit : int
        Frames that it may be behind; older ones are skipped and counted.
    batch : int
        Frames for which it waits once there is none.

    Attributes
    ----------
    skipped : int
        Frames lost because the consumer was too slow.
    """

    def __init__(self, stream: FrameStream, start: int, limit: int, batch: int) -> None:
        self._stream = stream
        self.next = start
        self.limit, self.batch = limit, batch
        self.held: int | None = None
        self.skipped = 0
        self.awaited: int | None = None
        """Frames that have to be written before a waiting consumer is woken; None where it does not wait."""
        self.woken = Lock()
        """Acquired by a consumer that waits, and released to wake it."""
        self.woken.acquire()

    @property
    def behind(self) -> int:
        """Number of frames not taken yet."""
        return self._stream.written - self.next

    def take(self, timeout_s: float) -> tuple[NDArray[np.uint8], Stamp] | None:
        """Return the oldest frame not taken yet, in place, and hold it; releases the one before.

        Parameters
        ----------
        timeout_s : float
            Time to wait for it, or for a batch.

        Returns
        -------
        tuple or None
            The frame, valid until the next call, and its stamp; None if none came, or the stream has ended and all
            are read.
        """
        return self._stream.take(self, timeout_s)

    def close(self) -> None:
        """Leave the stream."""
        self._stream.leave(self)


class FrameStream:
    """The ring of raw frames and its cursors; the camera's thread writes, each consumer's thread reads.

    A consumer is woken by a lock of its own, once for a batch of frames: threads that wake together contend for the
    interpreter's lock.

    Parameters
    ----------
    frame_shape : tuple of int
        Rows and columns.
    frames : int
        Depth of the ring.

    Examples
    --------
    >>> from napari_elsplus.hardware.protocols import FrameInfo
    >>> stream = FrameStream((2, 3), frames=4)
    >>> cursor = stream.join()
    >>> slot = stream.acquire()
    >>> slot.arrays["raw"][...] = 9
    >>> stream.finalize(slot, FrameInfo(frame_number=0, received_s=0.0, readout_start_s=0.0))
    >>> frame, stamp = cursor.take(timeout_s=0)
    >>> int(frame.max()), stamp.frame_number
    (9, 0)
    """

    def __init__(self, frame_shape: tuple[int, int], frames: int) -> None:
        stride = -(-frame_shape[0] * frame_shape[1] // mmap.PAGESIZE) * mmap.PAGESIZE
        memory = _touched_memory(frames * stride)
        raws = [np.ndarray(frame_shape, np.uint8, memory, index * stride) for index in range(frames)]
        self._arrays = [{"raw": raw} for raw in raws]
        self._stamps: list[Stamp | None] = [None] * frames
        self._lock = Lock()
        self._cursors: list[Cursor] = []
        self.ended = False
        """True if no more frames will come."""
        self.written = 0
        """Frames that went into the stream."""
        self.frame_shape = frame_shape
        self.depth = frames

    def acquire(self) -> Slot:
        """Return the oldest slot that no consumer holds, for the camera to fill."""
        with self._lock:
            held = [cursor.held % self.depth for cursor in self._cursors if cursor.held is not None]
            while self.written % self.depth in held:
                self.written += 1  # a number that no frame gets
            for cursor in self._cursors:
                oldest = self.written + 1 - min(cursor.limit, self.depth)
                while cursor.next < oldest:
                    cursor.skipped += self._stamp(cursor.next) is not None
                    cursor.next += 1
            index = self.written % self.depth
            self._stamps[index] = None
            return Slot(self.written, self._arrays[index])

    def finalize(self, slot: Slot, info: FrameInfo) -> None:
        """Publish a filled `slot` with the `info` of its frame."""
        stamp = Stamp(info.frame_number, info.received_s, info.readout_start_s, slot.sequence)
        with self._lock:
            self._stamps[slot.sequence % self.depth] = stamp
            self.written = slot.sequence + 1
            self._wake()

    def end(self) -> None:
        """End the stream; cursors still read what is there."""
        with self._lock:
            self.ended = True
            self._wake()

    def join(self, *, earlier: int = 0, limit: int | None = None, batch: int = 1) -> Cursor:
        """Add a consumer.

        Parameters
        ----------
        earlier : int
            Frames of the past to begin with, as far as they are still there.
        limit : int, optional
            Frames that it may be behind; the ring's depth by default.
        batch : int
            Frames for which it waits once there is none; it gets what has come when the time is up.
        """
        with self._lock:
            kept = min(earlier, self.written, self.depth - 2)  # one slot is being filled, one is about to be
            cursor = Cursor(self, self.written - kept, self.depth if limit is None else limit, batch)
            self._cursors.append(cursor)
            return cursor

    def leave(self, cursor: Cursor) -> None:
        """Remove a consumer's cursor."""
        with self._lock:
            if cursor in self._cursors:
                self._cursors.remove(cursor)

    def take(self, cursor: Cursor, timeout_s: float) -> tuple[NDArray[np.uint8], Stamp] | None:
        """Return the next frame of a cursor: :meth:`Cursor.take`."""
        with self._lock:
            cursor.held = None
            waits = cursor.next >= self.written and not self.ended
            cursor.awaited = cursor.next + cursor.batch if waits else None
        if waits:
            cursor.woken.acquire(timeout=timeout_s)
        with self._lock:
            cursor.awaited = None
            cursor.woken.acquire(blocking=False)  # woken at the very end of its time
            while cursor.next < self.written:
                sequence = cursor.next
                cursor.next += 1
                stamp = self._stamp(sequence)
                if stamp is not None:  # None: the camera skipped a slot that a consumer held
                    cursor.held = sequence
                    return self._arrays[sequence % self.depth]["raw"], stamp
            return None

    def _stamp(self, sequence: int) -> Stamp | None:
        """Return number and times of the frame of a sequence number; None if it is not in the ring."""
        stamp = self._stamps[sequence % self.depth]
        return stamp if stamp is not None and stamp.sequence == sequence else None

    def _wake(self) -> None:
        """Wake the consumers whose batch is complete; at the end, all."""
        for cursor in self._cursors:
            if cursor.awaited is not None and (self.ended or cursor.awaited <= self.written):
                cursor.awaited = None
                cursor.woken.release()


def _touched_memory(size: int) -> mmap.mmap:
    """Allocate pages of which none is first touched while the camera runs."""
    if sys.platform == "linux":
        memory = mmap.mmap(-1, size, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | mmap.MAP_POPULATE)  # twice as fast
    else:
        memory = mmap.mmap(-1, size)
        np.frombuffer(memory, np.uint8)[:: mmap.PAGESIZE] = 0
    return memory
