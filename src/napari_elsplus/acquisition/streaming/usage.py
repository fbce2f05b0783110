"""Processor time and memory of the engine's process."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

_STATUS = Path("/proc/self/status")


@dataclass(frozen=True, slots=True)
class Usage:
    """Resources of one process, at one moment.

    Parameters
    ----------
    cpu_s : float
        Processor time of all its threads since it began.
    memory_mb : float
        Memory in use, shared rings included, mapped files not; on macOS the largest value so far; NaN on Windows.
    """

    cpu_s: float
    memory_mb: float


def usage() -> Usage:
    """Return the processor time and memory of this process."""
    return Usage(time.process_time(), _memory_mb())


def _memory_mb() -> float:
    if _STATUS.exists():
        fields = dict(line.split(":", 1) for line in _STATUS.read_text(encoding="ascii").splitlines() if ":" in line)
        return sum(int(fields[name].split()[0]) for name in ("RssAnon", "RssShmem")) / 1024
    if sys.platform == "win32":
        return float("nan")
    import resource

    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / (1 << 20) if sys.platform == "darwin" else most / 1024
