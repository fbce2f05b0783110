"""What a microscopist records to calibrate the rig: a standing line, a sweep, distal light, the dark tube."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import distal_light, empty

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.instrument import Instrument

LINE_FRAMES: Final = 5
SWEEP_STEPS: Final = 400
TRANSMISSION_FRAMES: Final = 5
BACKGROUND_FRAMES: Final = 50
LASER_TURNED_UP: Final = 25.0
"""The standing line is seen by the bundle's own weak fluorescence, so the laser is turned up for it."""


def standing_line(instrument: Instrument, volts: NDArray[np.float64], *, seed: int = 0) -> Iterator[NDArray[np.uint8]]:
    """Frames of a laser line that stands still, one frame at each voltage.

    Parameters
    ----------
    instrument : Instrument
        The instrument; its galvo map says where a voltage puts the line.
    volts : numpy.ndarray
        One voltage per frame.
    seed : int
        Seed of the camera's noise.

    Yields
    ------
    numpy.ndarray
        Raw frame (rows, cols), uint8.
    """
    renderer = line_renderer(instrument, seed=seed)
    for k, volt in enumerate(volts):
        yield renderer.render(k, line_rows=held_rows(instrument, volt))


def line_renderer(instrument: Instrument, *, seed: int = 0) -> Renderer:
    """Return a renderer of frames in which nothing but the line is seen, for frames in any order."""
    bright = replace(instrument, light_dn=instrument.light_dn * LASER_TURNED_UP)
    return Renderer(bright, empty(), seed=seed)


def held_rows(instrument: Instrument, volt: float) -> NDArray[np.float64]:
    """Row of the line, for :meth:`Renderer.render`, while a voltage holds it still."""
    row = (volt - instrument.volts_at_row_zero) / instrument.volts_per_row
    return np.full(instrument.frame_shape[0], row)


def line_volts(instrument: Instrument) -> NDArray[np.float64]:
    """Voltages that leave the line where it is needed for measuring the slit offset: near the bundle's middle."""
    row = instrument.left_centre[0] + 3.3
    return np.full(LINE_FRAMES, instrument.volts_at_row_zero + instrument.volts_per_row * row)


def sweep_volts(instrument: Instrument) -> NDArray[np.float64]:
    """Voltages of a slow sweep over the bundle, from outside to outside."""
    reach = 0.6 * instrument.diameter_px
    rows = instrument.left_centre[0] + np.linspace(-reach, reach, SWEEP_STEPS)
    return np.asarray(instrument.volts_at_row_zero + instrument.volts_per_row * rows)


def transmission(instrument: Instrument, *, seed: int = 0) -> Iterator[NDArray[np.uint8]]:
    """Frames of the bundle lit evenly from its far end."""
    renderer = Renderer(instrument, distal_light(), seed=seed)
    return (renderer.render(k) for k in range(TRANSMISSION_FRAMES))


def dark_tube(instrument: Instrument, *, seed: int = 0) -> Iterator[NDArray[np.uint8]]:
    """Frames of the probe in a dark tube, the laser on and scanning."""
    renderer = Renderer(instrument, empty(), seed=seed)
    return (renderer.render(k) for k in range(BACKGROUND_FRAMES))


def background(instrument: Instrument, *, seed: int = 0) -> NDArray[np.float32]:
    """Mean of the dark tube's frames (rows, cols), as the paper subtracts it."""
    total = np.zeros(instrument.frame_shape, np.uint32)
    for frame in dark_tube(instrument, seed=seed):
        total += frame
    return (total / BACKGROUND_FRAMES).astype(np.float32)
