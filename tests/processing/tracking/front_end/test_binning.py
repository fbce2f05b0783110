from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.errors import CalibrationError
from napari_elsplus.processing.tracking.front_end.binned_blocks import AHEAD, BLOCK
from napari_elsplus.processing.tracking.front_end.binning import MARGIN, scratch, subtract_views, view_blocks
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
    begin = 0
    for row, (end, first, last) in enumerate(blocks.rows.tolist()):
        seen = np.full((scratch(side).size, 4), np.nan)
        for n in range(begin, end):
            pixels = np.arange(BLOCK)
            filled = (int(blocks.places[n, 3]) >> pixels & 1).astype(bool)
            at = (blocks.places[n, :2, None] + binning * pixels)[:, filled]
            fractions = blocks.fractions[n, :, None] + np.array(blocks.slopes)[:, None] * pixels[filled]
            rows, cols = np.divmod(at, frame[1])
            there = np.stack([rows[0], cols[0], rows[1] + fractions[0], cols[1] + fractions[1]], axis=1)
            assert fractions.min() > -1e-4
            assert fractions.max() < 1 + 1e-4
            seen[blocks.places[n, 2] + pixels[filled]] = there
        begin = end
        at_row, lit = np.nonzero(~np.isnan(seen[:, 0].reshape(scratch(side).shape)[:, MARGIN:]))
        assert (at_row == row % len(scratch(side))).all()
        np.testing.assert_array_equal(lit, np.arange(int(spans[0][row]), int(spans[1][row])))
        assert not len(lit) or (first, last) == (lit[0], lit[-1] + 1)
        half = (binning - 1) / 2
        middle = np.stack([np.full(len(lit), binning * row + half), binning * lit + half, np.ones(len(lit))])
        expected = np.concatenate([confocal @ middle, residual @ middle]).T - half
        found = seen.reshape(*scratch(side).shape, 4)[row % len(scratch(side)), MARGIN:][lit]
        np.testing.assert_allclose(found, expected, atol=1e-4)
    assert begin == len(blocks.places) - AHEAD


@pytest.mark.parametrize("side", [20, 60, 76])
def test_rows_are_smoothed_and_scaled_and_what_is_not_lit_is_zero(side: int) -> None:
    random = np.random.default_rng(side)
    frame = random.integers(0, 255, (120, 200), np.uint8)
    lit = lit_pixels(*disc(side))
    blocks = view_blocks(shifted(3, 5), shifted(4, 90), 1, lit, frame.shape)
    scale = np.where(lit, random.uniform(0.5, 2, lit.shape), 0).astype(np.float32)
    offset = np.where(lit, random.uniform(-9, 9, lit.shape), 0).astype(np.float32)
    memory, out = scratch(side), np.full((side + 1, side), np.nan, np.float32)
    memory[:] = np.nan
    weights = np.float32(1), np.float32(-2)
    frame.flags.writeable = False
    subtract_views(frame, frame, (0,), blocks, weights, scale, offset, memory, out[:side])
    views = [frame[top : top + side, left : left + side].astype(float) for top, left in ((3, 5), (4, 90))]
    smoothed = np.pad(np.where(lit, views[0] - 2 * views[1], 0), 2)
    for axis in (0, 1):
        smoothed = np.apply_along_axis(np.convolve, axis, smoothed, [1, 4, 6, 4, 1], "same")
    np.testing.assert_allclose(out[:side], scale * smoothed[2:-2, 2:-2] - offset, rtol=1e-4, atol=1e-2)
    assert np.isnan(out[side]).all()


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
