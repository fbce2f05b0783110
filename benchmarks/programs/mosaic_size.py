"""A mosaic of 20 x 20 mm: memory, what showing its growth takes, and how often napari draws it.

By hand: ``python -m benchmarks.programs.mosaic_size [--side-mm S] [--insertion I]``, without a screen under
``xvfb-run -a``. Frames of a made-up texture are laid along a raster, twelve between two looks, as at 240 Hz and 20
looks a second; each look brings image, track and marks up to date and lets napari draw. Then the mosaic is saved.
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

from benchmarks.harness.machine import machine
from napari_elsplus.io import TrackPoint, TrackTable
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.mosaicing.mosaic import Insertion, Mosaic
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.truth import true_calibration
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


def resident_mb() -> float:
    """Memory of this process that is not shared with files."""
    fields = (line.split() for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines())
    return next(int(field[1]) for field in fields if field[0] == "RssAnon:") / 1024


class Raster:
    """A mosaic that a probe on a raster of lines would give; what the layers look at."""

    revision = 0

    def __init__(self, side_mm: float, insertion: Insertion) -> None:
        calibration = true_calibration(Instrument.of("240hz"))
        self.grid = grid = Grid.of(calibration)
        um = calibration.optics.um_per_px
        self.scale = MosaicScale(float(grid.binning), um, 0.45 * grid.diameter, 0.6 * grid.diameter * grid.binning)
        self.mosaic = Mosaic(grid, insertion)
        self.canvases = {Mode.ELS: {0: self.mosaic}}
        self.rows = TrackTable()
        side = side_mm * 1000 / (um * grid.binning) - grid.diameter
        along, lines = np.arange(0, side, STEP_PX), np.arange(0, side, LINES_APART * grid.diameter)
        self.path = [(r, c) for k, r in enumerate(lines) for c in (along if k % 2 == 0 else along[::-1])]
        noise = np.random.default_rng(0).normal(size=(8, grid.side, grid.side)).astype(np.float32)
        self._images = [60 + 40 * cv2.GaussianBlur(image, (0, 0), 2.0) / 0.14 for image in noise]

    def lay(self, first: int, last: int) -> None:
        q, um = self.grid.binning, self.scale.camera_um_per_px
        for k, (row, col) in enumerate(self.path[first:last], start=first):
            self.mosaic.insert(self._images[k % len(self._images)], float(row), float(col))
            place = (row * q, col * q, row * q * um, col * q * um)
            self.rows.append(TrackPoint(k, k / 240, 0, *place, 0.95, 0.02, "tracked"))


@click.command()
@click.option("--side-mm", default=20.0)
@click.option("--insertion", type=click.Choice([kind.value for kind in Insertion]), default="dead-leaf")
def main(side_mm: float, insertion: str) -> None:
    """Let a mosaic grow on screen, and save it."""
    viewer = napari.Viewer()
    viewer.window.resize(1280, 900)
    raster = Raster(side_mm, Insertion(insertion))
    layers = MosaicLayers(viewer)
    layers.show(raster, Mode.ELS)
    start_mb = resident_mb()
    peak_mb, updates, looks = 0.0, [], []
    for number, first in enumerate(range(0, len(raster.path), FRAMES_PER_LOOK)):
        raster.lay(first, first + FRAMES_PER_LOOK)
        start = time.perf_counter()
        layers.update(whole=number % WHOLE_LOOKS == 0)
        updates.append(time.perf_counter() - start)
        QApplication.processEvents()
        looks.append(time.perf_counter() - start)
        if number % 50 == 0:
            peak_mb = max(peak_mb, resident_mb())
    grown_mb = resident_mb() - start_mb
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
        save_s, after_mb = time.perf_counter() - start, resident_mb()
    rows, cols = raster.mosaic.extent.shape
    um = raster.scale.um_per_px / 1000
    click.echo(machine())
    click.echo(
        f"{rows} x {cols} px, {rows * um:.1f} x {cols * um:.1f} mm, {len(raster.path)} frames, {insertion}\n"
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


if __name__ == "__main__":
    main()
