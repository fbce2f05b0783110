"""Lateness, losses and processor time of ``acquire``, each run a process of its own: ``python3 run.py bench acquire``.

For a machine with nothing else on it: how late threads wake that have nothing to do with the engine is printed beside.
There is one on each core, of a higher priority than the engine where the system allows it, so that what delays them is
the machine alone: a virtual one stops a core at times. Their delays while the rig is calibrated do not count.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from itertools import product
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, Final

import click
import numpy as np

from benchmarks.harness.table import results_in, write_rows
from benchmarks.programs.start import COMMAND_LINE, HERE
from napari_elsplus.cli.options import FILE, force_option

if TYPE_CHECKING:
    from collections.abc import Iterator

WAKE_S: Final = 0.004
"""Interval of the thread that only wakes: about a frame period at 240 Hz."""
MAIN_THREAD: Final = "MainThread"
"""Thread of ``acquire`` itself: before the stream it starts the rig, and then sleeps."""
WAKE_PRIORITY: Final = 50
"""Real-time priority of that thread; chosen: above the engine's, below that of the system's own threads."""
RECORDING: Final = ("recorder", "recording-flush")
"""Threads of a recording: one writes, the other flushes."""
SMALL_US: Final = 5.0
"""Threads that take less for a frame are not printed; chosen."""
TITLES: Final = (
    "run", "frames", "lost", "median_ms", "p99_ms", "largest_ms", "wake_p99_ms", "wake_largest_ms",
    "engine_us_per_frame", "recorder_us_per_frame", "simulator_us_per_frame", "started_s", "load", "causes",
)  # fmt: skip


class _Wakes(Thread):
    """Wakes every few milliseconds on a core, and measures how late."""

    def __init__(self, core: int | None) -> None:
        super().__init__(name="wakes", daemon=True)
        self._core = core
        self._wakes_s: list[tuple[float, float]] = []
        self._ended = Event()

    def run(self) -> None:
        """Wake until :meth:`end`."""
        if sys.platform == "linux":
            if self._core is not None:
                os.sched_setaffinity(0, {self._core})
            with suppress(PermissionError):
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(WAKE_PRIORITY))
        due_s = time.perf_counter()
        while not self._ended.is_set():
            due_s = max(due_s + WAKE_S, time.perf_counter())
            time.sleep(max(0.0, due_s - time.perf_counter()))
            self._wakes_s.append((due_s, time.perf_counter() - due_s))

    def end(self, begin_s: float, end_s: float) -> list[float]:
        """End, and return the lateness of each wake between two times, in seconds."""
        self._ended.set()
        self.join()
        return [late_s for due_s, late_s in self._wakes_s if begin_s <= due_s < end_s]


def _cores() -> list[int | None]:
    """Return the cores of this process; None, for any, where the system does not tell them apart."""
    return [*os.sched_getaffinity(0)] if sys.platform == "linux" else [None]


@contextmanager
def _busy_core(busy: bool) -> Iterator[None]:
    """Keep one core busy with an ordinary process."""
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"]) if busy else None
    try:
        yield
    finally:
        if process is not None:
            process.kill()
            process.wait()


def _command(folder: Path, seconds: float, report: Path, images: bool) -> list[str]:
    """Return the command that streams: `acquire`, or with images displayed, which it has none of."""
    recording = folder / "raw.ome.tif"
    if images:
        return [sys.executable, "-m", "benchmarks.rigs.displayed", str(seconds), str(recording), str(report)]
    files = {"--report": report, "--record": recording, "--mosaic": folder / "mosaic.ome.tif"}
    options = [word for option, file in files.items() for word in (option, str(file))]
    return [*COMMAND_LINE, "acquire", "--seconds", str(seconds), *options, "--force"]


def _run(folder: Path, seconds: float, busy: bool, images: bool) -> dict[str, Any]:
    report = folder / "report.json"
    wakes = [_Wakes(core) for core in _cores()]
    with _busy_core(busy):
        for each in wakes:
            each.start()
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(HERE / "src"), str(HERE)))}
        begun_s = time.perf_counter()
        subprocess.run(_command(folder, seconds, report, images), check=True, capture_output=True, env=environment)
    result: dict[str, Any] = json.loads(report.read_text("utf-8"))
    first_s = begun_s + result["started_s"]
    late_ms = [1e3 * late_s for each in wakes for late_s in each.end(first_s, first_s + seconds)]
    return {**result, "wakes_ms": (float(np.quantile(late_ms, 0.99)), max(late_ms))}


def _row(name: str, result: dict[str, Any]) -> tuple[str, ...]:
    frames, latency = result["frames"], result["latency_ms"]
    threads: dict[str, float] = result["cpu_us_per_frame"]
    simulator = sum(us for thread, us in threads.items() if thread.startswith("simulated "))
    engine = sum(us for thread, us in threads.items() if thread != MAIN_THREAD) - simulator
    recorder = sum(threads.get(thread, 0.0) for thread in RECORDING)
    numbers = (
        latency["p50"], latency["p99"], latency["max"], *result["wakes_ms"], engine, recorder, simulator,
        result["started_s"], os.getloadavg()[0],
    )  # fmt: skip
    counts = str(frames["acquired"]), str(sum(frames["dropped"].values()))
    causes = "; ".join(f"{count} {cause}" for cause, count in frames["dropped"].items())
    return name, *counts, *(f"{each:.2f}" for each in numbers), causes or "-"


@click.command(name="acquire")
@click.option("--out", type=FILE, required=True, help="Folder for acquire.csv.")
@click.option("--runs", type=click.IntRange(1), default=5, show_default=True, help="Runs of each kind.")
@click.option("--seconds", type=float, default=60.0, show_default=True, help="Seconds of each.")
@click.option("--images", is_flag=True, help="Display LS, residual and ELS+ at 60 Hz, beside.")
@force_option
def acquire(out: Path, runs: int, seconds: float, images: bool, force: bool) -> None:
    """Record and insert into a mosaic at 240 Hz, alone and beside a busy core; tabulate lateness and processor time."""
    (table,) = results_in(out, "acquire.csv", force=force)
    rows: list[tuple[str, ...]] = []
    threads: list[dict[str, float]] = []
    click.echo("  ".join(TITLES))
    for busy, run in product((False, True), range(runs)):
        with tempfile.TemporaryDirectory(dir=out) as folder:
            result = _run(Path(folder), seconds, busy, images)
        threads.append(result["cpu_us_per_frame"])
        rows.append(_row(f"{'beside a busy core' if busy else 'alone'}, {run + 1}", result))
        click.echo("  ".join(rows[-1]))
    write_rows(table, TITLES, rows, force=force)
    names = sorted({name for spent in threads for name in spent})
    medians = {name: float(np.median([spent.get(name, 0.0) for spent in threads])) for name in names}
    shown = (f"{name} {us:.0f}" for name, us in medians.items() if us >= SMALL_US)
    click.echo(f"microseconds a frame by thread, medians: {', '.join(shown)}")
