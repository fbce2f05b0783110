from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from napari_elsplus.processing.compiled import lean_kernel
from napari_elsplus.processing.tracking.front_end.sampling import finely_sampled, reaches, sampled, scratch

if TYPE_CHECKING:
    from collections.abc import Callable

SIDE = 40


@lean_kernel
def between_four(image, above, down, left, across, size, samples):
    sampled(image, above, down, left, across, size, samples)


@lean_kernel
def through_six(image, above, down, left, across, size, samples):
    finely_sampled(image, above, down, left, across, size, samples)


def samples(sampled: Callable[..., None], image: np.ndarray, row: float, col: float, size: int) -> np.ndarray:
    above, left = int(row), int(col)
    memory = scratch(SIDE)
    sampled(image, above, row - above, left, col - left, size, memory)
    return memory[:size]


def wave(row: np.ndarray, col: np.ndarray, radians_per_px: float) -> np.ndarray:
    return np.exp(1j * radians_per_px * (0.6 * row + 0.8 * col))


@pytest.mark.parametrize(("sampled", "degree"), [(between_four, 1), (through_six, 5)])
def test_polynomials_are_met_exactly(sampled: Callable[..., None], degree: int) -> None:
    """Of first degree between four pixels, of fifth through six by six."""
    row, col = np.mgrid[:SIDE, :SIDE] / SIDE
    image = ((row - 0.4) ** degree + 2 * (col - 0.5) ** degree).astype(np.float32)
    at_row, at_col = 20.3, 11.8
    expected = (at_row / SIDE - 0.4) ** degree + 2 * ((at_col + np.arange(15)) / SIDE - 0.5) ** degree
    np.testing.assert_allclose(samples(sampled, image, at_row, at_col, 15), expected, atol=2e-6)


@pytest.mark.parametrize("part", [0.1, 0.25, 0.4, 0.75])
def test_fine_structure_is_not_moved(part: float) -> None:
    """A wave six pixels long is met within a thousandth of a pixel; between four pixels it is not."""
    row, col = np.mgrid[:SIDE, :SIDE]
    expected = wave(np.array(15 + part), 10 + part + np.arange(20), 1.0)
    moved = {}
    for kernel in (between_four, through_six):
        found = sum(
            unit * samples(kernel, getattr(wave(row, col, 1.0), name).astype(np.float32), 15 + part, 10 + part, 20)
            for unit, name in ((1, "real"), (1j, "imag"))
        )
        moved[kernel] = abs(np.angle((found * expected.conj()).sum()))  # radians, which here are pixels
    assert moved[through_six] < 1e-3
    assert moved[between_four] > 4 * moved[through_six]


def test_nothing_is_read_beyond_the_frame() -> None:
    """Fine samples need two pixels before and three after; the last run that reaches is the last that is possible."""
    assert reaches((SIDE, SIDE), 2, 2, SIDE - 5)
    assert not reaches((SIDE, SIDE), 1, 2, 5)
    assert not reaches((SIDE, SIDE), SIDE - 3, 2, 5)
    assert not reaches((SIDE, SIDE), 5, 1, 5)
    assert not reaches((SIDE, SIDE), 5, 2, SIDE - 4)


@pytest.mark.parametrize("size", [1, 3, 8, 30, SIDE - 5])
def test_a_row_of_any_length_is_sampled_up_to_the_edge(size: int) -> None:
    """Each sample is the one that it is by itself, also where more samples than are wanted do not fit the frame."""
    image = np.random.default_rng(0).normal(size=(SIDE, SIDE)).astype(np.float32)
    left = SIDE - 3 - size
    alone = [samples(through_six, image, 20.3, left + k + 0.4, 1)[0] for k in range(size)]
    np.testing.assert_allclose(samples(through_six, image, 20.3, left + 0.4, size), alone, atol=1e-5)
