"""How a mosaic and its track lie in shared memory.

A board is a table of what there is: which tile lies where, how many rows the track has, and which rectangles changed of
late. Tiles and rows lie in further segments that are added as the mosaic grows; their names follow from the board's.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from napari_elsplus.acquisition import shared
from napari_elsplus.processing.mosaicing.tiles import TILE_PX, Tile
from napari_elsplus.processing.tracking.pose import State

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
ROW: Final = np.dtype(
    [
        ("frame", "<i8"), ("time_s", "<f8"), ("segment", "<i8"), ("row_px", "<f8"), ("col_px", "<f8"),
        ("row_um", "<f8"), ("col_um", "<f8"), ("score", "<f8"), ("sigma_px", "<f8"), ("state", "<i8"),
    ]
)  # fmt: skip
STATES: Final = tuple(state.value for state in State)
"""What a row's state is a number of."""
_TILE_SHAPE: Final = (TILES_TOGETHER, 2, TILE_PX, TILE_PX)
_TILES_BYTES: Final = TILES_TOGETHER * 2 * TILE_PX * TILE_PX * 4
BOARD_BYTES: Final = HEAD.itemsize + MOST_TILES * TILE.itemsize + CHANGES * CHANGE.itemsize


class Tables:
    """The board's tables in a segment, and the segments that go with it."""

    rows_together: ClassVar = 1 << 14
    """Rows of the track in one segment."""

    def __init__(self, board: SharedMemory, *, owned: bool) -> None:
        self._board, self._owned = board, owned
        self._parts: dict[str, SharedMemory] = {}
        self.head: Any = np.ndarray((1,), HEAD, board.buf)
        self.tiles: Any = np.ndarray((MOST_TILES,), TILE, board.buf, HEAD.itemsize)
        self.changes: Any = np.ndarray(
            (CHANGES,), CHANGE, board.buf, HEAD.itemsize + MOST_TILES * TILE.itemsize
        )  # fmt: skip
        self._pixels: list[NDArray[np.float32]] = []
        self._rows: list[Any] = []

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

    def rows(self, index: int) -> tuple[Any, int]:
        """Return the rows that lie with the one of that index, and its place among them."""
        part, within = divmod(index, self.rows_together)
        while len(self._rows) <= part:
            segment = self._part(f"r{len(self._rows)}", self.rows_together * ROW.itemsize)
            self._rows.append(np.ndarray((self.rows_together,), ROW, segment.buf))
        return self._rows[part], within

    def _part(self, suffix: str, nbytes: int) -> SharedMemory:
        name = f"{self.name}-{suffix}"
        self._parts[suffix] = segment = shared.create(nbytes, name) if self._owned else shared.attach(name)
        return segment

    def close(self) -> None:
        """Let go of the memory; its owner deletes it."""
        del self.head, self.tiles, self.changes
        self._pixels.clear()
        self._rows.clear()
        for segment in (*self._parts.values(), self._board):
            segment.close()
            if self._owned:
                with suppress(FileNotFoundError):
                    segment.unlink()
        self._parts.clear()
