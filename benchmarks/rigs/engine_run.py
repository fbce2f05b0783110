"""An engine run for some time and measured: lateness, losses, processor time, memory."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import psutil

from napari_elsplus.acquisition.engine.live_images import RAW
from napari_elsplus.acquisition.streaming.recorder import RecordingPlan

if TYPE_CHECKING:
    from collections.abc import Callable

    from benchmarks.rigs.engines import Driven
    from napari_elsplus.acquisition.engine.status import Status
    from napari_elsplus.acquisition.streaming.ring import Ring

LOOK_S: Final = 1 / 60
SETTLE_S: Final = 3.0
"""Left out of processor time and memory: what a stream needs once."""
_MEMORY_EVERY_S: Final = 1.0


@dataclass(frozen=True)
class EngineRun:
    """Result of a run of the engine.

    Parameters
    ----------
    status : Status
        At the end.
    cpu_s : float
        Processor time of the engine's process, simulator included, while it was measured.
    measured_s : float
        How long that was.
    memory_mb : numpy.ndarray
        Once a second.
    looks : int
        How many different frames whoever looked on has seen while it was measured.
    """

    status: Status
    cpu_s: float
    measured_s: float
    memory_mb: np.ndarray[Any, np.dtype[np.float64]]
    looks: int

    @property
    def cpu_us_per_frame(self) -> float:
        """Processor time for each frame, microseconds."""
        return 1e6 * self.cpu_s / (self.measured_s * self.status.mean_hz)

    @property
    def growth_percent(self) -> float:
        """Memory in the last tenth of the run against the first, percent."""
        tenth = max(1, len(self.memory_mb) // 10)
        return 100 * float(np.median(self.memory_mb[-tenth:]) / np.median(self.memory_mb[:tenth]) - 1)

    @property
    def lost(self) -> int:
        """Frames lost, by whatever cause."""
        return sum(self.status.dropped.values())


def run_engine(
    engine: Driven,
    seconds: float,
    *,
    record: Path | None = None,
    settle_s: float = SETTLE_S,
    between: Callable[[], None] = lambda: None,
) -> EngineRun:
    """Stream for some time, looking at the newest images 60 times a second.

    Parameters
    ----------
    engine : Here or Apart
        Ready; closed afterwards.
    seconds : float
        How long, after it has settled.
    record : Path, optional
        Record into that file, too, the two seconds before included.
    settle_s : float
        How long to wait before processor time and memory are measured.
    between : callable
        What else whoever looks on has to do after each look.
    """
    plan = None if record is None else RecordingPlan(record, earlier_s=2.0, force=True)
    with engine:
        engine.begin(plan)
        watched = _Look(engine, between)
        watched.go_on(settle_s)
        watched.seen = 0
        process = psutil.Process(engine.pid)
        before_s, begin_s = _cpu_s(process), time.perf_counter()
        memory = [_memory_mb(process)]
        while (left_s := begin_s + seconds - time.perf_counter()) > 0:
            watched.go_on(min(left_s, _MEMORY_EVERY_S))
            memory.append(_memory_mb(process))
        cpu_s, end_s = _cpu_s(process) - before_s, time.perf_counter()
        engine.end()
        status = engine.outcome()
    return EngineRun(status, cpu_s, end_s - begin_s, np.array(memory), watched.seen)


def _cpu_s(process: psutil.Process) -> float:
    """Return the processor time of all threads of a process, seconds."""
    times = process.cpu_times()
    return float(times.user + times.system)


def _memory_mb(process: psutil.Process) -> float:
    """Return memory in use in MB, shared rings included; mapped files only where the system is not Linux."""
    status = Path(f"/proc/{process.pid}/status")
    if status.exists():
        fields = dict(line.split(":", 1) for line in status.read_text(encoding="ascii").splitlines() if ":" in line)
        return sum(int(fields[name].split()[0]) for name in ("RssAnon", "RssShmem")) / 1024
    return float(process.memory_info().rss) / (1 << 20)


class _Look:
    """Whoever looks on: copies LS and ELS+ as a window does."""

    def __init__(self, engine: Driven, between: Callable[[], None]) -> None:
        self._engine, self._between = engine, between
        self._sequence, self.seen = -1, 0
        self._out: dict[str, Any] = {}

    def go_on(self, seconds: float) -> None:
        until_s = time.perf_counter() + seconds
        while (now_s := time.perf_counter()) < until_s:
            ring = self._engine.ring()
            if ring is not None:
                self._copy(ring)
            self._between()
            time.sleep(max(0.0, min(now_s + LOOK_S, until_s) - time.perf_counter()))

    def _copy(self, ring: Ring) -> None:
        fields = [field for field in ring.layout.fields if field[0] != RAW]
        if self._out.keys() != {name for name, _, _ in fields}:
            self._out = {name: np.empty(shape, dtype) for name, shape, dtype in fields}
        stamp = ring.newest_after(self._sequence, self._out)
        if stamp is not None:
            self._sequence, self.seen = stamp.sequence, self.seen + 1
