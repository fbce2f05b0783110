"""Writing and opening recordings: does the disk keep up with 240 Hz, and what does opening 10 GB cost?

Run with asv, or by hand: ``python benchmarks/recording.py [FOLDER]``.
"""

from __future__ import annotations

import resource
import shutil
import struct
import sys
import tempfile
import time
from pathlib import Path

import click
import numpy as np
import tifffile

from napari_elsplus.io import RecordingWriter, open_recording

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
    with RecordingWriter(path, SHAPE, np.uint8) as writer:
        for k in range(2):
            writer.append(np.zeros(SHAPE, np.uint8), k / RATE_HZ, k)
    with tifffile.TiffFile(path) as file:
        first, second = file.pages[0], file.pages[1]
        start, stride = second.offset, second.offset - first.offset
        page = path.read_bytes()[start : second.dataoffsets[0]]
        following = 8 + 20 * len(second.tags)
        apart = [tag.offset - start + 12 for tag in second.tags if tag.valueoffset - start > following]
        shifted = [*apart, second.tags["StripOffsets"].valueoffset - start]
        stamp = second.tags[65000].valueoffset - start
    with path.open("r+b") as file:
        file.seek(start - stride + following)
        file.write(struct.pack("<Q", start))
        for k in range(1, frames):
            header = bytearray(page)
            for place in shifted:
                struct.pack_into("<Q", header, place, struct.unpack_from("<Q", page, place)[0] + (k - 1) * stride)
            struct.pack_into("<2d", header, stamp, k / RATE_HZ, k)
            struct.pack_into("<Q", header, following, start + k * stride if k + 1 < frames else 0)
            file.seek(start + (k - 1) * stride)
            file.write(header)
        file.truncate(start + (frames - 1) * stride)
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
