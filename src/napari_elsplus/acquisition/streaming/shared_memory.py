"""Rings and other segments in shared memory: readers attach without owning, and what a killed owner left is swept."""

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

from napari_elsplus.acquisition.streaming.ring import Ring
from napari_elsplus.errors import DeviceError

if TYPE_CHECKING:
    from napari_elsplus.acquisition.streaming.ring import Layout

_PREFIX: Final = "elsplus"
_LEFT_TO_OTHERS: Final = 8 << 20
_FOLDER: Final = Path("/dev/shm")  # only Linux shows its segments; elsewhere there is nothing to list


def create(nbytes: int, name: str | None = None) -> SharedMemory:
    """Make a segment that belongs to this process, all zero; its name says whose it is.

    Parameters
    ----------
    nbytes : int
        Its size.
    name : str, optional
        The name of another of this process's segments, and something more; a new one by default.

    Raises
    ------
    DeviceError
        If there is less shared memory left: writing to it would end the process.
    """
    if _FOLDER.is_dir() and (left := shutil.disk_usage(_FOLDER).free) < nbytes + _LEFT_TO_OTHERS:
        raise DeviceError(
            f"{left >> 20} MB of shared memory are left, {nbytes >> 20} MB are wanted",
            f"clear the mosaic, or let the system give {_FOLDER} more",
        )
    return SharedMemory(name or f"{_PREFIX}-{os.getpid()}-{token_hex(4)}", create=True, size=nbytes)


def attach(name: str) -> SharedMemory:
    """Look into another process's segment; when this process ends, the segment stays.

    Raises
    ------
    FileNotFoundError
        If it is gone.
    """
    if sys.version_info >= (3, 13):
        return SharedMemory(name, track=False)
    segment = SharedMemory(name)
    if os.name == "posix":  # before 3.13 an attacher's exit deletes the segment, unless the tracker forgets it
        resource_tracker.unregister(f"/{segment.name}", "shared_memory")
    return segment


class SharedRing(Ring):
    """A ring in shared memory: made by its owner, attached to by readers in other processes.

    Parameters
    ----------
    segment : SharedMemory
        Where it lies; closed with the ring.
    layout : Layout
        The same on every side.
    owned : bool
        Whether the segment is deleted with the ring.
    """

    def __init__(self, segment: SharedMemory, layout: Layout, *, owned: bool) -> None:
        super().__init__(segment.buf, layout)
        self._segment, self._owned = segment, owned

    @classmethod
    def create(cls, layout: Layout) -> SharedRing:
        """Make a ring that belongs to this process."""
        return cls(create(layout.nbytes), layout, owned=True)

    @classmethod
    def attach(cls, name: str, layout: Layout) -> SharedRing:
        """Look into another process's ring.

        Raises
        ------
        FileNotFoundError
            If it is gone.
        """
        return cls(attach(name), layout, owned=False)

    @property
    def name(self) -> str:
        """By which others attach."""
        return self._segment.name

    def close(self) -> None:
        """Let go of the memory; the owner deletes it."""
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
        if owner.isdecimal() and not _alive(int(owner)):
            with suppress(FileNotFoundError, PermissionError):
                path.unlink()
                gone.append(path.name)
    return gone


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
