"""Frames that lie at even distances in a file, read one at a time.

They are not mapped into memory: a mapped file that is cut meanwhile ends the program, the system finds each page of it
by itself, and what was read has to be given back.
"""

from __future__ import annotations

import io
import os
import sys
from typing import TYPE_CHECKING, Any, Final
from weakref import finalize

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.io.disk import read_at

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import DTypeLike, NDArray

RELEASED_BYTES: Final = 64 << 20
"""Of successive frames of a long file, after which they leave the system's memory. Chosen: some hundred frames; the
system reads them again in microseconds."""
MAX_CACHED_PART: Final = 0.25
"""Part of the computer's memory: of a longer file, frames that were read one after the other do not stay in it.
Chosen: what is read once displaces nothing; room that is used again and again costs the system least."""


class StoredFrames:
    """Frames of a file, whose pixels are stored as they are.

    Safe to read from several threads.

    Parameters
    ----------
    path : pathlib.Path
        File.
    shape : tuple of int
        (rows, cols) of a frame.
    dtype : numpy.dtype
        Of the pixels, as stored.
    offset : int
        Of the first frame, bytes.
    stride : int, optional
        Bytes from frame to frame; those of a frame by default.
    """

    def __init__(
        self, path: Path, shape: tuple[int, ...], dtype: DTypeLike, offset: int, stride: int | None = None
    ) -> None:
        import psutil

        self._path = path
        self._file: io.FileIO | None = _open_while_used(path)
        self._shape, self._dtype, self._offset = shape, np.dtype(dtype), offset
        self._frame_bytes = int(np.prod(shape, dtype=np.int64)) * self._dtype.itemsize
        self._stride = self._frame_bytes if stride is None else stride
        self._is_long = path.stat().st_size > MAX_CACHED_PART * psutil.virtual_memory().total
        self._successive = range(0)

    def frame(self, index: int) -> NDArray[Any]:
        """Return frame `index`, (rows, cols), as stored, in memory of its own.

        Raises
        ------
        EOFError
            If the file was cut meanwhile.
        InputError
            If it was closed.
        """
        file = self._opened()
        if self._is_long:
            self._release_before(index, file)
        frame = np.empty(self._shape, self._dtype)
        read_at(file, self._offset + index * self._stride, frame)
        return frame

    def scattered(self, places: range, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return small arrays that lie far apart in the file, (len(places), *shape).

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
        InputError
            If it was closed.
        """
        file = self._opened()
        arrays = np.empty((len(places), *shape), dtype)
        if sys.platform == "linux":  # asked for all of them beforehand, a disk need not wait for each
            for place in places:
                os.posix_fadvise(file.fileno(), place, arrays[0].nbytes, os.POSIX_FADV_WILLNEED)
        for place, array in zip(places, arrays, strict=True):
            read_at(file, place, array)
        return arrays

    def _release_before(self, index: int, file: io.FileIO) -> None:
        """Release the successive frames up to one that is read next from the system's memory, if they are many."""
        before = self._successive
        successive = range(before.start if index in (before.stop - 1, before.stop) else index, index + 1)
        if len(successive) * self._frame_bytes > RELEASED_BYTES:
            if sys.platform == "linux":
                start, read = self._offset + successive.start * self._stride, (len(successive) - 1) * self._stride
                os.posix_fadvise(file.fileno(), start, read, os.POSIX_FADV_DONTNEED)
            successive = range(index, index + 1)
        self._successive = successive

    def _opened(self) -> io.FileIO:
        if self._file is None:
            raise InputError(f"{self._path.name} is closed", "open it again")
        return self._file

    def close(self) -> None:
        """Close the file, as soon as no other thread reads it."""
        self._file = None


def _open_while_used(path: Path) -> io.FileIO:
    """Open a file for reading; it is closed when nothing refers to the object any more.

    Closed while another thread reads it, its number would be that of the file that is opened next, whose bytes the
    thread would then read.
    """
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0))
    file = io.FileIO(descriptor, closefd=False)
    finalize(file, os.close, descriptor)
    return file
