"""napari's sample data: a recording, a calibration set and an axial scan, rendered when their frames are displayed."""

from __future__ import annotations

from dataclasses import replace
from threading import Lock
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.simulation import calibration_scenes as scenes
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import distal_light, empty, scene
from napari_elsplus.simulation.specimen.trajectories import trajectory
from napari_elsplus.simulation.truth import true_calibration
from napari_elsplus.viewing.axial import simulated_scan
from napari_elsplus.viewing.layers import image_layers, raw_layer, side_by_side
from napari_elsplus.viewing.lazy import LazyPlanes
from napari_elsplus.viewing.stack import Stack

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

FRAMES: Final = 480
"""Frames of the sample recording: two seconds at 240 Hz."""
SEED: Final = 1
"""Seed of specimen, motion and noise; chosen."""


def recording() -> list[tuple[Any, ...]]:
    """Return layers of a probe moved by hand over stained fibres for two seconds: raw, LS, residual, ELS+, ELSA."""
    instrument = Instrument.of("240hz")
    renderer = Renderer(instrument, scene("fibres", SEED), trajectory("hand", seed=SEED), seed=SEED)
    stack = Stack("fibres", _planes(instrument, FRAMES, renderer.render), _metadata(instrument))
    calibration = true_calibration(instrument, scenes.background(instrument, seed=SEED))
    raw = raw_layer(stack, calibration)
    raw[1]["visible"] = False
    *shown, elsa = image_layers(stack, calibration)
    return [raw, elsa, *side_by_side(shown)]


def calibration_set() -> list[tuple[Any, ...]]:
    """Return layers of calibration recordings: standing line, sweep with its voltages, transmission, background."""
    instrument = Instrument.of("240hz")
    line = scenes.line_renderer(instrument, seed=SEED)
    lit = Renderer(instrument, distal_light(), seed=SEED + 1)
    dark = Renderer(instrument, empty(), seed=SEED + 2)
    still, sweep = scenes.line_volts(instrument), scenes.sweep_volts(instrument)
    parts: list[tuple[str, int, Callable[[int], NDArray[Any]], NDArray[np.float64] | None]] = [
        ("dark tube", scenes.BACKGROUND_FRAMES, dark.render, None),
        ("distal light", scenes.TRANSMISSION_FRAMES, lit.render, None),
        ("sweep", len(sweep), lambda k: line.render(k, line_rows=scenes.held_rows(instrument, sweep[k])), sweep),
        ("line", len(still), lambda k: line.render(k, line_rows=scenes.held_rows(instrument, still[k])), None),
    ]
    layers = []
    for name, count, render, volts in parts:
        layer = raw_layer(Stack(name, _planes(instrument, count, render), _metadata(instrument)))
        layer[1]["name"] = f"calibration {name}"
        layer[1]["visible"] = name == "distal light"
        if volts is not None:
            layer[1]["metadata"]["elsplus"]["volts"] = volts
        layers.append(layer)
    return layers


def axial_scan() -> list[tuple[Any, ...]]:
    """Return layers of an axial scan of a stained plate: raw, LS, residual, ELS+."""
    stack, calibration = simulated_scan(seed=SEED)
    stack = replace(stack, name="plate")
    raw = raw_layer(stack, calibration)
    raw[1]["visible"] = False
    return [raw, *image_layers(stack, calibration)]


def _planes(instrument: Instrument, count: int, render: Callable[[int], NDArray[Any]]) -> LazyPlanes:
    """Return lazily rendered frames, one thread at a time: the renderer caches the scene around the probe."""
    lock = Lock()

    def plane(index: int) -> NDArray[Any]:
        with lock:
            return render(index)

    return LazyPlanes(plane, (count, *instrument.frame_shape), np.dtype(np.uint8))


def _metadata(instrument: Instrument) -> dict[str, Any]:
    return {"um_per_px": instrument.optics.um_per_px, "frame_period_s": instrument.optics.frame_period_s}
