"""Description of the machine of a measurement, and memory of a process on it."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path

import psutil

LIBRARIES = ("numpy", "opencv-contrib-python-headless", "numba", "scikit-image")


def machine() -> str:
    """Processor, cores, system and library versions in one line."""
    libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    return (
        f"{_processor()}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}, {libraries}"
    )


def cpu_s(process: psutil.Process) -> float:
    """Return the processor time of all threads of a process, seconds."""
    times = process.cpu_times()
    return float(times.user + times.system)


def memory_mb(process: psutil.Process | None = None) -> float:
    """Memory of a process (this one by default) that no file maps, rings shared with others included, MB."""
    process = process or psutil.Process()
    status = Path(f"/proc/{process.pid}/status")
    if not status.exists():  # where the system is not Linux, files are counted, too
        return float(process.memory_info().rss) / (1 << 20)
    fields = dict(line.split(":", 1) for line in status.read_text(encoding="ascii").splitlines() if ":" in line)
    return sum(int(fields[name].split()[0]) for name in ("RssAnon", "RssShmem")) / 1024


def _processor() -> str:
    """Return the processor's trade name where the system tells it, else its architecture."""
    facts = Path("/proc/cpuinfo")
    if facts.is_file():
        for line in facts.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return " ".join(line.partition(":")[2].split())
    return platform.processor() or platform.machine()
