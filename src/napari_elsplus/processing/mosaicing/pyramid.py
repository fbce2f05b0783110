"""Image pyramid of a growing mosaic for display: only what changed is recomputed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.processing.compiled import kernel
from napari_elsplus.processing.mosaicing.tiles import (
    TILE_PX,
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
        self._half = np.empty((TILE_PX, TILE_PX), np.float32)
        self._count = np.empty((TILE_PX, TILE_PX), np.float32)

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
            rows, cols = block.shape
            image, weight = self.read(
                level - 1, Rectangle(2 * block.top, 2 * block.left, 2 * block.bottom, 2 * block.right)
            )
            half, count = self._half[:rows, :cols], self._count[:rows, :cols]
            if not halve(image, weight, half, count) and key not in existing:
                continue
            tile, there = store.tile(*key), block.slices(at)
            tile.value[there], tile.weight[there] = half, count


@kernel
def halve(
    image: NDArray[np.float32], weight: NDArray[np.float32], half: NDArray[np.float32], count: NDArray[np.float32]
) -> bool:
    """Average 2 x 2 pixels, counting those that have a weight; return True if any has.

    Parameters
    ----------
    image, weight : numpy.ndarray
        (2 rows, 2 cols) float32.
    half, count : numpy.ndarray
        (rows, cols) float32, filled with the means and with how many of the four have a weight.
    """
    any_drawn = False
    for row in range(half.shape[0]):
        for col in range(half.shape[1]):
            total, drawn = np.float32(0), np.float32(0)
            for down in range(2):
                for across in range(2):
                    if weight[2 * row + down, 2 * col + across] > 0:
                        total += image[2 * row + down, 2 * col + across]
                        drawn += np.float32(1)
            count[row, col] = drawn
            half[row, col] = total / drawn if drawn > 0 else np.float32(0)
            if drawn > 0:
                any_drawn = True
    return any_drawn
