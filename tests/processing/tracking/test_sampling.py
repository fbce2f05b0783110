from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.tracking.sampling import reaches, sample_finely, sample_row

SIDE = 40


def samples(kernel: object, image: np.ndarray, row: float, col: float, size: int) -> np.ndarray:
    out = np.zeros((2, image.shape[1]), np.float32)
    above, left = int(row), int(col)
    kernel(image, above, row - above, left, col - left, size, out)  # type: ignore[operator]
    return out[0, :size].copy()


def wave(row: np.ndarray, col: np.ndarray, radians_per_px: float) -> np.ndarray:
    return np.exp(1j * radians_per_px * (0.6 * row + 0.8 * col))


@pytest.mark.parametrize(("kernel", "degree"), [(sample_row, 1), (sample_finely, 5)])
def test_polynomials_are_met_exactly(kernel: object, degree: int) -> None:
    """Of first degree between four pixels, of fifth through six by six."""
    row, col = np.mgrid[:SIDE, :SIDE] / SIDE
    image = ((row - 0.4) ** degree + 2 * (col - 0.5) ** degree).astype(np.float32)
    at_row, at_col = 20.3, 11.8
    expected = (at_row / SIDE - 0.4) ** degree + 2 * ((at_col + np.arange(15)) / SIDE - 0.5) ** degree
    np.testing.assert_allclose(samples(kernel, image, at_row, at_col, 15), expected, atol=2e-6)


@pytest.mark.parametrize("part", [0.1, 0.25, 0.4, 0.75])
def test_fine_structure_is_not_moved(part: float) -> None:
    """A wave six pixels long is met within a thousandth of a pixel; between four pixels it is not."""
    row, col = np.mgrid[:SIDE, :SIDE]
    expected = wave(np.array(15 + part), 10 + part + np.arange(20), 1.0)
    moved = {}
    for kernel in (sample_row, sample_finely):
        found = sum(
            unit * samples(kernel, getattr(wave(row, col, 1.0), name).astype(np.float32), 15 + part, 10 + part, 20)
            for unit, name in ((1, "real"), (1j, "imag"))
        )
        moved[kernel] = abs(np.angle((found * expected.conj()).sum()))  # radians, which here are pixels
    assert moved[sample_finely] < 1e-3
    assert moved[sample_row] > 4 * moved[sample_finely]


def test_nothing_is_read_beyond_the_frame() -> None:
    """Fine samples need two pixels before and three after; the last run that reaches is the last that is possible."""
    assert reaches((SIDE, SIDE), 2, 2, SIDE - 5)
    assert not reaches((SIDE, SIDE), 1, 2, 5)
    assert not reaches((SIDE, SIDE), SIDE - 3, 2, 5)
    assert not reaches((SIDE, SIDE), 5, 1, 5)
    assert not reaches((SIDE, SIDE), 5, 2, SIDE - 4)
