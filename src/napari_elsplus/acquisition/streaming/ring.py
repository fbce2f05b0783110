"""A ring of slots that one writer fills and any number of readers copy from, also in other processes.

The writer never waits for a reader. A reader that was overtaken while it copied detects that by the slot's sequence
number, and copies a newer one.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.hardware.protocols import FrameInfo

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

_ALIGNMENT: Final = 64
"""Bytes of a cache line, on which fields begin."""
_HEADER: Final = np.dtype(
    [("state", "<i8"), ("frame_number", "<i8"), ("received_s", "<f8"), ("readout_start_s", "<f8")]
)
_BEING_WRITTEN: Final = 0
"""State of a slot that no reader may use; chosen: new shared memory is zero."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Arrays of a slot, and number of slots.

    Parameters
    ----------
    slots : int
        Number of slots, at least two: one is being written, the others can be read.
    fields : tuple of (name, shape, dtype name)
        The arrays of a slot.

    Examples
    --------
    >>> layout = Layout(slots=4, fields=(("raw", (524, 1328), "uint8"),))
    >>> layout.slot_bytes, layout.nbytes
    (695936, 2783744)
    """

    slots: int
    fields: tuple[tuple[str, tuple[int, ...], str], ...]

    def __post_init__(self) -> None:
        if self.slots < 2:
            raise ValueError(f"a ring of {self.slots} slots")

    @property
    def slot_bytes(self) -> int:
        """Bytes of one slot, its header included."""
        return _aligned(_HEADER.itemsize) + sum(_aligned(_bytes(shape, dtype)) for _, shape, dtype in self.fields)

    @property
    def nbytes(self) -> int:
        """Bytes of all slots."""
        return self.slots * self.slot_bytes


@dataclass(frozen=True, slots=True)
class Slot:
    """One slot while it is written or read in place.

    Parameters
    ----------
    sequence : int
        Position in the order of writing, from 0.
    arrays : mapping of str to numpy.ndarray
        Views into the ring.
    """

    sequence: int
    arrays: Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Stamp(FrameInfo):
    """Number and times of the frame in a slot.

    Parameters
    ----------
    frame_number, received_s, readout_start_s
        As of :class:`~napari_elsplus.hardware.protocols.FrameInfo`.
    sequence : int
        Position in the order of writing, from 0.
    """

    sequence: int


class Ring:
    """A ring in memory that the caller provides: on the heap, or shared between processes.

    Parameters
    ----------
    memory : buffer
        At least ``layout.nbytes`` writable bytes, all zero when the ring is new.
    layout : Layout
        The same on every side.

    Examples
    --------
    >>> from napari_elsplus.hardware.protocols import FrameInfo
    >>> layout = Layout(slots=3, fields=(("els", (2, 2), "float32"),))
    >>> ring = Ring(bytearray(layout.nbytes), layout)
    >>> slot = ring.acquire()
    >>> slot.arrays["els"][...] = 7
    >>> ring.finalize(slot, FrameInfo(frame_number=12, received_s=0.05, readout_start_s=0.0))
    >>> out = {"els": np.empty((2, 2), np.float32)}
    >>> stamp = ring.newest_after(-1, out)
    >>> stamp.frame_number, float(out["els"][0, 0])
    (12, 7.0)
    >>> ring.newest_after(stamp.sequence, out) is None
    True
    """

    name = ""
    """Name by which other processes attach to it; empty where they cannot."""

    def __init__(self, memory: Any, layout: Layout) -> None:
        self.layout = layout
        self._lease = Lock()
        """Held by a reader while it copies, so that the memory is not unmapped meanwhile."""
        self._closed = False
        stride = layout.slot_bytes
        self._headers = np.ndarray((layout.slots,), _HEADER, memory, 0, (stride,))
        self._states = self._headers["state"]
        self._arrays: list[dict[str, NDArray[Any]]] = []
        for slot in range(layout.slots):
            offset, arrays = slot * stride + _aligned(_HEADER.itemsize), {}
            for name, shape, dtype in layout.fields:
                arrays[name] = np.ndarray(shape, dtype, memory, offset)
                offset += _aligned(_bytes(shape, dtype))
            self._arrays.append(arrays)
        self._next = int(self._states.max())

    def acquire(self) -> Slot:
        """Return the oldest slot for writing; its content is lost."""
        index = self._next % self.layout.slots
        self._states[index] = _BEING_WRITTEN
        return Slot(self._next, self._arrays[index])

    def finalize(self, slot: Slot, info: FrameInfo) -> None:
        """Publish an acquired `slot` with the `info` of its frame."""
        header = self._headers[slot.sequence % self.layout.slots]
        header["frame_number"] = info.frame_number
        header["received_s"] = info.received_s
        header["readout_start_s"] = info.readout_start_s
        header["state"] = slot.sequence + 1
        self._next = slot.sequence + 1

    def stamp(self, sequence: int) -> Stamp | None:
        """Return number and times of the frame of a sequence number; None if it is not in the ring, or not any more."""
        state, frame_number, received_s, readout_start_s = self._headers[sequence % self.layout.slots].item()
        return Stamp(frame_number, received_s, readout_start_s, sequence) if state == sequence + 1 else None

    def newest_after(self, sequence: int, out: Mapping[str, NDArray[Any]]) -> Stamp | None:
        """Copy the newest frame, if it is later than a sequence number.

        Parameters
        ----------
        sequence : int
            Of the last frame that was copied; -1 for none.
        out : mapping of str to numpy.ndarray
            Fields to copy, each into an array of its shape.

        Returns
        -------
        Stamp or None
            None if there is nothing newer, or the ring is closed; `out` may then hold pieces of several frames.
        """
        with self._lease:
            for _ in range(0 if self._closed else self.layout.slots):
                newest = int(self._states.max()) - 1
                if newest <= sequence:
                    return None
                stamp = self.stamp(newest)
                arrays = self._arrays[newest % self.layout.slots]
                for name, target in out.items():
                    np.copyto(target, arrays[name])
                if stamp is not None and self._states[newest % self.layout.slots] == newest + 1:
                    return stamp
            return None

    def close(self) -> None:
        """Release the memory once no reader copies from it; readers find nothing newer from then on.

        Does nothing the second time.
        """
        with self._lease:
            if self._closed:
                return
            self._closed = True
            del self._headers, self._states
            self._arrays.clear()


def _aligned(size: int) -> int:
    return -(-size // _ALIGNMENT) * _ALIGNMENT


def _bytes(shape: tuple[int, ...], dtype: str) -> int:
    return int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize
