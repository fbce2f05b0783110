"""Processor time, by thread, and memory of the engine's process; its age."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import psutil

NATIVE: Final = "native"
"""Name for threads that Python has not started, those of gRPC for instance."""
_STATUS = Path("/proc/self/status")


@dataclass(frozen=True, slots=True)
class Usage:
    """Resources of one process, at one moment.

    Parameters
    ----------
    cpu_s : float
        Processor time of all its threads since it began.
    memory_mb : float
        Memory in use, shared rings included, mapped files not; these only on Linux, which counts them apart.
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
    return float(psutil.Process().memory_info().rss) / (1 << 20)


def thread_times_s() -> dict[str, float]:
    """Return the processor time of each thread of this process, in seconds since it began, by the thread's name.

    The system counts in steps of some milliseconds. Threads of the same name are summed.
    """
    names = {thread.native_id: thread.name for thread in threading.enumerate()}
    times: dict[str, float] = {}
    for thread in psutil.Process().threads():
        name = names.get(thread.id, NATIVE)
        times[name] = times.get(name, 0.0) + thread.user_time + thread.system_time
    return times


def process_age_s() -> float:
    """Return the seconds since this process was created."""
    return time.time() - float(psutil.Process().create_time())
