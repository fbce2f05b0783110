"""A mosaic at halved resolutions for display: only what changed is computed anew."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.processing.tiles import HeapTiles, Rectangle, TileStore, tile_rectangle

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.processing.mosaic import Mosaic


class Pyramid:
    """Halves of a mosaic, each pixel the mean of those of the four below it that were drawn on.

    Parameters
    ----------
    mosaic : Mosaic
        Level 0; the pyramid takes its dirty rectangles.
    levels : int
        Number of levels, the mosaic itself included.
    new_store : callable
        Makes the store of a level's tiles.
    """

    def __init__(self, mosaic: Mosaic, levels: int, new_store: Callable[[], TileStore] = HeapTiles) -> None:
        self._mosaic = mosaic
        self._stores = [new_store() for _ in range(levels - 1)]

    def refresh(self) -> list[Rectangle]:
        """Bring all levels up to date; return what changed on each, an empty list if nothing did."""
        dirty = self._mosaic.take_dirty()
        if dirty is None:
            return []
        changed = [dirty]
        for level, store in enumerate(self._stores):
            below = changed[-1]
            here = Rectangle(below.top // 2, below.left // 2, -(-below.bottom // 2), -(-below.right // 2))
            image, weight = self.read(level, Rectangle(2 * here.top, 2 * here.left, 2 * here.bottom, 2 * here.right))
            _draw(store, here, *_halved(image, weight))
            changed.append(here)
        return changed

    def read(self, level: int, part: Rectangle) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Copy a part of a level: grey levels, and 0 or more where nothing or something was drawn."""
        if level == 0:
            return self._mosaic.read(part)
        store = self._stores[level - 1]
        image, weight = np.zeros(part.shape, np.float32), np.zeros(part.shape, np.float32)
        existing = set(store.keys())
        for key in part.tiles():
            if key in existing:
                here, there = _overlap(part, key)
                image[here], weight[here] = store.tile(*key).value[there], store.tile(*key).weight[there]
        return image, weight


def _halved(image: NDArray[np.float32], weight: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    rows, cols = image.shape
    drawn = (weight > 0).astype(np.float32)
    total = (image * drawn).reshape(rows // 2, 2, cols // 2, 2).sum(axis=(1, 3))
    count = drawn.reshape(rows // 2, 2, cols // 2, 2).sum(axis=(1, 3))
    return np.divide(total, count, out=np.zeros_like(total), where=count > 0), count


def _draw(store: TileStore, part: Rectangle, image: NDArray[np.float32], weight: NDArray[np.float32]) -> None:
    for key in part.tiles():
        here, there = _overlap(part, key)
        tile = store.tile(*key)
        tile.value[there], tile.weight[there] = image[here], weight[here]


def _overlap(part: Rectangle, key: tuple[int, int]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Where a rectangle and a tile meet, in the pixels of each."""
    at = tile_rectangle(*key)
    shared = part.within(at)
    here, there = (
        (slice(shared.top - o.top, shared.bottom - o.top), slice(shared.left - o.left, shared.right - o.left))
        for o in (part, at)
    )
    return here, there
