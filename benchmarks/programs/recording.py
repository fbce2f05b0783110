"""Writing and opening recordings: does the disk keep up with 240 Hz, and what does opening 10 GB cost?

Run with asv, or by hand: ``python -m benchmarks.programs.recording [FOLDER]``.
"""

from __future__ import annotations

import resource
import shutil
import sys
import tempfile
import time
from pathlib import Path

import click
import numpy as np

from napari_elsplus.io import RecordingWriter, open_recording
from napari_elsplus.io.formats.tiff_pages import PageLayout

SHAPE = (524, 1328)
RATE_HZ = 240


class Writing:
    """Full frames of the 240 Hz mode, as fast as they go."""

    frames = 1200
    folder: str | None = None

    def setup(self):
        self.box = Path(tempfile.mkdtemp(dir=self.folder))
        self.buffer = np.random.default_rng(0).integers(0, 255, SHAPE, dtype=np.uint8)

    def teardown(self):
        shutil.rmtree(self.box)

    def write(self):
        waits = []
        with RecordingWriter(self.box / "r.ome.tif", SHAPE, np.uint8, force=True) as writer:
            for k in range(self.frames):
                start = time.perf_counter()
                writer.append(self.buffer, k / RATE_HZ, k)
                waits.append(time.perf_counter() - start)
        return waits

    def time_write(self):
        self.write()

    def track_megabytes_per_second(self):
        return self.frames * self.buffer.nbytes / sum(self.write()) / 1e6

    track_megabytes_per_second.unit = "MB/s"


class Opening:
    """A sparse recording of 10 GB: to the first frame, and scrolling through it."""

    frames = 14_400

    def setup(self):
        self.box = Path(tempfile.mkdtemp())
        self.path = sparse_recording(self.box / "big.ome.tif", self.frames)

    def teardown(self):
        shutil.rmtree(self.box)

    def time_first_frame(self):
        with open_recording(self.path) as recording:
            recording[0].sum()

    def time_scroll_200_frames(self):
        with open_recording(self.path) as recording:
            for k in range(0, self.frames, self.frames // 200):
                recording[k].sum()


def sparse_recording(path: Path, frames: int) -> Path:
    """One of our recordings in which the pages' headers are there and the pixels are holes."""
    layout = PageLayout(SHAPE, np.dtype(np.uint8))
    with path.open("wb") as file:
        file.write(layout.file_header)
        for k in range(frames):
            file.seek(layout.start(k))
            file.write(layout.head(k, k / RATE_HZ, k))
        for k in range(1, frames):
            place, link = layout.link(k)
            file.seek(place)
            file.write(link)
        file.truncate(layout.start(frames))
    return path


def main(folder: str | None) -> None:
    writing = Writing()
    writing.folder = folder
    writing.setup()
    waits = np.array(writing.write())
    rate = writing.buffer.nbytes / waits.mean() / 1e6
    click.echo(f"written {rate:.0f} MB/s ({writing.buffer.nbytes * RATE_HZ / 1e6:.0f} needed); "
          f"per frame p50 {1e3 * np.median(waits):.2f}, p99 {1e3 * np.quantile(waits, 0.99):.2f}, "
          f"max {1e3 * waits.max():.1f} ms")  # fmt: skip
    writing.teardown()
    opening = Opening()
    opening.setup()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.perf_counter()
    opening.time_first_frame()
    first = time.perf_counter() - start
    start = time.perf_counter()
    opening.time_scroll_200_frames()
    scrolled = time.perf_counter() - start
    size = opening.path.stat().st_size / 1e9
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    click.echo(f"{size:.1f} GB: first frame after {1e3 * first:.1f} ms, a frame per {1e3 * scrolled / 200:.2f} ms, "
          f"{grown:.0f} MB more memory (mapped pages included)")  # fmt: skip
    opening.teardown()


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
