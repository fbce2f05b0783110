"""A batch that is killed and resumed, against single runs, and its speed by workers: ``python3 run.py bench batch``.

Recordings of the simulated rig are sectioned and made into mosaics by the command line. The batch is killed with all of
its processes as often as asked, resumed to its end, and its images, mosaics and tracks are compared, bit by bit, with
those of single runs. Then it is run anew by one worker and by two, in turn, and so are the same stages by one plain
process and by two, without a scheduler: the ratio of the latter is the most that the computer and its disk can give.

The ratios by the clock hold where nothing else runs. On a busy machine the processor time of the only worker over that
of the busier of two is the ratio that would be reached if each worker had a core of its own.
"""

from __future__ import annotations

import contextlib
import csv
import io
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Final, NamedTuple

import click
import numpy as np
import psutil
import tifffile

from benchmarks.programs.batch_share import plain_job
from benchmarks.programs.start import COMMAND_LINE
from napari_elsplus.cli import main
from napari_elsplus.cli.options import FILE, force_option, refuse_outputs
from napari_elsplus.io import write_calibration, write_stack
from napari_elsplus.io.atomic import replacing
from napari_elsplus.workflows.batch.job import RECORDS, open_output
from napari_elsplus.workflows.simulated import simulate_recording

PASSES: Final = 10
"""Recordings that are cut from one long simulated one: rendering a scene anew takes longer than its frames."""
POLL_S: Final = 0.1
"""Time between looks at records and processes; chosen, a small part of a stage."""
STAGES: Final = ("section", "mosaic")
DISK_BYTES: Final = 1 << 30
"""Bytes written to measure the disk; chosen: five files of images of 240 frames each."""
KINDS: Final = {"batch": "workers", "plain": "plain processes"}


class Run(NamedTuple):
    """What a run of a batch took.

    Parameters
    ----------
    wall_s : float
        From the start of the command to its end.
    main_cpu_s : float
        Processor time of the command itself (scheduler, table, contact sheet); 0 without one.
    worker_cpu_s : tuple of float
        Processor time of each worker, largest first.
    peak_mb : float
        Largest resident memory of a worker, MB.
    """

    wall_s: float
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
            write_stack(paths[-1], cut, calibration=calibration)
            write_calibration(paths[-1].with_suffix(".calibration.json"), calibration)
    return paths


def finished(output: Path) -> dict[str, int]:
    """Return the time (ns) at which each finished stage of a batch was recorded, by the record's name."""
    return {path.name: path.stat().st_mtime_ns for path in (output / RECORDS).glob("[!.]*.*.json")}


def run_batch(source: Path, output: Path, workers: int, *, kill_at: int | None = None) -> Run:
    """Run a batch in processes of its own; kill them all once so many stages are finished.

    Raises
    ------
    RuntimeError
        If the batch fails, or ends before it was killed.
    """
    words = ("batch", str(source), "--mosaic", "-o", str(output), "--workers", str(workers))
    begun_s = time.perf_counter()
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    running = psutil.Popen((*COMMAND_LINE, *words), start_new_session=True, **pipes)
    spent: dict[int, float] = {}
    main_s = peak = 0.0
    while running.poll() is None:
        if kill_at is not None and len(finished(output)) >= kill_at:
            os.killpg(running.pid, signal.SIGKILL)
            running.wait()
            break
        try:
            main_s = _cpu_s(running)
            for child in running.children(recursive=True):
                spent[child.pid] = _cpu_s(child)
                peak = max(peak, child.memory_info().rss)
        except psutil.NoSuchProcess:
            pass
        time.sleep(POLL_S)
    with running.stdout, running.stderr:
        said = (running.stdout.read() + running.stderr.read()).decode()
    if running.returncode != (0 if kill_at is None else -signal.SIGKILL):
        raise RuntimeError(f"the batch ended with {running.returncode}: {said[-500:]}")
    workers_s = tuple(sorted(spent.values(), reverse=True)[:workers])
    return Run(time.perf_counter() - begun_s, main_s, workers_s, peak / 1e6)


def run_plain(source: Path, output: Path, processes: int) -> Run:
    """Execute the stages of a batch in plain processes that share the recordings, without a scheduler.

    Raises
    ------
    RuntimeError
        If one of them fails.
    """
    begun_s = time.perf_counter()
    open_output(plain_job(output))
    program = (sys.executable, "-m", "benchmarks.programs.batch_share", str(source), str(output))
    one_thread = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # as dask's workers have it
    shares = [psutil.Popen((*program, str(k), str(processes)), env=one_thread) for k in range(processes)]
    spent, peak = [0.0] * processes, 0
    while any(share.poll() is None for share in shares):
        for place, share in enumerate(shares):
            with contextlib.suppress(psutil.NoSuchProcess):
                spent[place] = max(spent[place], _cpu_s(share))
                peak = max(peak, share.memory_info().rss)
        time.sleep(POLL_S)
    if any(share.returncode for share in shares):
        raise RuntimeError("a plain process failed; what it printed stands above")
    return Run(time.perf_counter() - begun_s, 0.0, tuple(sorted(spent, reverse=True)), peak / 1e6)


def disk_mb_per_s(folder: Path) -> float:
    """Return the rate at which a file is written into a folder and flushed to the disk, MB/s."""
    block = np.random.default_rng(0).bytes(1 << 24)
    begun_s = time.perf_counter()
    with tempfile.TemporaryFile(dir=folder) as file:
        for _ in range(DISK_BYTES // len(block)):
            file.write(block)
        file.flush()
        os.fsync(file.fileno())
        return DISK_BYTES / 1e6 / (time.perf_counter() - begun_s)


def size_mb(folder: Path) -> float:
    """Return the size of all files in a folder, MB."""
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6


def _cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


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
    table = out / "batch.csv"
    out.mkdir(parents=True, exist_ok=True)
    refuse_outputs(table, force=force)
    rows: list[tuple[str, int, Run]] = []
    written_mb = 0.0
    with tempfile.TemporaryDirectory(dir=scratch) as made:
        source, output, single = (Path(made, name) for name in ("in", "out", "single"))
        paths = simulate(source, recordings, frames)
        for words in single_commands(paths[0], Path(made, "first")):  # a kernel that was just compiled rounds otherwise
            subprocess.run((*COMMAND_LINE, *words), check=True, capture_output=True)
        stages = len(STAGES) * recordings
        kept: dict[str, int] = {}
        for kill in range(kills):
            rows.append(("killed", 2, run_batch(source, output, 2, kill_at=(kill + 1) * stages // (kills + 1))))
            kept = finished(output) | kept  # the time of the first record
            click.echo(f"killed after {len(finished(output))} of {stages} stages")
        rows.append(("resumed", 2, run_batch(source, output, 2)))
        ended = finished(output)
        twice = [name for name, at_ns in kept.items() if ended[name] != at_ns]
        differing: list[str] = []
        for path in paths:
            with contextlib.redirect_stdout(io.StringIO()):
                for words in single_commands(path, single / path.stem):
                    main(words)
            differing += differences(output / path.stem, single / path.stem)
            shutil.rmtree(single / path.stem)
        left = [str(file.relative_to(output)) for file in output.rglob(".????????.*")]
        shutil.rmtree(output)
        disk = disk_mb_per_s(Path(made))
        for _ in range(rounds):
            for workers in (1, 2):
                for kind, timed in (("batch", run_batch), ("plain", run_plain)):
                    rows.append((kind, workers, timed(source, Path(made, "timed"), workers)))
                    written_mb = size_mb(Path(made, "timed"))
                    shutil.rmtree(Path(made, "timed"))
    with replacing(table, force=force) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("run", "workers", "wall_s", "main_cpu_s", "worker_cpu_s", "peak_mb"))
        for name, workers, run in rows:
            cpu = " ".join(f"{seconds:.2f}" for seconds in run.worker_cpu_s)
            writer.writerow((name, workers, f"{run.wall_s:.2f}", f"{run.main_cpu_s:.2f}", cpu, f"{run.peak_mb:.0f}"))
            click.echo(
                f"{name}, {workers} {KINDS.get(name, 'workers')}: {run.wall_s:.1f} s, processor time {cpu} s and "
                f"{run.main_cpu_s:.1f} s (scheduler, table, sheet), {run.peak_mb:.0f} MB a worker at most"
            )
    click.echo(
        f"{len(ended)} of {stages} stages finished, {len(twice)} of {len(kept)} done twice after {kills} kills, "
        f"{len(differing)} of {3 * recordings} files differ from single runs, {len(left)} unfinished files left"
    )
    if rounds:
        for kind, name in KINDS.items():
            ones, twos = ([run for of, by, run in rows if (of, by) == (kind, workers)] for workers in (1, 2))
            by_clock = median(one.wall_s / two.wall_s for one, two in zip(ones, twos, strict=True))
            by_cpu = median(one.worker_cpu_s[0] / two.worker_cpu_s[0] for one, two in zip(ones, twos, strict=True))
            rate = written_mb / median(two.wall_s for two in twos)
            click.echo(
                f"two {name} against one: {by_clock:.2f} times by the clock, {by_cpu:.2f} times by processor time; "
                f"two write {rate:.0f} MB/s"
            )
        click.echo(
            f"{written_mb / 1000:.1f} GB of results; the disk takes {disk:.0f} MB/s; "
            f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
        )
    if twice or differing or left or len(ended) != stages:
        raise SystemExit(1)
