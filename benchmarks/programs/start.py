"""Starting times, each start a process of its own: ``python3 run.py bench start``.

With ``--against`` another checkout of the project is measured in turn with this one.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import click
import numpy as np
from rich.progress import track

from benchmarks.harness.table import results_in, write_rows
from napari_elsplus.cli.options import FILE, force_option

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

HERE: Final = Path(__file__).resolve().parents[2]
COMMAND_LINE: Final = (sys.executable, "-c", "from napari_elsplus.cli import main; main()")
IMPORT: Final = "import time; t = time.perf_counter(); import napari_elsplus; print(time.perf_counter() - t)"
FRAMES: Final = 24
"""Frames of the recording of which a mosaic is made; chosen: the start takes most of the time."""


class Checkout:
    """A checkout of the project, started in a folder of its own.

    Parameters
    ----------
    source : Path
        The checkout.
    folder : Path
        For caches and files.
    """

    def __init__(self, source: Path, folder: Path) -> None:
        self.folder = folder
        folder.mkdir()
        own = {"ELSPLUS_CACHE": "cache", "ELSPLUS_CONFIG": "config"}
        self._environment = {
            **os.environ,
            "PYTHONPATH": str(source / "src"),
            **{name: str(folder / place) for name, place in own.items()},
        }
        self.recording, self.calibration = folder / "raw.ome.tif", folder / "raw.calibration.json"

    def run(self, *command: str, code: int = 0, **more: str) -> str:
        """Run a command that ends with an exit code, more in its environment; return what it prints."""
        ended = subprocess.run(command, capture_output=True, text=True, env={**self._environment, **more}, check=False)
        if ended.returncode != code:
            raise RuntimeError(f"{command[-1]} exited with {ended.returncode}: {ended.stderr[-300:]}")
        return ended.stdout

    def elsplus(self, *arguments: str, code: int = 0, **more: str) -> float:
        """Run the command line; return the seconds from the process' start to its end."""
        begun_s = time.perf_counter()
        self.run(*COMMAND_LINE, *arguments, code=code, **more)
        return time.perf_counter() - begun_s

    def simulate(self) -> None:
        """Simulate the recording of which mosaics are made, once."""
        if not self.recording.exists():
            files = ("--frames", str(FRAMES), "-o", str(self.recording))
            self.elsplus("simulate", "recording", "--preset", "240hz", "--scene", "fibres", "--path", "hand", *files)


def _import(here: Checkout) -> float:
    return float(here.run(sys.executable, "-c", IMPORT))


def _help(here: Checkout) -> float:
    return here.elsplus("--help")


def _wrong_option(*command: str) -> Callable[[Checkout], float]:
    return lambda here: here.elsplus(*command, "--wrong", code=2)


def _first_frame(here: Checkout, *more: str) -> float:
    report = here.folder / "report.json"
    here.elsplus("acquire", "--seconds", "0.5", "--report", str(report), "--force", *more)
    return float(json.loads(report.read_text("utf-8"))["started_s"])


def _first_tracked(here: Checkout) -> float:
    return _first_frame(here, "--track", str(here.folder / "track.csv"))


def _mosaic(here: Checkout, kernels: str = "") -> float:
    here.simulate()
    output = here.folder / "mosaic.ome.tif"
    files = (str(here.recording), "-c", str(here.calibration), "-o", str(output))
    return here.elsplus("mosaic", *files, "--force", NUMBA_CACHE_DIR=kernels)


def _fresh_mosaic(here: Checkout) -> float:
    here.simulate()
    with tempfile.TemporaryDirectory(dir=here.folder) as kernels:
        return _mosaic(here, kernels)


def _installed_mosaic(here: Checkout) -> float:
    """Compile kernels as `run.py` does on installation, then make the first mosaic: none is left to compile."""
    here.simulate()
    with tempfile.TemporaryDirectory(dir=here.folder) as kernels:
        raw, calibration, track, report, mosaic = (
            str(here.folder / name)
            for name in ("live.ome.tif", "live.calibration.json", "live.csv", "report.json", "mosaic.ome.tif")
        )
        files = ("--record", raw, "--track", track, "--report", report)
        here.elsplus("acquire", "--seconds", "1", *files, "--force", NUMBA_CACHE_DIR=kernels)
        here.elsplus("mosaic", raw, "-c", calibration, "-o", mosaic, "--force", NUMBA_CACHE_DIR=kernels)
        return _mosaic(here, kernels)


class Start(NamedTuple):
    """A way to start the software, and the time within which it should.

    Parameters
    ----------
    name : str
        What is started.
    goal_s : float
        Seconds.
    measure : callable
        Starts it in a checkout, and returns the seconds that it took.
    slow : bool
        Takes tens of seconds: started a third as often.
    """

    name: str
    goal_s: float
    measure: Callable[[Checkout], float]
    slow: bool = False


STARTS: Final = (
    Start("import napari_elsplus", 0.1, _import),
    Start("napari-elsplus --help", 0.4, _help),
    Start("a wrong option, process", 0.4, _wrong_option("process")),
    Start("a wrong option, simulate", 0.4, _wrong_option("simulate", "recording")),
    Start("a wrong option, calibrate", 0.4, _wrong_option("calibrate")),
    Start("acquire, first frame", 4.0, _first_frame),
    Start("acquire with a track, first frame", 4.0, _first_tracked),
    Start(f"mosaic of {FRAMES} frames", 4.0, _mosaic),
    Start("the same, first after run.py installed", 6.0, _installed_mosaic, slow=True),
    Start("the same, kernels to be compiled", 6.0, _fresh_mosaic, slow=True),
)


def measure(
    starts: Sequence[Start], checkouts: Mapping[str, Checkout], times: int
) -> dict[tuple[str, str], list[float]]:
    """Return the seconds of each start by its name and the checkout's; the first of each fills caches, uncounted.

    Parameters
    ----------
    starts : sequence of Start
        What is started.
    checkouts : mapping of str to Checkout
        Started in turn.
    times : int
        How often each is started.
    """
    taken: dict[tuple[str, str], list[float]] = {}
    for turn in track(range(times + 1), description="Starting", transient=True):
        for start in starts:
            last = -(-times // 3) if start.slow else times
            for name, checkout in checkouts.items():
                if turn <= last and (turn or not start.slow):
                    seconds = start.measure(checkout)
                    taken.setdefault((start.name, name), []).extend([seconds] if turn else [])
    return taken


@click.command(name="start")
@click.option("--out", type=FILE, required=True, help="Folder for start.csv.")
@click.option("--times", type=click.IntRange(1), default=10, show_default=True, help="How often each is started.")
@click.option("--only", default="", help="Start only what has this word in its name.")
@click.option("--against", type=FILE, help="Another checkout of the project, started in turn with this one.")
@force_option
def start(out: Path, times: int, only: str, against: Path | None, force: bool) -> None:
    """Measure how long import, help, live images and the first mosaic take to start."""
    (table,) = results_in(out, "start.csv", force=force)
    chosen = [each for each in STARTS if only in each.name]
    sources = {"here": HERE, **({} if against is None else {"against": against.resolve()})}
    with tempfile.TemporaryDirectory() as folder:
        taken = measure(chosen, {name: Checkout(path, Path(folder, name)) for name, path in sources.items()}, times)
    goals = {each.name: each.goal_s for each in chosen}
    rows = []
    for (name, checkout), seconds in taken.items():
        goal_s, median_s, fastest_s, slowest_s = goals[name], float(np.median(seconds)), min(seconds), max(seconds)
        numbers = (f"{number:.3f}" for number in (goal_s, median_s, fastest_s, slowest_s))
        rows.append((name, checkout, *numbers, len(seconds)))
        click.echo(f"{name:38} {checkout:8} {median_s:6.2f} s ({fastest_s:.2f} to {slowest_s:.2f}), goal {goal_s:g}")
    titles = ("start", "checkout", "goal_s", "median_s", "fastest_s", "slowest_s", "times")
    write_rows(table, titles, rows, force=force)
