"""The track of a long session in napari: how long the window's thread is held while loops go on being closed.

``python3 run.py bench long-track``, without a screen under ``xvfb-run -a``. Another
process fills a board as the engine does, up to a time without waiting for the frames; from then on rows come at the
camera's pace, all that came so far is relocated once a second, and the panel's ticks are timed.
"""

from __future__ import annotations

import subprocess
import sys
import time
from threading import Thread
from typing import TYPE_CHECKING, Any

import click
import napari
import numpy as np
import psutil
from qtpy.QtWidgets import QApplication

from benchmarks.harness.machine import machine
from benchmarks.rigs.simulated import simulated_rig
from napari_elsplus.acquisition.mosaic.board import MosaicBoard
from napari_elsplus.acquisition.mosaic.tracking import TrackState
from napari_elsplus.io import TrackPoint
from napari_elsplus.processing.mosaicing.mosaic import Mosaic
from napari_elsplus.viewing.mosaic.live import LiveMosaicView
from napari_elsplus.widgets.shared.window import closing
from napari_elsplus.workflows.mosaic_plan import MosaicPlan
from napari_elsplus.workflows.tracking import Pipeline

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

HZ = 240
SPEED_PX = 6.0
FIELD_PX = 3000.0
LOOK_S = 8.0
RELOCATED_EVERY_S = 1.0
DRIFT_PX = 3.0
LOST_EVERY = 20 * HZ
PREDICTED, LOST = 3, 2
"""Frames that are predicted, then lost, so often."""


def where(frames: Array) -> Array:
    """Return positions of the probe, camera pixels: rounds over the same places."""
    turn = SPEED_PX / FIELD_PX * frames
    return np.column_stack([FIELD_PX * np.sin(turn), FIELD_PX * np.sin(1.37 * turn)])


class Session:
    """Writes to a board what the engine would have written."""

    def __init__(self, um_per_px: float) -> None:
        rig = simulated_rig()
        self.board, self._um = MosaicBoard(), um_per_px
        self._pipeline = Pipeline(rig.calibration, rig.instrument.frame_shape)
        self._mosaic = Mosaic(self._pipeline.grid, store=self.board.new_store(0))
        self._image = np.random.default_rng(0).random((self._pipeline.grid.side,) * 2).astype(np.float32) * 99 + 1
        self.frames = 0

    def go_on(self, frames: int) -> None:
        """Add rows, and draw where the probe passes."""
        places = where(self.frames + np.arange(float(frames)))
        scale = self._pipeline.camera_px_per_pixel
        for (row, col), frame in zip(places.tolist(), range(self.frames, self.frames + frames), strict=True):
            since = frame % LOST_EVERY
            state = "predicted" if LOST <= since < LOST + PREDICTED else "lost" if since < LOST else "tracked"
            if frame % 40 == 0 and frame < 4 * 60 * HZ:
                self._mosaic.insert(self._image, row / scale, col / scale)
                if (part := self._mosaic.take_dirty()) is not None:
                    self.board.changed(0, part)
            if state == "lost":
                row = col = np.nan
            self.board.append(
                TrackPoint(frame, frame / HZ, 0, row, col, row * self._um, col * self._um, 0.9, 0.02, state)
            )
        self.frames += frames

    def relocate(self) -> None:
        """Put all rows where they belong."""
        row, col = where(np.arange(float(self.frames))).T
        drift = DRIFT_PX * np.sin(self.frames + np.arange(self.frames) / 1e5)
        for block in self.board.blocks:
            segment = np.zeros(block.stop - block.start, np.int64)
            self.board.relocate(block, segment, (row + drift)[block], (col - drift)[block], self._um)

    def close(self) -> None:
        """Give the board's memory back."""
        self._mosaic.clear()
        self.board.close()


def engine() -> None:
    """Be the other process: write rows up to a time as fast as they can be written, then as they would come."""
    session = Session(simulated_rig().um_per_px)
    session.go_on(HZ)
    told: list[str] = []

    def listen() -> None:
        told.extend(sys.stdin)
        told.append("end\n")  # whoever looks on has ended

    click.echo(session.board.name)
    Thread(target=listen, daemon=True).start()
    while "end\n" not in told:
        time.sleep(1 / HZ)
        if not told:
            continue
        session.go_on(int(float(told.pop(0)) * 60 * HZ) - session.frames)
        click.echo(session.frames)
        begin = relocated = time.perf_counter()
        first = session.frames
        while not told:
            now = time.perf_counter()
            session.go_on(int((now - begin) * HZ) - (session.frames - first))
            if now - relocated > RELOCATED_EVERY_S:
                session.relocate()
                relocated = now
            time.sleep(1 / HZ)
    session.close()


def tick(panel: Any) -> float:
    """Let the panel do what it does now and then, and napari draw; how long the panel held the thread."""
    start = time.perf_counter()
    panel.tick()
    took = time.perf_counter() - start
    QApplication.processEvents()
    return took


@click.command()
@click.option("--minutes", multiple=True, default=(1.0, 5.0, 15.0, 30.0))
@click.option("--as-engine", is_flag=True, hidden=True)
def long_track(minutes: tuple[float, ...], as_engine: bool) -> None:
    """Show the track of a long session: how long the window is held while loops are closed."""
    if as_engine:
        engine()
        return
    closing.confirm = lambda *_: True  # nobody is there to be asked whether the mosaic may go
    viewer = napari.Viewer()
    viewer.window.resize(1280, 900)
    _, panel = viewer.window.add_plugin_dock_widget("napari-elsplus", "Mosaic", tabify=True)
    rig = simulated_rig()
    command = [sys.executable, "-m", "benchmarks", "long-track", "--as-engine"]
    other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
    assert other.stdin is not None
    assert other.stdout is not None
    grid = Pipeline(rig.calibration, rig.instrument.frame_shape).grid
    board = other.stdout.readline().strip()
    state = TrackState(MosaicPlan(), board, float(grid.binning), 0.45 * grid.diameter, {}, None)
    live = LiveMosaicView(state, rig.calibration)
    panel._timer.stop()  # noqa: SLF001
    panel._follow_live = lambda: None  # noqa: SLF001 - there is no engine to be asked
    live.update()
    panel._shown = live  # noqa: SLF001
    panel.layers.show(live, live.plan.tracked)
    click.echo(machine())
    for minute in minutes:
        other.stdin.write(f"{minute}\n")
        rows = int(other.stdout.readline())
        late = []
        while panel.layers.drawing.behind or len(live.rows) < rows:
            late.append(tick(panel))
        begin, held = time.perf_counter(), []
        while time.perf_counter() - begin < LOOK_S:
            held.append(tick(panel))
            time.sleep(0.02)
        ms = 1e3 * np.array(held)
        click.echo(
            f"{minute:g} min: a tick takes {np.median(ms):.1f} ms (median), 99 % {np.quantile(ms, 0.99):.1f}, longest "
            f"{ms.max():.1f} ms ({len(ms)} ticks); who comes late has all in {len(late)} ticks of at most "
            f"{1e3 * max(late):.0f} ms; {psutil.Process().memory_info().rss / 2**20:.0f} MB"
        )
    start = time.perf_counter()
    rows = len(list(live.rows))
    click.echo(f"{rows} rows read for saving in {time.perf_counter() - start:.1f} s")
    live.close()
    other.stdin.write("end\n")
    other.wait()
    viewer.close()
    QApplication.processEvents()
