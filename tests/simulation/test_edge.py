"""The round edge of the bundle in the residual image (paper, Sec. 3.3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import Plane, Scene
from napari_elsplus.simulation.specimen.textures import Uniform

PAPER = Scene((Plane(Uniform()), Plane(Uniform(), 60.0, 0.8), Plane(Uniform(), 200.0, 1.5)))
"""Stained paper, averaged over a moving probe."""


def residual(offset_um: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Brightness of the residual view's cores over that in the centre, and their rows and columns (um)."""
    instrument = replace(Instrument.of("120hz", slit_um=8.8, offset_um=offset_um), autofluorescence=0.0)
    renderer = Renderer(instrument, PAPER, noise=False)
    cores = instrument.bundle.cores()
    values = renderer.core_values(0)[1] / cores.transmission
    centre = np.hypot(cores.rows_um, cores.cols_um) < 50
    return values / values[centre].mean(), cores.rows_um, cores.cols_um


def at(values: np.ndarray, inside: np.ndarray) -> float:
    assert inside.sum() > 20
    return float(values[inside].mean())


def test_a_wide_offset_leaves_the_top_dark_and_a_small_one_does_not() -> None:
    values, rows, cols = residual(-74.0)
    middle = np.abs(cols) < 40
    assert at(values, middle & (rows > -295) & (rows < -260)) < 0.05
    assert at(values, middle & (rows > 260) & (rows < 295)) > 0.9
    values, rows, cols = residual(-12.0)
    assert at(values, (np.abs(cols) < 40) & (np.abs(rows + 280) < 5)) > 0.9


def test_sides_are_darker_above_the_middle_than_below() -> None:
    """The line is shorter than the slit's chord while it leads towards the middle, and longer afterwards."""
    values, rows, cols = residual(-74.0)
    side = np.abs(np.abs(cols) - 240) < 15
    assert at(values, side & (np.abs(rows + 150) < 15)) < 0.5 * at(values, side & (np.abs(rows - 100) < 15))


@pytest.mark.parametrize("offset_um", [-74.0, 74.0])
def test_the_sign_says_which_rim_is_dark(offset_um: float) -> None:
    values, rows, cols = residual(offset_um)
    dark_side = np.sign(offset_um) * rows
    assert at(values, (np.abs(cols) < 40) & (dark_side > 260)) < 0.05
