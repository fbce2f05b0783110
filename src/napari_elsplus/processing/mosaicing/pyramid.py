"""Image pyramid of a growing mosaic for display: only what changed is recomputed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from napari_elsplus.processing.mosaicing.tiles import (
    Canvas,
    HeapTiles,
    Rectangle,
    copy_tiles,
    tile_rectangle,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Pyramid:
    """Image pyramid of a canvas: a pixel is the mean of those of the four below it that have a weight.

    Parameters
    ----------
    canvas : Canvas
        Level 0; the pyramid consumes its dirty rectangles.
    levels : int
        Number of levels, the canvas itself included.
    """

    def __init__(self, canvas: Canvas, levels: int) -> None:
        self._canvas = canvas
        self._stores = [HeapTiles() for _ in range(levels - 1)]

    def refresh(self) -> list[Rectangle]:
        """Update all levels; return the rectangle that changed on each, or an empty list if nothing did."""
        dirty = self._canvas.take_dirty()
        if dirty is None:
            return []
        changed = [dirty]
        for level in range(1, len(self._stores) + 1):
            below = changed[-1]
            here = Rectangle(below.top // 2, below.left // 2, -(-below.bottom // 2), -(-below.right // 2))
            self._halve(level, here)
            changed.append(here)
        return changed

    def read(self, level: int, part: Rectangle) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Copy a part of a level.

        Returns
        -------
        image, weight : numpy.ndarray
            (rows, cols) float32 grey levels and weights; both 0 where nothing was drawn.
        """
        return self._canvas.read(part) if level == 0 else copy_tiles(self._stores[level - 1], part)

    def _halve(self, level: int, part: Rectangle) -> None:
        """Compute a part of a level from the one below, tile by tile, so that memory for one tile suffices."""
        store = self._stores[level - 1]
        existing = set(store.keys())
        for key in part.tiles():
            at = tile_rectangle(*key)
            block = part.intersection(at)
            image, weight = self.read(
                level - 1, Rectangle(2 * block.top, 2 * block.left, 2 * block.bottom, 2 * block.right)
            )
            half, count = halve(image, weight)
            if not count.any() and key not in existing:
                continue
            tile, there = store.tile(*key), block.slices(at)
            tile.value[there], tile.weight[there] = half, count


def halve(image: NDArray[np.float32], weight: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Average 2 x 2 pixels, counting those that have a weight.

    Parameters
    ----------
    image, weight : numpy.ndarray
        (2 rows, 2 cols) float32; grey levels are 0 where there is no weight.

    Returns
    -------
    half, count : numpy.ndarray
        (rows, cols) float32: the means, and how many of the four have a weight.
    """
    size = weight.shape[1] // 2, weight.shape[0] // 2
    light, share = (
        cv2.resize(each, size, interpolation=cv2.INTER_AREA) for each in (image, (weight > 0).astype(np.float32))
    )
    return np.divide(light, share, out=light, where=share > 0), 4 * share
