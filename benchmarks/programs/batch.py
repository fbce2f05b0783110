"""A batch that is killed and resumed, against single runs, and its speed by workers: ``python3 run.py bench batch``.

Recordings of the simulated rig are sectioned and made into mosaics by the command line. The batch is killed with all of
its processes as often as asked, resumed to its end, and its images, mosaics and tracks are compared, bit by bit, with
those of single runs. Then it is run anew by one worker and by two, in turn.

The ratios by the clock hold where nothing else runs. On a busy machine the processor time of the only worker over that
of the busier of two is the ratio that would be reached if each worker had a core of its own.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Final, NamedTuple

import click
import numpy as np
import psutil
import tifffile

from benchmarks.harness.machine import cpu_s
from benchmarks.harness.table import results_in, write_rows
from benchmarks.programs.start import COMMAND_LINE
from napari_elsplus.cli import main
from napari_elsplus.cli.options import FILE, force_option
from napari_elsplus.io import ImageMetadata, write_calibration, write_images
from napari_elsplus.workflows.batch.job import RECORDS
from napari_elsplus.workflows.batch.spans import SPANS
from napari_elsplus.workflows.simulated import simulate_recording

PASSES: Final = 10
"""Recordings that are cut from one long simulated one: rendering a scene anew takes longer than its frames."""
POLL_S: Final = 0.02
"""Time between looks at the records; chosen, a small part of a stage, also of a few frames."""
CPU_POLL_S: Final = 0.5
"""Time between looks at the processes, which take milliseconds of a core; chosen, a small part of a run."""
STAGES: Final = ("section", "mosaic")


class Run(NamedTuple):
    """What a run of a batch took.

    Parameters
    ----------
    wall_s : float
        From the start of the command to its end.
    start_s : float
        From its start to that of the first stage; NaN where a batch is resumed.
    end_s : float
        From the end of the last stage to that of the command; NaN without a scheduler.
    main_cpu_s : float
        Processor time of all that is no worker (scheduler, table, contact sheet, and the process that workers are
        forked from); 0 without a scheduler.
    worker_cpu_s : tuple of float
        Processor time of each worker, largest first.
    peak_mb : float
        Largest resident memory of a worker, MB.
    """

    wall_s: float
    start_s: float
    end_s: float
    main_cpu_s: float
    worker_cpu_s: tuple[float, ...]
    peak_mb: float


def simulate(folder: Path, recordings: int, frames: int) -> list[Path]:
    """Write recordings of the simulated rig with their calibrations beside them; return their paths."""
    folder.mkdir()
    paths: list[Path] = []
    calibration = simulate_recording(frames=1).calibration
    for first in range(0, recordings, PASSES):
        numbers = range(first, min(first + PASSES, recordings))
        simulated = simulate_recording(frames=frames * len(numbers), seed=600 + first)
        for place, number in enumerate(numbers):
            paths.append(folder / f"recording-{number:02d}.tif")
            cut = [simulated[place * frames + k] for k in range(frames)]
            write_images(paths[-1], cut, ImageMetadata(calibration=calibration))
            write_calibration(paths[-1].with_suffix(".calibration.json"), calibration)
    return paths


def finished(output: Path) -> dict[str, int]:
    """Return the time (ns) at which each finished stage, or span of a stage, was recorded, by the record's path."""
    records = output / RECORDS
    found: dict[str, int] = {}
    stages = (path for stage in STAGES for path in records.glob(f"*/{stage}.json"))
    for path in (*stages, *records.glob(f"*/{SPANS}/[0-9]*.json")):
        with contextlib.suppress(FileNotFoundError):  # spans whose stage has just been finished
            found[str(path.relative_to(records))] = path.stat().st_mtime_ns
    return found


class Records:
    """Records of a batch over several runs, and those that were written anew.

    Attributes
    ----------
    first_ns : dict
        Time at which each was first seen to be written, nanoseconds.
    twice : set of str
        Names of those that were written again.
    """

    def __init__(self, output: Path) -> None:
        self.output = output
        self.first_ns: dict[str, int] = {}
        self.twice: set[str] = set()

    def update(self) -> int:
        """Look at the records; return their number so far."""
        for name, at_ns in finished(self.output).items():
            if self.first_ns.setdefault(name, at_ns) != at_ns:
                self.twice.add(name)
        return len(self.first_ns)

    @property
    def stages(self) -> int:
        """Number of finished stages."""
        return sum(Path(name).stem in STAGES for name in self.first_ns)


def run_batch(source: Path, records: Records, workers: int, *, kill_at: int | None = None) -> Run:
    """Run a batch in processes of its own; kill them all once there are so many records.

    Raises
    ------
    RuntimeError
        If the batch fails, or ends before it was killed.
    """
    words = ("batch", str(source), "--mosaic", "-o", str(records.output), "--workers", str(workers))
    begun_ns, looked_s, start_s, resumed = time.time_ns(), 0.0, np.nan, records.output.exists()
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    running = psutil.Popen((*COMMAND_LINE, *words), start_new_session=True, **pipes)
    spent: dict[int, float] = {}
    main_s = peak = 0.0
    while running.poll() is None:
        if not resumed and np.isnan(start_s) and any(records.output.glob("[!.]*")):
            start_s = (time.time_ns() - begun_ns) / 1e9
        if records.update() >= (np.inf if kill_at is None else kill_at):
            os.killpg(running.pid, signal.SIGKILL)
            running.wait()
            break
        if time.perf_counter() - looked_s > CPU_POLL_S:
            looked_s = time.perf_counter()
            with contextlib.suppress(psutil.NoSuchProcess):
                main_s = cpu_s(running)
                for child in running.children(recursive=True):
                    spent[child.pid] = cpu_s(child)
                    peak = max(peak, child.memory_info().rss)
        time.sleep(POLL_S)
    ended_ns = time.time_ns()
    with running.stdout, running.stderr:
        said = (running.stdout.read() + running.stderr.read()).decode()
    if running.returncode != (0 if kill_at is None else -signal.SIGKILL):
        raise RuntimeError(f"the batch ended with {running.returncode}: {said[-500:]}")
    records.update()
    by_process_s = sorted(spent.values(), reverse=True)
    return Run(
        wall_s=(ended_ns - begun_ns) / 1e9,
        start_s=start_s,
        end_s=(ended_ns - max(records.first_ns.values())) / 1e9,
        main_cpu_s=main_s + sum(by_process_s[workers:]),
        worker_cpu_s=tuple(by_process_s[:workers]),
        peak_mb=peak / 1e6,
    )


def single_commands(path: Path, output: Path) -> list[list[str]]:
    """Return the commands that section one recording and make its mosaic."""
    output.mkdir(parents=True)
    calibration = str(path.with_suffix(".calibration.json"))
    images, mosaic, track = (str(output / name) for name in ("els.ome.tif", "mosaic.ome.tif", "track.csv"))
    return [
        ["process", str(path), "-c", calibration, "--mode", "els", "-o", images],
        ["mosaic", str(path), "-c", calibration, "-o", mosaic, "--track", track],
    ]


def differences(batch: Path, single: Path) -> list[str]:
    """Return the files of a recording whose contents are not those of single runs."""
    found = []
    for file in ("els.ome.tif", "mosaic.ome.tif"):
        one, other = (tifffile.imread(folder / file) for folder in (batch, single))
        if not (one.shape == other.shape and np.array_equal(one, other, equal_nan=True)):
            found.append(f"{batch.name}/{file}")
    if (batch / "track.csv").read_bytes() != (single / "track.csv").read_bytes():
        found.append(f"{batch.name}/track.csv")
    return found


@click.command(name="batch")
@click.option("--out", type=FILE, required=True, help="Folder for batch.csv.")
@click.option("--recordings", type=click.IntRange(2), default=40, show_default=True, help="Recordings of the batch.")
@click.option("--frames", type=click.IntRange(4), default=240, show_default=True, help="Frames of each.")
@click.option("--kills", type=click.IntRange(0), default=2, show_default=True, help="How often it is killed.")
@click.option("--rounds", type=click.IntRange(0), default=2, show_default=True, help="Runs of each number of workers.")
@click.option("--scratch", type=FILE, help="Folder for recordings and results, temporary; on a memory disk, say.")
@force_option
def batch(out: Path, recordings: int, frames: int, kills: int, rounds: int, scratch: Path | None, force: bool) -> None:
    """Kill and resume a batch, compare it with single runs, and time one worker against two."""
    (table,) = results_in(out, "batch.csv", force=force)
    rows: list[tuple[str, int, Run]] = []
    with tempfile.TemporaryDirectory(dir=scratch) as made:
        source, output, single = (Path(made, name) for name in ("in", "out", "single"))
        paths = simulate(source, recordings, frames)
        for words in single_commands(paths[0], Path(made, "first")):  # a kernel that was just compiled rounds otherwise
            subprocess.run((*COMMAND_LINE, *words), check=True, capture_output=True)
        stages = len(STAGES) * recordings
        records = Records(output)
        for kill in range(kills):
            rows.append(("killed", 2, run_batch(source, records, 2, kill_at=(kill + 1) * stages // (kills + 1))))
            click.echo(f"killed after {records.stages} of {stages} stages, {len(records.first_ns)} records")
        kept = len(records.first_ns)
        rows.append(("resumed", 2, run_batch(source, records, 2)))
        differing: list[str] = []
        for path in paths:
            with contextlib.redirect_stdout(io.StringIO()):
                for words in single_commands(path, single / path.stem):
                    main(words)
            differing += differences(output / path.stem, single / path.stem)
            shutil.rmtree(single / path.stem)
        left = [*output.rglob(".????????.*"), *(output / RECORDS).glob(f"*/{SPANS}")]
        shutil.rmtree(output)
        for _ in range(rounds):
            for workers in (1, 2):
                timed = Path(made, "timed")
                rows.append(("batch", workers, run_batch(source, Records(timed), workers)))
                shutil.rmtree(timed)
    cells = []
    for name, workers, run in rows:
        cpu = " ".join(f"{seconds:.2f}" for seconds in run.worker_cpu_s)
        parts = [f"{value:.2f}" for value in (run.wall_s, run.start_s, run.end_s, run.main_cpu_s)]
        cells.append((name, workers, *parts, cpu, f"{run.peak_mb:.0f}"))
        parts_s = (run.start_s, run.wall_s - run.start_s - run.end_s, run.end_s)
        within = "" if np.isnan(run.start_s) else " (start {:.1f}, work {:.1f}, end {:.1f} s)".format(*parts_s)
        click.echo(
            f"{name}, {workers} workers: {run.wall_s:.1f} s{within}, processor time {cpu} s "
            f"and {run.main_cpu_s:.1f} s (all but workers), {run.peak_mb:.0f} MB a worker at most"
        )
    titles = ("run", "workers", "wall_s", "start_s", "end_s", "main_cpu_s", "worker_cpu_s", "peak_mb")
    write_rows(table, titles, cells, force=force)
    click.echo(
        f"{records.stages} of {stages} stages finished, {len(records.twice)} of {kept} records written twice after "
        f"{kills} kills, {len(differing)} of {3 * recordings} files differ from single runs, {len(left)} unfinished "
        "files left"
    )
    if rounds:
        ones, twos = ([run for of, by, run in rows if (of, by) == ("batch", workers)] for workers in (1, 2))
        by_clock = median(one.wall_s / two.wall_s for one, two in zip(ones, twos, strict=True))
        by_cpu = median(one.worker_cpu_s[0] / two.worker_cpu_s[0] for one, two in zip(ones, twos, strict=True))
        click.echo(f"two workers against one: {by_clock:.2f} times by the clock, {by_cpu:.2f} by processor time")
        click.echo(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    if records.twice or differing or left or records.stages != stages:
        raise SystemExit(1)
