"""Simulated calibration recordings: standing line, galvo sweep, transmission, background in a dark tube."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.simulation.rendering.frames import RenderedFrames
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import distal_light, empty

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.instrument import Instrument

LINE_FRAMES: Final = 5
"""Frames of the standing line; chosen."""
SWEEP_STEPS: Final = 400
"""Voltages of a galvo sweep; chosen, about one for each row of the bundle."""
TRANSMISSION_FRAMES: Final = 5
"""Frames of the bundle lit from its distal end; chosen."""
DARK_TUBE_SEED: Final = 3
"""Added to the seed of a recording for the frames in a dark tube, whose noise is then another; chosen."""
BACKGROUND_FRAMES: Final = 50
"""Frames that are averaged to the background; chosen, their mean has a seventh of a frame's noise."""
LINE_LIGHT_FACTOR: Final = 25.0
"""Factor on the light for a standing line, seen by the bundle's weak autofluorescence alone; chosen."""


def standing_line(instrument: Instrument, volts: NDArray[np.float64], *, seed: int = 0) -> RenderedFrames:
    """Return frames of a standing laser line in a dark tube, one frame at each voltage.

    Parameters
    ----------
    instrument : Instrument
        The instrument, with its galvo map.
    volts : numpy.ndarray
        (n,) galvo voltages, one per frame.
    seed : int
        Seed of the camera's noise.
    """
    bright = replace(instrument, light_dn=instrument.light_dn * LINE_LIGHT_FACTOR)
    renderer = Renderer(bright, empty(), seed=seed)

    def render(index: int) -> NDArray[np.uint8]:
        held_rows = np.full(instrument.frame_shape[0], instrument.line_row(volts[index]))
        return renderer.render(index, line_rows=held_rows)

    return RenderedFrames(render, len(volts))


def line_volts(instrument: Instrument) -> NDArray[np.float64]:
    """Return the voltages (5,), V, of the standing line near the middle of an instrument's bundle."""
    row = instrument.confocal_centre[0] + 3.3
    return np.full(LINE_FRAMES, instrument.volts_at_row_zero + instrument.volts_per_row * row)


def sweep_volts(instrument: Instrument) -> NDArray[np.float64]:
    """Return the voltages (400,), V, of a sweep across an instrument's bundle, from rim to rim and a tenth beyond."""
    reach = 0.6 * instrument.diameter_px
    rows = instrument.confocal_centre[0] + np.linspace(-reach, reach, SWEEP_STEPS)
    return np.asarray(instrument.volts_at_row_zero + instrument.volts_per_row * rows)


def transmission(instrument: Instrument, *, seed: int = 0) -> RenderedFrames:
    """Return frames of the bundle evenly lit from its distal end.

    Parameters
    ----------
    instrument : Instrument
        The simulated instrument.
    seed : int
        Seed of the camera's noise.
    """
    return RenderedFrames(Renderer(instrument, distal_light(), seed=seed).render, TRANSMISSION_FRAMES)


def dark_tube(instrument: Instrument, *, seed: int = 0) -> RenderedFrames:
    """Return frames of the probe in a dark tube, the laser on and scanning.

    Parameters
    ----------
    instrument : Instrument
        The simulated instrument.
    seed : int
        Seed of the camera's noise.
    """
    return RenderedFrames(Renderer(instrument, empty(), seed=seed).render, BACKGROUND_FRAMES)


def background(instrument: Instrument, *, seed: int = 0) -> NDArray[np.float32]:
    """Return the background: mean of the frames in a dark tube, (rows, cols) float32.

    Parameters
    ----------
    instrument : Instrument
        The simulated instrument.
    seed : int
        Seed of the frames that it is taken off; the camera's noise in it is another one than theirs.
    """
    total = np.zeros(instrument.frame_shape, np.uint32)
    for frame in dark_tube(instrument, seed=seed + DARK_TUBE_SEED):
        total += frame
    return (total / BACKGROUND_FRAMES).astype(np.float32)
