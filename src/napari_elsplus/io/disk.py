"""Writing at an offset, and past the system's memory, which Python's files do not offer."""

from __future__ import annotations

import errno
import mmap
import os
import sys
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.closing import ClosedOnExit

if TYPE_CHECKING:
    import io
    from pathlib import Path

    from numpy.typing import NDArray

BLOCK_BYTES: Final = 4 << 20
"""Bytes that go to the disk in one call; chosen: a millisecond of a fast disk's time."""


def write_at(file: io.FileIO, place: int, *parts: bytes | memoryview) -> None:
    """Write parts one after the other at a byte offset, in one call where the system has one.

    Parameters
    ----------
    file : io.FileIO
        Unbuffered, open for writing.
    place : int
        Offset in bytes.
    *parts : bytes or memoryview
        The system may take less than all at once; it is called again with the rest.
    """
    rest = [memoryview(part).cast("B") for part in parts]
    while rest:
        if sys.platform == "win32":
            file.seek(place)
            written = file.write(rest[0])
        else:
            written = os.pwritev(file.fileno(), rest, place)
        place += written
        while rest and written >= len(rest[0]):
            written -= len(rest.pop(0))
        if rest:
            rest[0] = rest[0][written:]


class SpanWriter(ClosedOnExit):
    """Writes successive bytes into a file, past the system's memory where the system and the file's disk allow it.

    In the system's memory a file of many gigabytes displaces what is needed, and finding room for it takes longer than
    the disk does. Whole pages go to the disk in blocks; the first and the last page of the span, which others may write
    into as well, go by the system's memory. :meth:`close` writes what is left.

    Parameters
    ----------
    path : pathlib.Path
        An existing file.
    start : int
        Offset in bytes.
    """

    def __init__(self, path: Path, start: int) -> None:
        self._file = path.open("rb+", buffering=0)
        self._direct = _open_direct(path)
        self._block = np.frombuffer(mmap.mmap(-1, BLOCK_BYTES), np.uint8)  # begins with a page, as the disk demands
        self._before = self._filled = start % mmap.PAGESIZE
        self._place = start - self._before

    def write(self, values: NDArray[Any]) -> None:
        """Write an array's bytes after those before; the array may be reused as soon as this returns.

        Parameters
        ----------
        values : numpy.ndarray
            Contiguous, of any shape and type.

        Raises
        ------
        OSError
            If the disk is full or fails.
        """
        rest = values.reshape(-1).view(np.uint8)
        while len(rest):
            taken = min(len(rest), BLOCK_BYTES - self._filled)
            self._block[self._filled : self._filled + taken] = rest[:taken]
            self._filled += taken
            rest = rest[taken:]
            if self._filled == BLOCK_BYTES:
                self._write_block()

    def close(self) -> None:
        """Write what is left and close the file."""
        try:
            if not self._file.closed:
                self._write_block()
        finally:
            self._file.close()
            if self._direct is not None:
                self._direct.close()

    def _write_block(self) -> None:
        first = mmap.PAGESIZE if self._before else 0
        last = self._filled - self._filled % mmap.PAGESIZE
        if self._direct is not None and first < last:
            self._write_pages(first, last)
            self._write_cached(self._before, first)
            self._write_cached(last, self._filled)
        else:
            self._write_cached(self._before, self._filled)
        self._place += self._filled
        self._before = self._filled = 0

    def _write_pages(self, first: int, last: int) -> None:
        """Write whole pages of the block past the system's memory, or by it if this disk refuses."""
        assert self._direct is not None
        try:
            write_at(self._direct, self._place + first, self._block[first:last].data)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTSUP):
                raise
            self._direct.close()
            self._direct = None
            self._write_cached(first, last)

    def _write_cached(self, first: int, last: int) -> None:
        if first < last:
            write_at(self._file, self._place + first, self._block[first:last].data)


def _open_direct(path: Path) -> io.FileIO | None:
    """Open a file for writing past the system's memory; return None where the system or the disk does not offer it."""
    flag = getattr(os, "O_DIRECT", 0)
    if not flag:
        return None
    try:
        return open(path, "rb+", buffering=0, opener=lambda name, flags: os.open(name, flags | flag))
    except OSError:
        return None
