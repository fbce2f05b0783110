"""The way from another lab's AVI files to a figure and a mosaic, by mouse and three typed numbers.

``python3 run.py screens --walk``
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import imageio_ffmpeg
import numpy as np
from qtpy.QtCore import QPoint
from qtpy.QtWidgets import QOpenGLWidget  # type: ignore[attr-defined] # where Qt 6 has it

from benchmarks.screens.hand import Hand, wait_until
from napari_elsplus.instrument.optics import BUNDLE_UM
from napari_elsplus.workflows.simulated import simulate_calibration, simulate_recording

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import napari.viewer
    from numpy.typing import NDArray

    from napari_elsplus.widgets.analysis.compare import ComparePanel
    from napari_elsplus.widgets.dock.panel import ElsPlusDock

TRANSMISSION, TISSUE = "transmission.avi", "tissue.avi"
PLAYBACK_HZ: Final = 50
SEED: Final = 7
LINE: Final = ((0.7, 0.12), (0.4, 0.92))
"""Ends of the line that is drawn, (row, col) in image widths; chosen: across the field."""


def open_dock_in(viewer: napari.viewer.Viewer) -> ElsPlusDock:
    """Open the dock in a viewer's visible window, and wait until all tabs are built."""
    dock: ElsPlusDock
    _, dock = viewer.window.add_plugin_dock_widget("napari-elsplus", "ELS+")
    wait_until("tabs", lambda: all(tab.built for tab in dock.by_title.values()))
    return dock


def write_videos(folder: Path, frames: int) -> None:
    """Write AVI files of a simulated instrument into a folder: lit from the far end, and `frames` of moving tissue."""
    bundle = simulate_calibration(seed=SEED).bundle
    _write_avi(folder / TRANSMISSION, (bundle[k] for k in range(4)))
    recording = simulate_recording(frames=frames, path="spiral", seed=SEED)
    _write_avi(folder / TISSUE, (recording[k] for k in range(frames)))


def walk_to_figure(dock: ElsPlusDock, folder: Path) -> Hand:
    """Go from the videos in a folder to a figure in it, as ``docs/published-data.md`` describes.

    Parameters
    ----------
    dock : ElsPlusDock
        In a visible window without layers, all tabs built.
    folder : Path
        Contains the files of :func:`write_videos`; ``calibration.json`` and ``comparison.pdf`` are written into it.
    """
    hand = Hand(dock)
    calibration: Any = hand.show("Calibration")
    form = calibration.form
    hand.click(form.steps["pair"], "bundle pair")
    measured = lambda: calibration.candidate is not None and not calibration.work.busy  # noqa: E731
    hand.drop(calibration, folder / TRANSMISSION, measured)
    hand.type(form.bundle_um, BUNDLE_UM, "bundle Ø")
    hand.type(form.line_period_us, 7.648, "line period")
    hand.type(form.periods_per_frame, 544.8, "periods / frame")
    hand.click(form.accept, "Accept")
    hand.click_and_confirm(form.save, "Save...", (folder / "calibration.json").exists)
    compare: Any = hand.show("Compare")
    hand.drop(compare, folder / TISSUE, lambda: bool(compare.start.enabled))
    hand.click(compare.start.native, "Compare", lambda: compare.comparing and not compare.work.busy)
    drawn = compare.display.line
    start, end = (_on_canvas(compare, at) for at in LINE)
    canvas = compare.window().findChildren(QOpenGLWidget)[0]
    hand.draw_line(canvas, start, end, lambda: compare.display.line != drawn)
    saved = lambda: (folder / "comparison.pdf").exists() and not compare.work.busy  # noqa: E731
    hand.click_and_confirm(compare.save_figure.native, "Save figure...", saved)
    return hand


def walk_to_mosaic(hand: Hand, folder: Path) -> None:
    """Go on from the figure to a mosaic of the same recording, written into the folder."""
    compare: Any = hand.dock.by_title["Compare"].panel
    hand.click(compare.start.native, "End comparison", lambda: not compare.comparing)
    mosaic: Any = hand.show("Mosaic")
    hand.click(mosaic.form.start.native, "Mosaic", lambda: not mosaic.work.busy)
    saved = lambda: not mosaic.work.busy and any(folder.glob("*.track.csv"))  # noqa: E731
    hand.click_and_confirm(mosaic.form.saving.native, "Save...", saved)


def _on_canvas(compare: ComparePanel, at: tuple[float, float]) -> QPoint:
    """Return the pixel of the canvas at a place (row, col) of the first image, in image widths."""
    image, viewer = compare.display.images[0], compare.viewer
    world = np.array(at) * image.data.shape[-2:] * image.scale[-2:]
    row, col = (world - viewer.scene.camera.center[-2:]) * viewer.scene.camera.zoom + np.array(viewer.canvas.size) / 2
    return QPoint(round(col), round(row))


def _write_avi(path: Path, frames: Iterator[NDArray[np.uint8]]) -> None:
    """Write frames (rows, cols) as an uncompressed video whose header has another rate than the camera."""
    first = next(frames)
    writer = imageio_ffmpeg.write_frames(
        str(path), first.shape[::-1], pix_fmt_in="gray", pix_fmt_out="gray", fps=PLAYBACK_HZ, codec="rawvideo",
        macro_block_size=1,
    )  # fmt: skip
    writer.send(None)
    for frame in (first, *frames):
        writer.send(np.ascontiguousarray(frame).tobytes())
    writer.close()
