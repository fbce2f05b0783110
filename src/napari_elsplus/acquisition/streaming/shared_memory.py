"""Rings and other segments in shared memory: readers attach without owning; segments of killed owners are swept."""

from __future__ import annotations

import os
import shutil
import sys
from contextlib import suppress
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from secrets import token_hex
from typing import TYPE_CHECKING, Final

import psutil

from napari_elsplus.acquisition.streaming.ring import Ring
from napari_elsplus.errors import DeviceError

if TYPE_CHECKING:
    from napari_elsplus.acquisition.streaming.ring import Layout

_PREFIX: Final = "elsplus"
_RESERVE_BYTES: Final = 8 << 20
"""Chosen: bytes of shared memory that stay free for other programs."""
_FOLDER: Final = Path("/dev/shm")  # only Linux lists its segments


def create(nbytes: int, name: str | None = None) -> SharedMemory:
    """Make a segment that belongs to this process, all zero, its memory reserved.

    Parameters
    ----------
    nbytes : int
        Its size.
    name : str, optional
        The name of another of this process's segments with a suffix; a new one by default.

    Raises
    ------
    DeviceError
        If there is less shared memory left: writing to it would end the process.
    """
    left = shutil.disk_usage(_FOLDER).free if _FOLDER.is_dir() else sys.maxsize
    short = DeviceError(
        f"{left >> 20} MB of shared memory are left, {nbytes >> 20} MB are needed",
        f"clear the mosaic, or give {_FOLDER} more",
    )
    if left < nbytes + _RESERVE_BYTES:
        raise short
    segment = SharedMemory(name or f"{_PREFIX}-{os.getpid()}-{token_hex(4)}", create=True, size=nbytes)
    if sys.platform == "linux":
        import fcntl

        descriptor = segment._fd  # type: ignore[attr-defined]  # noqa: SLF001 - open until the segment is closed
        try:
            os.posix_fallocate(descriptor, 0, nbytes)
        except OSError:
            segment.close()
            segment.unlink()
            raise short from None
        fcntl.flock(descriptor, fcntl.LOCK_SH)  # released by the system when this process ends, however it ends
    return segment


def attach(name: str) -> SharedMemory:
    """Attach to another process's segment by name; when this process ends, the segment stays.

    Raises
    ------
    FileNotFoundError
        If there is none.
    """
    if sys.version_info >= (3, 13):
        return SharedMemory(name, track=False)
    segment = SharedMemory(name)
    if os.name == "posix":  # before 3.13 an attacher's exit deletes the segment, unless the tracker drops it
        resource_tracker.unregister(f"/{segment.name}", "shared_memory")
    return segment


class SharedRing(Ring):
    """A ring in shared memory: made by its owner, attached to by readers in other processes.

    Parameters
    ----------
    segment : SharedMemory
        Its memory; closed with the ring.
    layout : Layout
        The same on every side.
    owned : bool
        Delete the segment with the ring.
    """

    def __init__(self, segment: SharedMemory, layout: Layout, *, owned: bool) -> None:
        super().__init__(segment.buf, layout)
        self._segment, self._owned = segment, owned
        self.name = segment.name

    @classmethod
    def create(cls, layout: Layout) -> SharedRing:
        """Make a ring of a layout that belongs to this process."""
        return cls(create(layout.nbytes), layout, owned=True)

    @classmethod
    def attach(cls, name: str, layout: Layout) -> SharedRing:
        """Attach to another process's ring by name and layout.

        Raises
        ------
        FileNotFoundError
            If there is none.
        """
        return cls(attach(name), layout, owned=False)

    def close(self) -> None:
        """Release the memory once no reader copies from it; the owner deletes it. Does nothing the second time."""
        if self._closed:
            return
        super().close()
        self._segment.close()
        if self._owned:
            self._segment.unlink()


def sweep() -> list[str]:
    """Delete the segments of owners that are no more.

    Returns
    -------
    list of str
        Names of the deleted segments.
    """
    gone = []
    for path in _FOLDER.glob(f"{_PREFIX}-*-*") if _FOLDER.is_dir() else ():
        owner = path.name.split("-")[1]
        if owner.isdecimal() and not psutil.pid_exists(int(owner)) and not _locked(path):
            with suppress(FileNotFoundError, PermissionError):
                path.unlink()
                gone.append(path.name)
    return gone


def _locked(path: Path) -> bool:
    """Return True if its owner lives, also where another container counts processes of its own."""
    if sys.platform == "linux":
        import fcntl

        with suppress(FileNotFoundError), path.open("rb") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                return True
    return False
