"""Room on a disk; reading and writing at an offset, and past the system's memory, which Python's files do not offer."""

from __future__ import annotations

import errno
import mmap
import os
import shutil
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.closing import ClosedOnExit

if TYPE_CHECKING:
    import io
    from concurrent.futures import Future
    from pathlib import Path

    from numpy.typing import NDArray

BLOCK_BYTES: Final = 16 << 20
"""Bytes that go to the disk in one call; measured: 14,400 frames are processed in 9.5 s with 4 MB, between two of which
the disk waits for a thread to wake, in 8.8 with 8, and in 8.5 with 12 and 16 (medians of six)."""
_MOVING: Final = Lock()
"""Held while a file's position is moved and read from, where the system cannot read at an offset."""


def require_room(path: Path, nbytes: float) -> None:
    """Raise the error of a full disk before anything is written that does not fit on it.

    Parameters
    ----------
    path : pathlib.Path
        The file that will be written, in an existing folder.
    nbytes : float
        Bytes that will be written into it.

    Raises
    ------
    OSError
        ENOSPC, if fewer are free.

    Examples
    --------
    >>> from pathlib import Path
    >>> require_room(Path("els.ome.tif"), 1e21)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    OSError: [Errno 28] 1000000000000.0 GB do not fit into the ... that are free on its disk: 'els.ome.tif'
    """
    disk = shutil.disk_usage(path.parent)
    free = disk.free
    if disk.total and nbytes > free:  # some network and virtual file systems do not state their size
        problem = f"{_size(nbytes)} do not fit into the {_size(free)} that are free on its disk"
        raise OSError(errno.ENOSPC, problem, str(path))


def read_at(file: io.FileIO, place: int, out: NDArray[Any]) -> None:
    """Fill an array from a byte offset of a file; several threads may read one file.

    Parameters
    ----------
    file : io.FileIO
        Unbuffered, open for reading.
    place : int
        Offset in bytes.
    out : numpy.ndarray
        Contiguous, of any shape and type.

    Raises
    ------
    EOFError
        If the file ends before.
    """
    rest = out.reshape(-1).view(np.uint8)
    while len(rest):
        if sys.platform == "win32":
            with _MOVING:
                file.seek(place)
                read = file.readinto(rest.data)
        else:
            read = os.preadv(file.fileno(), [rest.data], place)
        if not read:
            raise EOFError(f"the file ends at byte {place}")
        place += read
        rest = rest[read:]


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
    the disk does. Bytes are copied into one block while a thread writes the block before; :meth:`close` writes the last
    and waits for both.

    Parameters
    ----------
    path : pathlib.Path
        An existing file.
    start : int
        Offset in bytes.
    """

    def __init__(self, path: Path, start: int) -> None:
        self._file = _BlockFile(path)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="disk")
        self._writing: Future[None] | None = None
        self._before = self._filled = start % mmap.PAGESIZE
        self._place = start - self._before
        self._block, self._spare = _empty_block(), _empty_block()

    def write(self, values: NDArray[Any]) -> None:
        """Write an array's bytes after those before; the array may be reused as soon as this returns.

        Parameters
        ----------
        values : numpy.ndarray
            Contiguous, of any shape and type.

        Raises
        ------
        OSError
            If the disk is full or fails, by :meth:`close` at the latest.
        """
        rest = values.reshape(-1).view(np.uint8)
        while len(rest):
            taken = min(len(rest), BLOCK_BYTES - self._filled)
            self._block[self._filled : self._filled + taken] = rest[:taken]
            self._filled += taken
            rest = rest[taken:]
            if self._filled == BLOCK_BYTES:
                self._hand_over()

    def close(self) -> None:
        """Write what is left and close the file."""
        if self._file.is_closed:
            return
        try:
            self._hand_over()
            self._wait()
        finally:
            self._thread.shutdown()
            self._file.close()

    def _hand_over(self) -> None:
        """Let the thread write the block, and go on with the other when that is written."""
        self._wait()
        self._writing = self._thread.submit(
            self._file.write, self._place, self._block[: self._filled], before=self._before
        )
        self._block, self._spare = self._spare, self._block
        self._place += self._filled
        self._before = self._filled = 0

    def _wait(self) -> None:
        written, self._writing = self._writing, None
        if written is not None:
            written.result()


class _BlockFile:
    """A file whose whole pages are written past the system's memory, or by it if its disk refuses."""

    def __init__(self, path: Path) -> None:
        self._cached = path.open("rb+", buffering=0)
        self._direct = _open_direct(path)

    @property
    def is_closed(self) -> bool:
        return self._cached.closed

    def write(self, place: int, block: NDArray[np.uint8], *, before: int) -> None:
        """Write a block, which begins with a page of the file, without the bytes `before`, which others may write.

        The first and the last page go by the system's memory if the block has only a part of them.
        """
        first = mmap.PAGESIZE if before else 0
        last = len(block) - len(block) % mmap.PAGESIZE
        if first >= last or not self._write_pages(place + first, block[first:last]):
            first = last = before
        for begin, end in ((before, first), (last, len(block))):
            if begin < end:
                write_at(self._cached, place + begin, block[begin:end].data)

    def _write_pages(self, place: int, pages: NDArray[np.uint8]) -> bool:
        """Write whole pages past the system's memory; return False if that is not to be had."""
        if self._direct is None:
            return False
        try:
            write_at(self._direct, place, pages.data)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTSUP):
                raise
            self._direct.close()
            self._direct = None
        return self._direct is not None

    def close(self) -> None:
        self._cached.close()
        if self._direct is not None:
            self._direct.close()


def _size(nbytes: float) -> str:
    """Return a number of bytes in words."""
    return f"{min(nbytes, 1e30) / 1e9:.1f} GB" if nbytes >= 1e9 else f"{nbytes / 1e6:.1f} MB"


def _empty_block() -> NDArray[np.uint8]:
    """Return a block that begins with a page of the memory, as writing past the system's memory demands."""
    return np.frombuffer(mmap.mmap(-1, BLOCK_BYTES), np.uint8)


def _open_direct(path: Path) -> io.FileIO | None:
    """Open a file for writing past the system's memory; return None where the system or the disk does not offer it."""
    flag = getattr(os, "O_DIRECT", 0)
    if not flag:
        return None
    try:
        return open(path, "rb+", buffering=0, opener=lambda name, flags: os.open(name, flags | flag))
    except OSError:
        return None
