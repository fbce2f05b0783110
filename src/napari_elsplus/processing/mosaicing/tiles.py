"""Unbounded canvas of square tiles, which are allocated where something is drawn."""

from __future__ import annotations

from threading import Lock
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    Slices = tuple[slice, slice]

TILE_PX: Final = 256
"""Rows and columns of a tile; chosen: a frame of 250 pixels falls on at most four, each of 0.5 MB. Of tiles of 512 a
path touches more than twice the memory, which takes longer than to insert into more of them."""
_MIDDLE_PX: Final = TILE_PX // 2
"""Row and column of tile (0, 0) on which the canvas' origin lies, so that a mosaic begins within one tile."""


class Rectangle(NamedTuple):
    """Half-open rectangle of the canvas: rows `top` to `bottom`, columns `left` to `right`, the last ones excluded."""

    top: int
    left: int
    bottom: int
    right: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return max(0, self.bottom - self.top), max(0, self.right - self.left)

    def intersection(self, other: Rectangle) -> Rectangle:
        """Return the intersection with an `other` rectangle; it may be empty."""
        return Rectangle(
            max(self.top, other.top),
            max(self.left, other.left),
            min(self.bottom, other.bottom),
            min(self.right, other.right),
        )

    def union(self, other: Rectangle) -> Rectangle:
        """Return the smallest rectangle that contains this one and an `other`."""
        (top, left, bottom, right), (other_top, other_left, other_bottom, other_right) = self, other
        if other_top >= top and other_left >= left and other_bottom <= bottom and other_right <= right:
            return self
        return Rectangle(min(top, other_top), min(left, other_left), max(bottom, other_bottom), max(right, other_right))

    def translated(self, rows: int, cols: int) -> Rectangle:
        """Return the rectangle translated downwards by `rows` and to the right by `cols`."""
        return Rectangle(self.top + rows, self.left + cols, self.bottom + rows, self.right + cols)

    def grown(self, margin: int) -> Rectangle:
        """Return the rectangle with a margin on all sides."""
        return Rectangle(self.top - margin, self.left - margin, self.bottom + margin, self.right + margin)

    def aligned(self, step: int) -> Rectangle:
        """Return the rectangle, grown to multiples of a `step`."""
        first, last = (step * (edge // step) for edge in self[:2]), (-step * (-edge // step) for edge in self[2:])
        return Rectangle(*first, *last)

    def slices(self, whole: Rectangle) -> Slices:
        """Return row and column slices of this rectangle in an array of the whole rectangle, which contains it."""
        return (
            slice(self.top - whole.top, self.bottom - whole.top),
            slice(self.left - whole.left, self.right - whole.left),
        )

    def tiles(self) -> Iterator[tuple[int, int]]:
        """Yield the keys (row, col) of the tiles that the rectangle overlaps."""
        cols = range((self.left + _MIDDLE_PX) // TILE_PX, -(-(self.right + _MIDDLE_PX) // TILE_PX))
        for row in range((self.top + _MIDDLE_PX) // TILE_PX, -(-(self.bottom + _MIDDLE_PX) // TILE_PX)):
            for col in cols:
                yield row, col

    def pieces(self) -> Iterator[tuple[tuple[int, int], Slices, Slices]]:
        """Yield each tile's key, and what the rectangle shares with it: in an array of the rectangle, in the tile."""
        for key in self.tiles():
            at = tile_rectangle(*key)
            shared = self.intersection(at)
            yield key, shared.slices(self), shared.slices(at)


class Tile(NamedTuple):
    """Pixels of one tile of the canvas.

    Parameters
    ----------
    value : numpy.ndarray
        (256, 256) float32: grey levels, or their weighted sums where frames are blended.
    weight : numpy.ndarray
        (256, 256) float32: weights; 0 where nothing was drawn.
    """

    value: NDArray[np.float32]
    weight: NDArray[np.float32]


class TileStore(Protocol):
    """Storage of tiles: the heap, or memory shared with another process."""

    def tile(self, row: int, col: int) -> Tile:
        """Return the tile with a key (row, col), allocated as zeros if it does not exist."""
        ...

    def keys(self) -> Iterable[tuple[int, int]]:
        """Return the keys (row, col) of the tiles that exist."""
        ...

    def clear(self) -> None:
        """Remove all tiles."""
        ...


class Canvas(Protocol):
    """Image that is written by one thread while others read it."""

    @property
    def extent(self) -> Rectangle | None:
        """Rectangle around everything that was drawn; None if nothing was."""

    def take_dirty(self) -> Rectangle | None:
        """Return the rectangle that changed since the last call, or None."""

    def read(self, part: Rectangle | None = None) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Copy a part, by default all: (rows, cols) float32 grey levels, and weights, 0 where nothing was drawn."""


class HeapTiles:
    """Tile store in the process' own memory.

    Examples
    --------
    >>> store = HeapTiles()
    >>> store.tile(-1, 3).value[0, 0] = 7
    >>> float(store.tile(-1, 3).value[0, 0]), list(store.keys())
    (7.0, [(-1, 3)])
    """

    def __init__(self) -> None:
        self._tiles: dict[tuple[int, int], Tile] = {}

    def tile(self, row: int, col: int) -> Tile:
        """Return the tile with a key (row, col), allocated as zeros if it does not exist."""
        found = self._tiles.get((row, col))
        if found is None:
            found = Tile(np.zeros((TILE_PX, TILE_PX), np.float32), np.zeros((TILE_PX, TILE_PX), np.float32))
            self._tiles[row, col] = found
        return found

    def keys(self) -> list[tuple[int, int]]:
        """Return the keys (row, col) of the tiles that exist."""
        return list(self._tiles)

    def clear(self) -> None:
        """Remove all tiles."""
        self._tiles.clear()


class TiledCanvas:
    """Unbounded canvas of tiles. One thread writes; any thread may read.

    Parameters
    ----------
    store : TileStore, optional
        Storage of the tiles; the heap by default.
    blended : bool
        True if tiles hold weighted sums, of which :meth:`read` returns the means.

    Attributes
    ----------
    extent : Rectangle or None
        Rectangle around everything that was drawn.
    """

    def __init__(self, store: TileStore | None = None, *, blended: bool = False) -> None:
        self.extent: Rectangle | None = None
        self._store: TileStore = HeapTiles() if store is None else store
        self._blended = blended
        self._lock = Lock()
        self._dirty: Rectangle | None = None

    def take_dirty(self) -> Rectangle | None:
        """Return the rectangle that changed since the last call, or None."""
        with self._lock:
            dirty, self._dirty = self._dirty, None
        return dirty

    def read(self, part: Rectangle | None = None) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Copy a part of the canvas.

        Parameters
        ----------
        part : Rectangle, optional
            The whole extent by default.

        Returns
        -------
        image : numpy.ndarray
            (rows, cols) float32 grey levels; 0 where nothing was drawn.
        weight : numpy.ndarray
            (rows, cols) float32; the sum of weights where frames are blended, the weight of the frame on top where not.
        """
        with self._lock:
            image, weight = copy_tiles(self._store, part or self.extent or Rectangle(0, 0, 0, 0))
        if self._blended:
            np.divide(image, weight, out=image, where=weight > 0)
        return image, weight

    def clear(self) -> None:
        """Remove everything that was drawn."""
        with self._lock:
            self._store.clear()
            self.extent = self._dirty = None

    def _mark_drawn(self, part: Rectangle) -> None:
        """Extend the extent and the dirty rectangle by a part; the caller holds the lock."""
        self.extent = part if self.extent is None else self.extent.union(part)
        self._dirty = part if self._dirty is None else self._dirty.union(part)


def copy_tiles(store: TileStore, part: Rectangle) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Copy a part of the canvas from the tiles of a store.

    Parameters
    ----------
    store : TileStore
        No tile is allocated in it.
    part : Rectangle
        Pixels of the canvas.

    Returns
    -------
    value, weight : numpy.ndarray
        (rows, cols) float32; 0 where there is no tile.
    """
    value, weight = np.zeros(part.shape, np.float32), np.zeros(part.shape, np.float32)
    existing = set(store.keys())
    for key, here, there in part.pieces():
        if key in existing:
            tile = store.tile(*key)
            value[here], weight[here] = tile.value[there], tile.weight[there]
    return value, weight


def bounding_rectangle(parts: Iterable[Rectangle]) -> Rectangle | None:
    """Return the smallest rectangle that contains all parts; None if there are none.

    Examples
    --------
    >>> bounding_rectangle([Rectangle(0, 0, 2, 2), Rectangle(5, -1, 6, 1)])
    Rectangle(top=0, left=-1, bottom=6, right=2)
    """
    whole: Rectangle | None = None
    for part in parts:
        whole = part if whole is None else whole.union(part)
    return whole


def tile_rectangle(row: int, col: int) -> Rectangle:
    """Return the part of the canvas that the tile with the key (row, col) covers."""
    top, left = row * TILE_PX - _MIDDLE_PX, col * TILE_PX - _MIDDLE_PX
    return Rectangle(top, left, top + TILE_PX, left + TILE_PX)
