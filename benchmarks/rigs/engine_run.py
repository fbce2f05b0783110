"""An engine run for some time and measured: lateness, losses, processor time, memory."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import psutil

from benchmarks.harness.machine import cpu_s, memory_mb
from napari_elsplus.acquisition.engine.live_images import RAW

if TYPE_CHECKING:
    from collections.abc import Callable

    from benchmarks.rigs.engines import Apart, Here
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
    """

    status: Status
    cpu_s: float
    measured_s: float
    memory_mb: np.ndarray[Any, np.dtype[np.float64]]

    @property
    def cpu_us_per_frame(self) -> float:
        """Processor time for each frame, microseconds."""
        return 1e6 * self.cpu_s / (self.measured_s * self.status.mean_hz)

    @property
    def lost(self) -> int:
        """Frames lost, by whatever cause."""
        return sum(self.status.dropped.values())


def run_engine(
    engine: Here | Apart,
    seconds: float,
    *,
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
    settle_s : float
        How long to wait before processor time and memory are measured.
    between : callable
        What else whoever looks on has to do after each look.
    """
    with engine:
        engine.begin()
        watched = _Look(engine, between)
        watched.go_on(settle_s)
        process = psutil.Process(engine.pid)
        before_s, begin_s = cpu_s(process), time.perf_counter()
        memory = [memory_mb(process)]
        while (left_s := begin_s + seconds - time.perf_counter()) > 0:
            watched.go_on(min(left_s, _MEMORY_EVERY_S))
            memory.append(memory_mb(process))
        spent_s, end_s = cpu_s(process) - before_s, time.perf_counter()
        engine.end()
        status = engine.outcome()
    return EngineRun(status, spent_s, end_s - begin_s, np.array(memory))


class _Look:
    """Whoever looks on: copies LS and ELS+ as a window does."""

    def __init__(self, engine: Here | Apart, between: Callable[[], None]) -> None:
        self._engine, self._between = engine, between
        self._sequence = -1
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
            self._sequence = stamp.sequence
