from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.mosaicing.mosaic import Mosaic
from napari_elsplus.processing.mosaicing.pyramid import Pyramid
from napari_elsplus.processing.mosaicing.sheet import GAP_PX, RESERVED_STEP_PX, Sheet
from napari_elsplus.processing.mosaicing.tiles import Rectangle
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter

GRID = Grid(120, 1, (0, 0), (59.5, 59.5), 116.0, RollingShutter(150.0))


def drawn(level: float, *places: tuple[float, float]) -> Mosaic:
    mosaic = Mosaic(GRID)
    for row, col in places:
        mosaic.insert(np.full((120, 120), level, np.float32), row, col)
    return mosaic


def shown(sheet: Sheet, row: int, col: int) -> float:
    return float(sheet.read(Rectangle(row, col, row + 1, col + 1))[0][0, 0])


def test_segments_lie_below_one_another_and_do_not_overlap() -> None:
    sheet = Sheet()
    sheet.arrange({0: drawn(1, (0, 0), (40, 600)), 1: drawn(2, (-900, 30)), 4: drawn(3, (7, 7))})
    assert sheet.origin(0) == (0, 0)
    for number, level, at in ((0, 1, (40, 600)), (1, 2, (-900, 30)), (4, 3, (7, 7))):
        row, col = np.add(sheet.origin(number), at)
        assert shown(sheet, row, col) == level
    image, weight = sheet.read()
    assert [(image == level).sum() for level in (2, 3)] == [(drawn(1, (0, 0)).read()[1] > 0).sum()] * 2
    assert ((image > 0) == (weight > 0)).all()


def test_growth_within_the_room_moves_nothing_and_only_that_is_dirty() -> None:
    first, second = drawn(1, (0, 0)), drawn(2, (0, 0))
    sheet = Sheet()
    sheet.arrange({0: first, 1: second})
    sheet.take_dirty()
    place = sheet.origin(1)
    touched = first.insert(np.ones((120, 120), np.float32), 5.0, 6.0)
    assert not sheet.arrange({0: first, 1: second})
    assert sheet.take_dirty() == touched
    assert sheet.take_dirty() is None
    assert sheet.origin(1) == place


@pytest.mark.parametrize("row", [-1500.0, 1500.0])
def test_growth_beyond_the_room_moves_those_below_and_the_pyramid_follows(row: float) -> None:
    first, second = drawn(1, (0, 0)), drawn(2, (0, 0))
    sheet = Sheet()
    pyramid = Pyramid(sheet, 3)
    sheet.arrange({0: first, 1: second})
    pyramid.refresh()
    before = sheet.origin(1)
    first.insert(np.ones((120, 120), np.float32), row, 0.0)
    moved = sheet.arrange({0: first, 1: second})
    assert moved == (row > 0)
    assert sheet.origin(1)[0] == (before[0] + 24 * RESERVED_STEP_PX if row > 0 else before[0])
    pyramid.refresh()
    whole = Rectangle(-2048, -512, 4096, 1024)
    for level in (1, 2):
        part = Rectangle(*(edge // 2**level for edge in whole))
        _, weight = pyramid.read(level, part)
        half = pyramid.read(level - 1, Rectangle(*(2 * edge for edge in part)))[1] > 0
        np.testing.assert_array_equal(weight > 0, _any(half))


def _any(drawn: np.ndarray) -> np.ndarray:
    rows, cols = drawn.shape
    return drawn.reshape(rows // 2, 2, cols // 2, 2).any(axis=(1, 3))


def test_a_segment_that_is_gone_leaves_an_empty_place() -> None:
    first, second = drawn(1, (0, 0)), drawn(2, (0, 0))
    sheet = Sheet()
    sheet.arrange({0: first, 1: second})
    row, col = sheet.origin(1)
    assert row == 2 * RESERVED_STEP_PX + GAP_PX
    sheet.take_dirty()
    assert sheet.arrange({0: first})
    dirty = sheet.take_dirty()
    assert dirty is not None
    assert dirty.intersection(Rectangle(row, col, row + 1, col + 1)).shape == (1, 1)
    assert shown(sheet, row, col) == 0


def test_other_canvases_lie_where_those_of_the_same_numbers_lie() -> None:
    leader, other = Sheet(), Sheet()
    leader.arrange({0: drawn(1, (0, 0), (0, 900)), 1: drawn(2, (0, 0)), 2: drawn(3, (0, 0))})
    other.arrange({0: drawn(5, (0, 0)), 2: drawn(6, (0, 0))}, leader)
    assert other.origins == {number: leader.origins[number] for number in (0, 2)}
    row, col = leader.origin(2)
    assert (shown(leader, row, col), shown(other, row, col)) == (3, 6)
