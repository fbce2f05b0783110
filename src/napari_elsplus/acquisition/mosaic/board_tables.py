"""Layout of a mosaic and its track in shared memory.

A board holds the tables: positions of tiles, number of rows of the track, the latest changed rectangles. Tiles and rows
lie in further segments that are added as the mosaic grows; their names derive from the board's. Rows lie in blocks,
each with a version, so that readers copy again only those that were rewritten.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

import numpy as np

from napari_elsplus.acquisition.streaming import shared_memory as shared
from napari_elsplus.io.tables.track_table import ROW
from napari_elsplus.processing.mosaicing.tiles import TILE_PX, Tile

if TYPE_CHECKING:
    from multiprocessing.shared_memory import SharedMemory

    from numpy.typing import NDArray

MAX_TILES: Final = 1 << 16
"""Tiles that a board can name; chosen: 32 GB of them, more than a computer's memory."""
CHANGES: Final = 1 << 12
"""Changed rectangles that are kept; chosen: 17 s at 240 Hz, after which a reader copies everything."""
TILES_TOGETHER: Final = 32
"""Tiles in one segment; chosen: a segment is added a few times a second at most."""
FREE: Final = -1
"""Segment of a tile that is not in use."""
HEAD: Final = np.dtype([(name, "<i8") for name in ("generation", "tiles", "rows", "changes", "relocations")])
TILE: Final = np.dtype([(name, "<i4") for name in ("image", "segment", "row", "col")])
CHANGE: Final = np.dtype([(name, "<i4") for name in ("image", "segment", "top", "left", "bottom", "right")])
_TILE_SHAPE: Final = (TILES_TOGETHER, 2, TILE_PX, TILE_PX)
_TILES_BYTES: Final = TILES_TOGETHER * 2 * TILE_PX * TILE_PX * 4
"""Shape and bytes of a block of tiles, each with float32 values and weights; derived."""
BOARD_BYTES: Final = HEAD.itemsize + MAX_TILES * TILE.itemsize + CHANGES * CHANGE.itemsize


class Block(NamedTuple):
    """Rows of the track in one segment.

    Parameters
    ----------
    version : numpy.ndarray
        (1,) int64: increases before and after rows are rewritten; odd meanwhile.
    rows : numpy.ndarray
        Of the type `ROW`.
    """

    version: NDArray[np.int64]
    rows: Any


class Tables:
    """The board's tables in a segment, and the segments that go with it."""

    rows_together: ClassVar = 1 << 14
    """Rows of the track in one block; chosen: 68 s at 240 Hz."""

    def __init__(self, board: SharedMemory, *, owned: bool) -> None:
        self._board, self._owned = board, owned
        self._parts: dict[str, SharedMemory] = {}
        self.head: Any = np.ndarray((1,), HEAD, board.buf)
        self.tiles: Any = np.ndarray((MAX_TILES,), TILE, board.buf, HEAD.itemsize)
        self.changes: Any = np.ndarray((CHANGES,), CHANGE, board.buf, HEAD.itemsize + self.tiles.nbytes)
        self._pixels: list[NDArray[np.float32]] = []
        self._blocks: list[Block] = []

    @property
    def name(self) -> str:
        """Name by which readers attach."""
        return self._board.name

    def pixels(self, index: int) -> Tile:
        """Return the tile of an index."""
        part, within = divmod(index, TILES_TOGETHER)
        while len(self._pixels) <= part:
            segment = self._part(f"t{len(self._pixels)}", _TILES_BYTES)
            self._pixels.append(np.ndarray(_TILE_SHAPE, np.float32, segment.buf))
        return Tile(*self._pixels[part][within])

    def block(self, number: int) -> Block:
        """Return a block of rows by its number."""
        while len(self._blocks) <= number:
            nbytes = np.dtype(np.int64).itemsize
            segment = self._part(f"r{len(self._blocks)}", nbytes + self.rows_together * ROW.itemsize)
            version = np.ndarray((1,), np.int64, segment.buf)
            self._blocks.append(Block(version, np.ndarray((self.rows_together,), ROW, segment.buf, nbytes)))
        return self._blocks[number]

    def _part(self, suffix: str, nbytes: int) -> SharedMemory:
        name = f"{self.name}-{suffix}"
        self._parts[suffix] = segment = shared.create(nbytes, name) if self._owned else shared.attach(name)
        return segment

    def close(self) -> None:
        """Detach from the memory; its owner deletes it."""
        del self.head, self.tiles, self.changes
        self._pixels.clear()
        self._blocks.clear()
        for segment in (*self._parts.values(), self._board):
            segment.close()
            if self._owned:
                with suppress(FileNotFoundError):
                    segment.unlink()
        self._parts.clear()
