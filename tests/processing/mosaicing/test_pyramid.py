from __future__ import annotations

import numpy as np

from napari_elsplus.processing.mosaicing.mosaic import Mosaic
from napari_elsplus.processing.mosaicing.pyramid import Pyramid
from napari_elsplus.processing.mosaicing.tiles import Rectangle
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter

GRID = Grid(120, 1, (0, 0), (59.5, 59.5), 116.0, RollingShutter(150.0))


def frame(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((120, 120)).astype(np.float32)


def test_each_level_is_the_mean_of_what_was_drawn_on_the_one_below() -> None:
    mosaic = Mosaic(GRID)
    pyramid = Pyramid(mosaic, 3)
    for k, (row, col) in enumerate([(0.0, 0.0), (-300.0, 515.0), (-301.0, 540.0)]):
        mosaic.insert(frame(k), row, col)
        pyramid.refresh()
    whole = Rectangle(-512, -512, 1024, 1024)
    image, weight = pyramid.read(0, whole)
    for level in (1, 2):
        size = image.shape[0] // 2
        drawn = weight > 0
        count = drawn.reshape(size, 2, size, 2).sum(axis=(1, 3))
        total = (image * drawn).reshape(size, 2, size, 2).sum(axis=(1, 3))
        expected = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
        scale = 2**level
        image, weight = pyramid.read(level, Rectangle(*(edge // scale for edge in whole)))
        np.testing.assert_allclose(image, expected, atol=1e-6)
        assert ((weight > 0) == (count > 0)).all()


def test_only_what_changed_is_computed_and_told() -> None:
    mosaic = Mosaic(GRID)
    pyramid = Pyramid(mosaic, 4)
    assert pyramid.refresh() == []
    touched = mosaic.insert(frame(0), 1000.0, -700.0)
    changed = pyramid.refresh()
    assert changed[0] == touched
    assert [part.shape[0] for part in changed] == [touched.shape[0], *(part.shape[0] for part in changed[1:])]
    assert changed[3].shape[0] <= touched.shape[0] // 8 + 2
    assert pyramid.refresh() == []
