"""A long recording processed to ELS+, beside what the disk alone takes: ``python3 run.py bench process``.

The disk alone: the recording is read, and as many bytes as the images have are written, past the system's memory as the
command does, by turns with it: a thread writes while the next block is read, and what was read is released. At the end
also by way of the system's memory, as programs usually do, which makes all that follows slower. The recording repeats
simulated frames; it and the images, 22 GB for 14,400 frames, are deleted afterwards.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
import numpy as np
from rich.progress import track

from benchmarks.harness.table import results_in, write_rows
from benchmarks.programs.start import COMMAND_LINE, HERE
from napari_elsplus.cli.options import FILE, force_option
from napari_elsplus.io import RecordingWriter
from napari_elsplus.io.disk import SpanWriter, write_at
from napari_elsplus.io.stored_frames import RELEASED_BYTES
from napari_elsplus.workflows.simulated import simulate_recording

if TYPE_CHECKING:
    import io
    from collections.abc import Iterator

DIFFERENT: Final = 120
"""Frames that are simulated and repeated; chosen: rendered in seconds, and more than the processor's caches hold."""
BLOCK_BYTES: Final = 4 << 20
"""Bytes read or written in one call; chosen: few calls, in blocks of whole pages."""
MEASURED: Final = """
import resource, subprocess, sys
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss)
sys.exit(done.returncode)
"""
"""Runs a command and prints its processor time, s, and memory, kB. A small process, for those that it starts count its
own memory as theirs."""
TITLES: Final = (
    "frames", "recording_gb", "images_gb", "seconds", "frames_per_s", "processor_s", "memory_mb",
    "disk_seconds", "disk_frames_per_s", "of_the_disks_pace",
    "direct_seconds", "direct_frames_per_s", "of_the_direct_pace", "load",
)  # fmt: skip


def _record(path: Path, frames: int) -> None:
    """Write a recording of simulated frames, repeated, and leave none of it in the system's memory."""
    simulated = simulate_recording(frames=min(frames, DIFFERENT))
    different = [np.array(frame) for frame in simulated]
    with RecordingWriter(path, different[0].shape, np.uint8, calibration=simulated.calibration) as writer:
        for number in track(range(frames), description="Recording", transient=True):
            writer.append(different[number % len(different)], number / 240, number)
    _forget(path)


def _forget(path: Path) -> None:
    descriptor = os.open(path, os.O_RDWR)
    os.fsync(descriptor)
    if sys.platform == "linux":
        os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
    os.close(descriptor)


def _blocks_read(source: io.FileIO, *, forgets: bool) -> Iterator[int]:
    """Read a file to its end; yield the bytes of each block. The system's memory forgets them when they are many."""
    block = bytearray(BLOCK_BYTES)
    while read := source.readinto(block):
        if forgets and sys.platform == "linux" and source.tell() % RELEASED_BYTES == 0:
            os.posix_fadvise(source.fileno(), 0, source.tell(), os.POSIX_FADV_DONTNEED)
        yield read


def _disk_alone(recording: Path, copied: Path, bytes_written: int, *, direct: bool) -> float:
    """Return the seconds that it takes to read a recording while so many bytes are written, and nothing computed."""
    block, left = np.frombuffer(os.urandom(BLOCK_BYTES), np.uint8), bytes_written
    reads = recording.stat().st_size / BLOCK_BYTES
    copied.touch(exist_ok=False)
    begun_s = time.perf_counter()
    with recording.open("rb", buffering=0) as source, copied.open("rb+", buffering=0) as cached:
        reading = _blocks_read(source, forgets=direct)
        with SpanWriter(copied, 0) as uncached:
            while left > 0:
                if source.tell() / BLOCK_BYTES < reads * (1 - left / bytes_written):
                    next(reading, None)
                part = block[:left]
                if direct:
                    uncached.write(part)
                else:
                    write_at(cached, bytes_written - left, part.data)
                left -= len(part)
        for _ in reading:
            pass
    _forget(copied)
    seconds = time.perf_counter() - begun_s
    copied.unlink()
    _forget(recording)
    return seconds


def _process(recording: Path, images: Path) -> tuple[float, float, float]:
    """Process a recording by the command line; return seconds, seconds of processor time, and memory in MB."""
    calibration = recording.with_name("raw.calibration.json")
    command = [*COMMAND_LINE, "process", str(recording), "-c", str(calibration), "--mode", "els", "-o", str(images)]
    begun_s = time.perf_counter()
    environment = {**os.environ, "PYTHONPATH": str(HERE / "src")}
    measured = [sys.executable, "-c", MEASURED, *command]
    done = subprocess.run(measured, check=True, capture_output=True, text=True, env=environment)
    _forget(images)
    seconds = time.perf_counter() - begun_s
    processor_s, memory_kb = map(float, done.stdout.split())
    return seconds, processor_s, memory_kb / 1024


def _numbers(folder: Path, frames: int, turns: int) -> Iterator[float]:
    recording, images = folder / "raw.ome.tif", folder / "els.ome.tif"
    _record(recording, frames)
    processed, direct = [], []
    for _ in track(range(turns), description="Processing", transient=True):
        processed.append(_process(recording, images))
        image_bytes = images.stat().st_size
        images.unlink()
        _forget(recording)
        direct.append(_disk_alone(recording, folder / "copied", image_bytes, direct=True))
    alone = [
        _disk_alone(recording, folder / "copied", image_bytes, direct=False)
        for _ in track(range(turns), description="The disk alone", transient=True)
    ]
    seconds, processor_s, memory_mb = np.median(processed, axis=0)
    yield from (frames, recording.stat().st_size / 1e9, image_bytes / 1e9)
    yield from (seconds, frames / seconds, processor_s, memory_mb)
    for disk_s in (float(np.median(alone)), float(np.median(direct))):
        yield from (disk_s, frames / disk_s, disk_s / seconds)
    yield os.getloadavg()[0]


@click.command(name="process")
@click.option("--out", type=FILE, required=True, help="Folder for process.csv, and for the files meanwhile.")
@click.option("--frames", type=click.IntRange(1), default=14_400, show_default=True, help="Length of the recording.")
@click.option("--turns", type=click.IntRange(1), default=3, show_default=True, help="Of which the medians are stated.")
@force_option
def process(out: Path, frames: int, turns: int, force: bool) -> None:
    """Process a long recording to ELS+; tabulate frames per second and memory, and the disk's own pace."""
    (table,) = results_in(out, "process.csv", force=force)
    with tempfile.TemporaryDirectory(dir=out) as folder:
        row = [f"{number:.5g}" for number in _numbers(Path(folder), frames, turns)]
    write_rows(table, TITLES, [row], force=force)
    for title, number in zip(TITLES, row, strict=True):
        click.echo(f"{title:22} {number}")
