"""Processor time of the engine's process, by thread; its age."""

from __future__ import annotations

import threading
import time
from typing import Final

import psutil

NATIVE: Final = "native"
"""Name for threads that Python has not started, those of gRPC for instance."""


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
