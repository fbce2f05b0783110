"""Opening a 10 GB recording as napari layers and scrolling through it: time to the first image, memory.

Run with asv, or by hand: ``python -m benchmarks.programs.viewing``.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path

import click
import numpy as np

from benchmarks.programs.recording import RATE_HZ, SHAPE, sparse_recording
from napari_elsplus.io import beside, write_calibration
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.truth import true_calibration
from napari_elsplus.viewing.layers import open_layers

FRAMES = 14_400
STEPS = 300


def resident_mb() -> float:
    """Memory that belongs to this process alone and memory mapped from files, MB."""
    status = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return sum(int(line.split()[1]) for line in status if line.startswith("VmRSS")) / 1024


class Viewing:
    """All layers of a recording with its calibration beside it."""

    def setup(self):
        self.box = Path(tempfile.mkdtemp())
        self.path = sparse_recording(self.box / "big.ome.tif", FRAMES)
        write_calibration(beside(self.path, ".calibration.json"), true_calibration(Instrument.of("240hz")))
        self.scroll(3)  # compiled

    def teardown(self):
        shutil.rmtree(self.box)

    def open(self):
        opened = open_layers(self.path)
        layers = {attributes["name"]: data for data, attributes, _ in opened.layers}
        np.asarray(layers["big ELS+"][0])
        return layers

    def scroll(self, steps=STEPS):
        layers = self.open()
        for k in range(0, FRAMES, FRAMES // steps):
            for name in ("big LS", "big ELS+"):
                np.asarray(layers[name][k])
        return resident_mb()

    def time_first_image(self):
        self.open()

    def time_scroll(self):
        self.scroll()

    def track_memory_mb(self):
        before = resident_mb()
        return self.scroll() - before

    track_memory_mb.unit = "MB"


def main() -> None:
    viewing = Viewing()
    viewing.setup()
    size_gb = viewing.path.stat().st_size / 1e9
    start = time.perf_counter()
    viewing.open()
    first_s = time.perf_counter() - start
    before = resident_mb()
    start = time.perf_counter()
    after = viewing.scroll()
    step_s = (time.perf_counter() - start) / STEPS
    click.echo(
        f"{size_gb:.1f} GB ({FRAMES / RATE_HZ:.0f} s of {SHAPE[0]} x {SHAPE[1]} at {RATE_HZ} Hz): "
        f"first ELS+ image after {1e3 * first_s:.0f} ms; a step of LS and ELS+ {1e3 * step_s:.1f} ms; "
        f"memory grew by {after - before:.0f} MB over {STEPS} steps"
    )
    viewing.teardown()


if __name__ == "__main__":
    main()
