"""Lateness, losses and processor time of ``acquire``, each run a process of its own: ``python3 run.py bench acquire``.

For a machine with nothing else on it: how late a thread wakes that has nothing to do with the engine is printed beside.
It has a higher priority than the engine, where the system allows it, so that what delays it is the machine alone.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, Final

import click
import numpy as np

from benchmarks.programs.start import COMMAND_LINE, HERE
from napari_elsplus.cli.options import FILE, force_option, refuse_outputs
from napari_elsplus.io.atomic import replacing

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
TITLES: Final = (
    "run", "frames", "lost", "median_ms", "p99_ms", "largest_ms", "wake_p99_ms", "wake_largest_ms",
    "engine_us_per_frame", "recorder_us_per_frame", "simulator_us_per_frame", "started_s", "load", "causes",
)  # fmt: skip


class _Wakes(Thread):
    """Wakes every few milliseconds, and measures how late."""

    def __init__(self) -> None:
        super().__init__(name="wakes", daemon=True)
        self.late_s: list[float] = []
        self._ended = Event()

    def run(self) -> None:
        """Wake until :meth:`end`."""
        if sys.platform == "linux":
            with suppress(PermissionError):
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(WAKE_PRIORITY))
        due_s = time.perf_counter()
        while not self._ended.is_set():
            due_s = max(due_s + WAKE_S, time.perf_counter())
            time.sleep(max(0.0, due_s - time.perf_counter()))
            self.late_s.append(time.perf_counter() - due_s)

    def end(self) -> tuple[float, float]:
        """Return the lateness, in seconds, that one wake in a hundred exceeds, and the largest."""
        self._ended.set()
        self.join()
        return float(np.quantile(self.late_s, 0.99)), max(self.late_s)


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


def _run(folder: Path, seconds: float, busy: bool) -> dict[str, Any]:
    report = folder / "report.json"
    files = {"--report": report, "--record": folder / "raw.ome.tif", "--mosaic": folder / "mosaic.ome.tif"}
    options = [word for option, file in files.items() for word in (option, str(file))]
    wakes = _Wakes()
    with _busy_core(busy):
        wakes.start()
        command = [*COMMAND_LINE, "acquire", "--seconds", str(seconds), *options, "--force"]
        environment = {**os.environ, "PYTHONPATH": str(HERE / "src")}
        subprocess.run(command, check=True, capture_output=True, env=environment)
        wakes_ms = [1e3 * late_s for late_s in wakes.end()]
    result: dict[str, Any] = json.loads(report.read_text("utf-8"))
    return {**result, "wakes_ms": wakes_ms}


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
@force_option
def acquire(out: Path, runs: int, seconds: float, force: bool) -> None:
    """Record and insert into a mosaic at 240 Hz, alone and beside a busy core; tabulate lateness and processor time."""
    table = out / "acquire.csv"
    out.mkdir(parents=True, exist_ok=True)
    refuse_outputs(table, force=force)
    with replacing(table, force=force) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(TITLES)
        click.echo("  ".join(TITLES))
        for busy in (False, True):
            for run in range(runs):
                with tempfile.TemporaryDirectory(dir=out) as folder:
                    name = f"{'beside a busy core' if busy else 'alone'}, {run + 1}"
                    row = _row(name, _run(Path(folder), seconds, busy))
                rows.writerow(row)
                click.echo("  ".join(row))
