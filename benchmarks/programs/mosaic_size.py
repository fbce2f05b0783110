"""A mosaic of 20 x 20 mm: memory, what showing its growth takes, and how often napari draws it.

``python3 run.py bench mosaic-size``, without a screen under ``xvfb-run -a``. Frames of a made-up texture are laid along
a raster, twelve between two looks, as at 240 Hz and 20 looks a second; each look brings image, track and marks up to
date and lets napari draw. Then the mosaic is saved.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import click
import cv2
import napari
import numpy as np
from qtpy.QtWidgets import QApplication

from benchmarks.harness.machine import machine, memory_mb
from benchmarks.rigs.simulated import simulated_rig
from napari_elsplus.io import TrackPoint, TrackTable
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.mosaicing.mosaic import Mosaic
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.viewing.mosaic.files import save_mosaics
from napari_elsplus.viewing.mosaic.mosaics import MosaicScale
from napari_elsplus.widgets.mosaic.layers import MosaicLayers
from napari_elsplus.workflows.mosaic_plan import MosaicPlan

STEP_PX = 40.0
LINES_APART = 0.6
"""Of the bundle's diameter."""
FRAMES_PER_LOOK = 12
WHOLE_LOOKS = 10
LIMIT_MB = 2000
MIN_HZ = 10


class Raster:
    """A mosaic that a probe on a raster of lines would give; what the layers look at."""

    revision = 0

    def __init__(self, side_mm: float) -> None:
        rig = simulated_rig()
        self.grid = grid = Grid.of(rig.calibration)
        self.um_per_px = um = rig.um_per_px
        self.scale = MosaicScale(float(grid.binning), um, 0.45 * grid.diameter, 0.6 * grid.diameter * grid.binning)
        self.mosaic = Mosaic(grid)
        self.canvases = {Mode.ELS: {0: self.mosaic}}
        self.rows = TrackTable()
        side = side_mm * 1000 / (um * grid.binning) - grid.diameter
        along, lines = np.arange(0, side, STEP_PX), np.arange(0, side, LINES_APART * grid.diameter)
        self.path = [(r, c) for k, r in enumerate(lines) for c in (along if k % 2 == 0 else along[::-1])]
        noise = np.random.default_rng(0).normal(size=(8, grid.side, grid.side)).astype(np.float32)
        self._images = [60 + 40 * cv2.GaussianBlur(image, (0, 0), 2.0) / 0.14 for image in noise]

    def lay(self, first: int, last: int) -> None:
        """Insert frames of the path."""
        q, um = self.grid.binning, self.um_per_px
        for k, (row, col) in enumerate(self.path[first:last], start=first):
            self.mosaic.insert(self._images[k % len(self._images)], float(row), float(col))
            place = (row * q, col * q, row * q * um, col * q * um)
            self.rows.append(TrackPoint(k, k / 240, 0, *place, 0.95, 0.02, "tracked"))


@click.command()
@click.option("--side-mm", default=20.0)
def mosaic_size(side_mm: float) -> None:
    """Show a mosaic that grows to 20 x 20 mm, and save it: memory, and how often it is drawn."""
    viewer = napari.Viewer()
    viewer.window.resize(1280, 900)
    raster = Raster(side_mm)
    layers = MosaicLayers(viewer)
    layers.show(raster, Mode.ELS)
    start_mb = memory_mb()
    peak_mb, updates, looks = 0.0, [], []
    for number, first in enumerate(range(0, len(raster.path), FRAMES_PER_LOOK)):
        raster.lay(first, first + FRAMES_PER_LOOK)
        start = time.perf_counter()
        layers.update(whole=number % WHOLE_LOOKS == 0)
        updates.append(time.perf_counter() - start)
        QApplication.processEvents()
        looks.append(time.perf_counter() - start)
        if number % 50 == 0:
            peak_mb = max(peak_mb, memory_mb())
    grown_mb = memory_mb() - start_mb
    tail = looks[-len(looks) // 4 :]
    viewer.scene.camera.zoom *= 8
    close = []
    for k in range(40):
        raster.lay(len(raster.path) - 1, len(raster.path))
        start = time.perf_counter()
        layers.update(whole=k % WHOLE_LOOKS == 0)
        QApplication.processEvents()
        close.append(time.perf_counter() - start)
    with tempfile.TemporaryDirectory() as box:
        start = time.perf_counter()
        save_mosaics(raster, Path(box) / "m.ome.tif", MosaicPlan())
        save_s, after_mb = time.perf_counter() - start, memory_mb()
    assert raster.mosaic.extent is not None
    rows, cols = raster.mosaic.extent.shape
    mm = raster.um_per_px * raster.grid.binning / 1000
    click.echo(machine())
    click.echo(
        f"{rows} x {cols} px, {rows * mm:.1f} x {cols * mm:.1f} mm, {len(raster.path)} frames\n"
        f"memory: {grown_mb:.0f} MB more than napari alone ({start_mb:.0f} MB), at most {peak_mb:.0f} MB; "
        f"{after_mb:.0f} MB after saving, which took {save_s:.1f} s\n"
        f"update: median {1e3 * np.median(updates):.1f} ms, 99 % {1e3 * np.quantile(updates, 0.99):.1f} ms, "
        f"longest {1e3 * max(updates):.0f} ms\n"
        f"update and draw, last quarter, all in view: median {1e3 * np.median(tail):.1f} ms "
        f"({1 / np.median(tail):.0f} Hz), 99 % {1e3 * np.quantile(tail, 0.99):.1f} ms; zoomed in: "
        f"median {1e3 * np.median(close):.1f} ms"
    )
    viewer.close()
    if peak_mb > LIMIT_MB or np.median(tail) > 1 / MIN_HZ:
        raise SystemExit(f"more than {LIMIT_MB} MB, or slower than {MIN_HZ} Hz")
