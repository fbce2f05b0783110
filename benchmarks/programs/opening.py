"""A recording of 10 GB opened as napari layers and scrolled through: ``python3 run.py bench opening``."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
import numpy as np
import psutil

from napari_elsplus.io import beside, write_calibration
from napari_elsplus.io.formats.tiff_pages import PageLayout
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.truth import true_calibration
from napari_elsplus.viewing.layers import open_layers

if TYPE_CHECKING:
    from napari_elsplus.viewing.layers import Opened

SHAPE: Final = (524, 1328)
RATE_HZ: Final = 240
FRAMES: Final = 14_400
"""A minute, and 10 GB."""
STEPS: Final = 300


def write_sparse(path: Path) -> None:
    """Write one of our recordings in which the pages' headers are there and the pixels are holes."""
    layout = PageLayout(SHAPE, np.dtype(np.uint8))
    with path.open("wb") as file:
        file.write(layout.file_header)
        for k in range(FRAMES):
            file.seek(layout.start(k))
            file.write(layout.head(k, k / RATE_HZ, k))
        for k in range(1, FRAMES):
            place, link = layout.link(k)
            file.seek(place)
            file.write(link)
        file.truncate(layout.start(FRAMES))


def show(opened: Opened, frame: int, *names: str) -> None:
    """Compute the images of one frame, as napari does when it is shown."""
    for data, attributes, _ in opened.layers:
        if attributes["name"].endswith(names):
            np.asarray(data[frame])


@click.command()
def opening() -> None:
    """Open a recording of 10 GB as napari layers and scroll through it: time to the first image, memory."""
    process = psutil.Process()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "big.ome.tif")
        write_sparse(path)
        write_calibration(beside(path, ".calibration.json"), true_calibration(Instrument.of("240hz")))
        show(open_layers(path), FRAMES - 1, "LS", "ELS+")  # compiles
        start_s = time.perf_counter()
        opened = open_layers(path)
        show(opened, 0, "ELS+")
        first_s, memory = time.perf_counter() - start_s, process.memory_info().rss
        start_s = time.perf_counter()
        for frame in range(0, FRAMES, FRAMES // STEPS):
            show(opened, frame, "LS", "ELS+")
        step_s, grown = (time.perf_counter() - start_s) / STEPS, process.memory_info().rss - memory
        click.echo(
            f"{path.stat().st_size / 1e9:.1f} GB ({FRAMES} frames of {SHAPE[0]} x {SHAPE[1]} pixels): first ELS+ image "
            f"after {1e3 * first_s:.0f} ms; a step of LS and ELS+ {1e3 * step_s:.1f} ms; memory grew by "
            f"{grown / 1e6:.0f} MB over {STEPS} steps"
        )
