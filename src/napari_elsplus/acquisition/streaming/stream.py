"""The stream of raw frames from the camera to its consumers: one deep ring, a cursor per consumer.

The ring is the bounded queue of every consumer at once: a frame is copied by nobody, a cursor that falls too far behind
skips the oldest frames and counts them, and a recording can begin with frames of the last seconds.
"""

from __future__ import annotations

import mmap
from threading import Condition
from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.acquisition.streaming.ring import Layout, Ring, Slot, Stamp

if TYPE_CHECKING:
    from numpy.typing import NDArray


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

    Attributes
    ----------
    skipped : int
        Frames lost because the consumer was too slow.
    """

    def __init__(self, stream: FrameStream, start: int, limit: int) -> None:
        self._stream = stream
        self.next = start
        self.limit = limit
        self.held: int | None = None
        self.skipped = 0

    @property
    def behind(self) -> int:
        """Number of frames not taken yet."""
        return self._stream.written - self.next

    def take(self, timeout_s: float) -> tuple[NDArray[np.uint8], Stamp] | None:
        """Return the oldest frame not taken yet, in place, and hold it; releases the one before.

        Parameters
        ----------
        timeout_s : float
            Time to wait for it.

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

    Parameters
    ----------
    frame_shape : tuple of int
        Rows and columns.
    frames : int
        Depth of the ring.

    Examples
    --------
    >>> stream = FrameStream((2, 3), frames=4)
    >>> cursor = stream.join()
    >>> slot = stream.acquire()
    >>> slot.arrays["raw"][...] = 9
    >>> stream.finalize(slot, frame_number=0, received_s=0.0, readout_start_s=0.0)
    >>> frame, stamp = cursor.take(timeout_s=0)
    >>> int(frame.max()), stamp.frame_number
    (9, 0)
    """

    def __init__(self, frame_shape: tuple[int, int], frames: int) -> None:
        layout = Layout(slots=frames, fields=(("raw", frame_shape, "uint8"),))
        memory = mmap.mmap(-1, layout.nbytes)
        np.frombuffer(memory, np.uint8)[:: mmap.PAGESIZE] = 0  # so that no page is first touched while the camera runs
        self._ring = Ring(memory, layout)
        self._changed = Condition()
        self._cursors: list[Cursor] = []
        self._ended = False
        self.frame_shape = frame_shape
        self.depth = frames

    @property
    def written(self) -> int:
        """Frames that went into the stream."""
        return self._ring.written

    @property
    def ended(self) -> bool:
        """True if no more frames will come."""
        return self._ended

    def acquire(self) -> Slot:
        """Return the oldest slot that no consumer holds, for the camera to fill."""
        with self._changed:
            held = {cursor.held % self.depth for cursor in self._cursors if cursor.held is not None}
            while self._ring.written % self.depth in held:
                self._ring.skip()
            for cursor in self._cursors:
                oldest = self._ring.written + 1 - min(cursor.limit, self.depth)
                while cursor.next < oldest:
                    cursor.skipped += self._ring.stamp(cursor.next) is not None
                    cursor.next += 1
            return self._ring.acquire()

    def finalize(self, slot: Slot, *, frame_number: int, received_s: float, readout_start_s: float) -> None:
        """Publish a filled slot with its frame number and the times received and start of readout."""
        with self._changed:
            self._ring.finalize(slot, frame_number=frame_number, received_s=received_s, readout_start_s=readout_start_s)
            self._changed.notify_all()

    def end(self) -> None:
        """End the stream; cursors still read what is there."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def join(self, *, earlier: int = 0, limit: int | None = None) -> Cursor:
        """Add a consumer.

        Parameters
        ----------
        earlier : int
            Frames of the past to begin with, as far as they are still there.
        limit : int, optional
            Frames that it may be behind; the ring's depth by default.
        """
        with self._changed:
            kept = min(earlier, self._ring.written, self.depth - 2)  # one slot is being filled, one is about to be
            cursor = Cursor(self, self._ring.written - kept, self.depth if limit is None else limit)
            self._cursors.append(cursor)
            return cursor

    def leave(self, cursor: Cursor) -> None:
        """Remove a consumer's cursor."""
        with self._changed:
            if cursor in self._cursors:
                self._cursors.remove(cursor)

    def take(self, cursor: Cursor, timeout_s: float) -> tuple[NDArray[np.uint8], Stamp] | None:
        """Return the next frame of a cursor: :meth:`Cursor.take`."""
        with self._changed:
            cursor.held = None
            if cursor.next >= self._ring.written and not self._ended:
                self._changed.wait_for(lambda: cursor.next < self._ring.written or self._ended, timeout_s)
            while cursor.next < self._ring.written:
                sequence = cursor.next
                cursor.next += 1
                stamp = self._ring.stamp(sequence)
                if stamp is not None:  # None: the camera skipped a slot that a consumer held
                    cursor.held = sequence
                    return self._ring.peek(sequence).arrays["raw"], stamp
            return None
