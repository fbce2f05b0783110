"""Frames of a file that is mapped into memory: views, of which those that were read give their memory back."""

from __future__ import annotations

import mmap
import os
import sys
from threading import Lock
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import DTypeLike, NDArray

MAX_MAPPED_BYTES: Final = 64 << 20
"""Frames that may stay in memory. Chosen: some hundred frames; the system reads them again in microseconds."""
MAX_CACHED_PART: Final = 0.25
"""Part of the computer's memory: of a longer file, frames that were read one after the other do not stay in it.
Chosen: what is read once displaces nothing; room that is used again and again costs the system least."""


class MappedFrames:
    """A read-only array in a mapped file, the first axis of which is that of the frames.

    Pages are released at intervals, so that reading through a long recording does not fill the memory. Views stay
    valid: the system reads them again.

    Parameters
    ----------
    path : pathlib.Path
        File.
    shape : tuple of int
        (T, rows, cols).
    dtype : numpy.dtype
        Of the pixels, as stored.
    offset : int
        Of the first frame, bytes.
    strides : tuple of int, optional
        Bytes between frames, rows and columns; those of a contiguous stack by default.

    Raises
    ------
    ValueError
        If the file is shorter.
    """

    def __init__(
        self, path: Path, shape: tuple[int, ...], dtype: DTypeLike, offset: int, strides: tuple[int, ...] | None = None
    ) -> None:
        import psutil

        self._file = path.open("rb", buffering=0)
        self._reading = Lock()
        self._map = mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ)
        self._offset = offset
        self.array: NDArray[Any] = np.ndarray(shape, dtype, self._map, offset, strides)
        self._stride = self.array.strides[0]
        self._is_long = len(self._map) > MAX_CACHED_PART * psutil.virtual_memory().total
        self._bytes_returned = 0
        self._successive = range(0)

    def scattered(self, places: range, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return a copy of small arrays that lie far apart in the file, (len(places), *shape).

        They are read beside the mapping, by way of which the system would read what lies around each of them.

        Parameters
        ----------
        places : range
            Of their first bytes.
        shape : tuple of int
            Of each.
        dtype : numpy.dtype
            Of their elements, as stored.

        Raises
        ------
        EOFError
            If the file was cut meanwhile.
        """
        copied = np.empty((len(places), *shape), dtype)
        if sys.platform == "linux":  # asked for all of them beforehand, a disk need not wait for each
            for place in places:
                os.posix_fadvise(self._file.fileno(), place, copied[0].nbytes, os.POSIX_FADV_WILLNEED)
        with self._reading:
            for place, values in zip(places, copied, strict=True):
                self._file.seek(place)
                if self._file.readinto(values.data) < values.nbytes:
                    raise EOFError(f"the file ends before byte {place + values.nbytes}")
        return copied

    def frame(self, index: int) -> NDArray[Any]:
        """Return frame `index`, (rows, cols), a view of the file."""
        self._release_pages(index)
        return self.array[index, :, :]

    def _release_pages(self, index: int) -> None:
        """Release what was read up to a frame that is read next, if that was much."""
        before = self._successive
        self._successive = range(before.start if index in (before.stop - 1, before.stop) else index, index + 1)
        self._bytes_returned += self.array[0].nbytes
        if self._bytes_returned <= MAX_MAPPED_BYTES:
            return
        if sys.platform != "win32":
            self._map.madvise(mmap.MADV_DONTNEED)
        if self._is_long and sys.platform == "linux":
            start = self._offset + self._successive.start * self._stride
            read = (len(self._successive) - 1) * self._stride
            os.posix_fadvise(self._file.fileno(), start, read, os.POSIX_FADV_DONTNEED)
        self._bytes_returned, self._successive = 0, range(index, index + 1)

    def close(self) -> None:
        """Close the file; views that were returned keep it mapped."""
        self._file.close()
        self._map = mmap.mmap(-1, 1)
        self.array = np.empty((0, *self.array.shape[1:]), self.array.dtype)
