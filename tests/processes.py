"""What tests ask of processes."""

from __future__ import annotations

import os
from pathlib import Path


def exists(pid: int) -> bool:
    """Whether there is a process of that number."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def runs(pid: int) -> bool:
    """Whether a process of that number runs; one that has ended does not, also where its parent has not asked yet."""
    stat = Path(f"/proc/{pid}/stat")
    try:
        return exists(pid) and not (stat.parents[1].is_dir() and stat.read_text().split()[2] == "Z")
    except FileNotFoundError:
        return False


def segments(pid: int) -> list[Path]:
    """Segments of shared memory that a process of that number made."""
    return list(Path("/dev/shm").glob(f"elsplus-{pid}-*"))
