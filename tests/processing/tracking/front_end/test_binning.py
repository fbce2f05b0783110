from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.errors import CalibrationError
from napari_elsplus.processing.tracking.front_end.binned_blocks import AHEAD, BLOCK
from napari_elsplus.processing.tracking.front_end.binning import scratch, view_blocks
from napari_elsplus.processing.tracking.front_end.grid import lit_pixels


def disc(side: int) -> tuple[np.ndarray, np.ndarray]:
    """First lit column of each row of a disc, and the one after the last."""
    y = np.arange(side) - (side - 1) / 2
    half = np.sqrt(np.maximum((side / 2 - 1) ** 2 - y**2, 0))
    first, last = np.ceil((side - 1) / 2 - half), np.floor((side - 1) / 2 + half) + 1
    lit = half > 0
    return np.where(lit, first, 1).astype(np.int32), np.where(lit, last, 1).astype(np.int32)


def shifted(row: float, col: float, turn: float = 0.0, scale: float = 1.0) -> np.ndarray:
    return np.array([[scale, -turn, row], [turn, scale, col]])


@pytest.mark.parametrize("binning", [1, 2, 3])
@pytest.mark.parametrize(("turn", "scale"), [(0.0, 1.0), (0.003, 1.001), (-0.2, 0.9)])
def test_every_lit_pixel_is_filled_from_where_its_view_lies(binning: int, turn: float, scale: float) -> None:
    side, frame = 60, (400, 700)
    spans = disc(side)
    confocal, residual = shifted(40, 0), shifted(60.3, 350.6, turn, scale)
    blocks = view_blocks(confocal, residual, binning, lit_pixels(*spans), frame)
    rows_of_memory = scratch(side)
    memory = np.full((rows_of_memory.size, 4), np.nan)
    for n in range(len(blocks.places) - AHEAD):
        pixels = np.arange(BLOCK)
        filled = (int(blocks.places[n, 3]) >> pixels & 1).astype(bool)
        at = (blocks.places[n, :2, None] + binning * pixels)[:, filled]
        fractions = blocks.fractions[n, :, None] + np.array(blocks.slopes)[:, None] * pixels[filled]
        rows, cols = np.divmod(at, frame[1])
        there = np.stack([rows[0], cols[0], rows[1] + fractions[0], cols[1] + fractions[1]], axis=1)
        assert fractions.min() > -1e-4
        assert fractions.max() < 1 + 1e-4
        memory[blocks.places[n, 2] + pixels[filled]] = there
    for row, seen in enumerate(memory.reshape(*rows_of_memory.shape, 4)[:, BLOCK:], -2):
        lit = np.flatnonzero(~np.isnan(seen[:, 0]))
        begin_lit, end_lit = (int(span[row]) for span in spans) if 0 <= row < side else (0, 0)
        np.testing.assert_array_equal(lit, np.arange(begin_lit, max(begin_lit, end_lit)))
        half = (binning - 1) / 2
        middle = np.stack([np.full(len(lit), binning * row + half), binning * lit + half, np.ones(len(lit))])
        expected = np.concatenate([confocal @ middle, residual @ middle]).T - half
        np.testing.assert_allclose(seen[lit], expected, atol=1e-4)


@pytest.mark.parametrize(("row", "col"), [(0, 0), (0, 30), (139, 0), (139, 30)])
def test_blocks_read_within_the_frame(row: int, col: int) -> None:
    side, frame = 60, (200, 91)
    lit = lit_pixels(*disc(side))
    blocks = view_blocks(shifted(139 - row, 30 - col), shifted(row + 0.3, col + 0.3), 1, lit, frame)
    first, last = blocks.places[:, :2].min(), blocks.places[:, :2].max() + frame[1] + BLOCK
    assert first >= 0
    assert last < frame[0] * frame[1]
    assert blocks.places[:, 2].min() >= 0
    assert blocks.places[:, 2].max() + BLOCK <= scratch(side).size


def test_a_frame_smaller_than_a_block_is_refused() -> None:
    with pytest.raises(CalibrationError, match="frames of 5 x 6 pixels are too small"):
        view_blocks(shifted(0, 0), shifted(0, 0), 1, lit_pixels(*disc(4)), (5, 6))
