"""Shared memory with one owner: readers attach without owning it, and what a killed owner left is swept up."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from secrets import token_hex
from typing import Final

_PREFIX: Final = "elsplus"
_FOLDER: Final = Path("/dev/shm")  # only Linux shows its segments; elsewhere there is nothing to list


def create(nbytes: int) -> SharedMemory:
    """Make a segment that belongs to this process, all zero; its name says whose it is."""
    return SharedMemory(f"{_PREFIX}-{os.getpid()}-{token_hex(4)}", create=True, size=nbytes)


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
