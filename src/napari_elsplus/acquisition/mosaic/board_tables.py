"""How a mosaic and its track lie in shared memory.

A board is a table of what there is: which tile lies where, how many rows the track has, and which rectangles changed of
late. Tiles and rows lie in further segments that are added as the mosaic grows; their names follow from the board's.
Rows lie in blocks, each with a count of how often it was written over: who looks reads again only those that were.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

import numpy as np

from napari_elsplus.acquisition.streaming import shared_memory as shared
from napari_elsplus.io.track_table import ROW
from napari_elsplus.processing.mosaicing.tiles import TILE_PX, Tile

if TYPE_CHECKING:
    from multiprocessing.shared_memory import SharedMemory

    from numpy.typing import NDArray

MOST_TILES: Final = 1 << 14
"""Tiles that a board can name: 32 GB of them."""
CHANGES: Final = 1 << 12
"""Rectangles that are remembered; who has not looked for longer reads everything."""
TILES_TOGETHER: Final = 8
FREE: Final = -1
"""Segment of a tile that nobody has."""
HEAD: Final = np.dtype(
    [("generation", "<i8"), ("tiles", "<i8"), ("rows", "<i8"), ("changes", "<i8"), ("relocations", "<i8")]
)  # fmt: skip
TILE: Final = np.dtype([("image", "<i4"), ("segment", "<i4"), ("row", "<i4"), ("col", "<i4")])
CHANGE: Final = np.dtype(
    [("image", "<i4"), ("segment", "<i4"), ("top", "<i4"), ("left", "<i4"), ("bottom", "<i4"), ("right", "<i4")]
)  # fmt: skip
_TILE_SHAPE: Final = (TILES_TOGETHER, 2, TILE_PX, TILE_PX)
_TILES_BYTES: Final = TILES_TOGETHER * 2 * TILE_PX * TILE_PX * 4
BOARD_BYTES: Final = HEAD.itemsize + MOST_TILES * TILE.itemsize + CHANGES * CHANGE.itemsize


class Block(NamedTuple):
    """Rows of the track that lie together.

    Parameters
    ----------
    writings : numpy.ndarray
        (1,) int64: goes up when rows that were there are written over, once before and once after; odd meanwhile.
    rows : numpy.ndarray
        Of the type `ROW`.
    """

    writings: NDArray[np.int64]
    rows: Any


class Tables:
    """The board's tables in a segment, and the segments that go with it."""

    rows_together: ClassVar = 1 << 14
    """Rows of the track in one block."""

    def __init__(self, board: SharedMemory, *, owned: bool) -> None:
        self._board, self._owned = board, owned
        self._parts: dict[str, SharedMemory] = {}
        self.head: Any = np.ndarray((1,), HEAD, board.buf)
        self.tiles: Any = np.ndarray((MOST_TILES,), TILE, board.buf, HEAD.itemsize)
        self.changes: Any = np.ndarray(
            (CHANGES,), CHANGE, board.buf, HEAD.itemsize + MOST_TILES * TILE.itemsize
        )  # fmt: skip
        self._pixels: list[NDArray[np.float32]] = []
        self._blocks: list[Block] = []

    @property
    def name(self) -> str:
        """By which others find it."""
        return self._board.name

    def pixels(self, index: int) -> Tile:
        """Return the tile of that index."""
        part, within = divmod(index, TILES_TOGETHER)
        while len(self._pixels) <= part:
            segment = self._part(f"t{len(self._pixels)}", _TILES_BYTES)
            self._pixels.append(np.ndarray(_TILE_SHAPE, np.float32, segment.buf))
        return Tile(*self._pixels[part][within])

    def block(self, number: int) -> Block:
        """Return the rows that begin with the one of that many times `rows_together`."""
        while len(self._blocks) <= number:
            nbytes = np.dtype(np.int64).itemsize
            segment = self._part(f"r{len(self._blocks)}", nbytes + self.rows_together * ROW.itemsize)
            writings = np.ndarray((1,), np.int64, segment.buf)
            self._blocks.append(Block(writings, np.ndarray((self.rows_together,), ROW, segment.buf, nbytes)))
        return self._blocks[number]

    def _part(self, suffix: str, nbytes: int) -> SharedMemory:
        name = f"{self.name}-{suffix}"
        self._parts[suffix] = segment = shared.create(nbytes, name) if self._owned else shared.attach(name)
        return segment

    def close(self) -> None:
        """Let go of the memory; its owner deletes it."""
        del self.head, self.tiles, self.changes
        self._pixels.clear()
        self._blocks.clear()
        for segment in (*self._parts.values(), self._board):
            segment.close()
            if self._owned:
                with suppress(FileNotFoundError):
                    segment.unlink()
        self._parts.clear()
