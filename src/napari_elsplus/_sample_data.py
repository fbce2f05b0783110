"""napari's sample data: a recording, a calibration set and an axial scan, rendered when their frames are displayed."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from threading import Lock, current_thread, main_thread
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from napari.utils import progress
from napari.utils.notifications import show_info
from qtpy.QtCore import QEventLoop
from qtpy.QtWidgets import QApplication

from napari_elsplus._view import open_in_viewer
from napari_elsplus.instrument.optics import preset
from napari_elsplus.processing.compilation import compilation_remark, reported_compilation
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.viewing.axial import simulated_scan
from napari_elsplus.viewing.layers import image_layers, raw_layer, side_by_side, titles_above
from napari_elsplus.viewing.lazy import LazyPlanes
from napari_elsplus.viewing.provenance import PROVENANCE
from napari_elsplus.viewing.stack import Stack
from napari_elsplus.workflows.simulated import simulate_calibration, simulate_recording

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from napari_elsplus.simulation.rendering.frames import RenderedFrames

PRESET: Final = "240hz"
FRAMES: Final = 480
"""Frames of the sample recording: two seconds at 240 Hz."""
SHOWN: Final = (Mode.LS, Mode.RESIDUAL, Mode.ELS)
"""Images of the sample recording that are displayed, from left to right."""
COMPILING: Final = "the first images after an installation take some seconds: kernels are compiled once"
SEED: Final = 1
"""Seed of specimen, motion and noise; chosen."""


@contextmanager
def compilation_displayed() -> Iterator[None]:
    """Return a context in which the window names the kernels that are compiled, between which it is drawn.

    napari makes samples in the window's thread, and the first one after an installation compiles for some seconds.
    """
    bars: list[Any] = []

    def report(kernel: str) -> None:
        if current_thread() is not main_thread() or QApplication.instance() is None:
            return
        if kernel and not bars:
            show_info(COMPILING)
            bars.append(progress(total=0))
        if kernel:
            bars[0].set_description(compilation_remark(kernel))
        QApplication.processEvents(QEventLoop.ProcessEventsFlag.ExcludeUserInputEvents)

    try:
        with reported_compilation(report):
            yield
    finally:
        for bar in bars:
            bar.close()


@compilation_displayed()
def recording() -> list[tuple[Any, ...]]:
    """Return layers of a probe moved by hand over fibres for two seconds: titles, raw, ELSA, LS, residual, ELS+."""
    frames = simulate_recording(frames=FRAMES, seed=SEED)
    stack = Stack("fibres", _planes(frames), _metadata())
    raw = raw_layer(stack, frames.calibration)
    raw[1]["visible"] = False
    *shown, elsa = image_layers(stack, frames.calibration)
    placed = side_by_side(shown)
    return open_in_viewer([titles_above("fibres titles", placed, [mode.label for mode in SHOWN]), raw, elsa, *placed])


@compilation_displayed()
def calibration_set() -> list[tuple[Any, ...]]:
    """Return layers of calibration recordings: standing line, sweep with its voltages, transmission, background."""
    taken = simulate_calibration(seed=SEED)
    parts = {"dark tube": taken.background, "distal light": taken.bundle, "sweep": taken.sweep, "line": taken.line}
    layers = []
    for name, frames in parts.items():
        layer = raw_layer(Stack(name, _planes(frames), _metadata()))
        layer[1]["name"] = f"calibration {name}"
        layer[1]["visible"] = name == "distal light"
        if name == "sweep":
            layer[1]["metadata"][PROVENANCE]["volts"] = taken.volts
        layers.append(layer)
    return open_in_viewer(layers)


@compilation_displayed()
def axial_scan() -> list[tuple[Any, ...]]:
    """Return layers of an axial scan of a stained plate: raw, LS, residual, ELS+."""
    stack, calibration = simulated_scan(seed=SEED)
    stack = replace(stack, name="plate")
    raw = raw_layer(stack, calibration)
    raw[1]["visible"] = False
    return open_in_viewer([raw, *image_layers(stack, calibration)])


def _planes(frames: RenderedFrames) -> LazyPlanes:
    """Return lazily rendered frames, one thread at a time: the renderer caches the scene around the probe."""
    lock = Lock()

    def plane(index: int) -> NDArray[Any]:
        with lock:
            return frames[index]

    return LazyPlanes(plane, (len(frames), *preset(PRESET).frame_shape), np.dtype(np.uint8))


def _metadata() -> dict[str, Any]:
    optics = preset(PRESET).optics
    return {"um_per_px": optics.um_per_px, "frame_period_s": optics.frame_period_s}
