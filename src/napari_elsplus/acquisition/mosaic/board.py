"""The mosaic and its track in shared memory, as the process that tracks writes them."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.acquisition.mosaic.board_tables import BOARD_BYTES, CHANGES, FREE, Tables
from napari_elsplus.acquisition.streaming import shared_memory as shared
from napari_elsplus.io.track_table import lose, packed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from napari_elsplus.io import TrackPoint
    from napari_elsplus.processing.mosaicing.tiles import Rectangle, Tile

_MOVED_PX: Final = 1e-3
"""Rows that belong no further than this from where they are said to lie are left alone."""


class MosaicBoard:
    """Where the process that tracks keeps track and tiles; one thread writes.

    Raises
    ------
    DeviceError
        If there is no shared memory left.
    """

    def __init__(self) -> None:
        self._tables = Tables(shared.create(BOARD_BYTES), owned=True)
        self._free: list[int] = []

    @property
    def name(self) -> str:
        """By which a :class:`MosaicFeed` finds it."""
        return self._tables.name

    def new_store(self, segment: int, image: int = 0) -> BoardTiles:
        """Make the store of the tiles of a segment, for one of several images that are laid along one track."""
        return BoardTiles(self, segment, image)

    def append(self, point: TrackPoint) -> None:
        """Add a row to the track."""
        head = self._tables.head
        count = int(head["rows"][0])
        number, within = divmod(count, self._tables.rows_together)
        self._tables.block(number).rows[within] = packed(point)
        head["rows"] = count + 1

    def changed(self, segment: int, part: Rectangle, image: int = 0) -> None:
        """Tell that a part of a segment was drawn on."""
        head = self._tables.head
        count = int(head["changes"][0])
        self._tables.changes[count % CHANGES] = (image, segment, *part)
        head["changes"] = count + 1

    def drop(self, segment: int) -> None:
        """Forget a segment in all images: its tiles are free again, its frames lost."""
        with self._repair():
            self._free_tiles(segment)
            for block in self.blocks:
                with self._writing(block) as rows:
                    lose(rows, segment)

    def release(self, segment: int) -> None:
        """Give the tiles of a segment back, whose frames were found to belong to another one."""
        with self._repair():
            self._free_tiles(segment)

    @property
    def blocks(self) -> list[slice]:
        """Rows of the track that are written over together, as far as there are any."""
        count, together = int(self._tables.head["rows"][0]), self._tables.rows_together
        return [slice(first, min(first + together, count)) for first in range(0, count, together)]

    def relocate(
        self,
        block: slice,
        segment: NDArray[np.int64],
        row_px: NDArray[np.float64],
        col_px: NDArray[np.float64],
        um_per_px: float,
    ) -> None:
        """Say of the frames of one block where they belong, camera pixels; nothing is done where none moves.

        Parameters
        ----------
        block : slice
            One of `blocks`.
        segment, row_px, col_px : numpy.ndarray
            (n,) one for each frame.
        um_per_px : float
            Of a camera pixel; NaN if unknown.
        """
        there = self._tables.block(block.start // self._tables.rows_together).rows[: block.stop - block.start]
        moved = np.maximum(np.abs(there["row_px"] - row_px), np.abs(there["col_px"] - col_px)) > _MOVED_PX
        if not (moved.any() or (there["segment"] != segment).any()):
            return
        with self._writing(block) as rows:
            rows["segment"] = segment
            for name, values in (("row", row_px), ("col", col_px)):
                rows[f"{name}_px"], rows[f"{name}_um"] = values, values * um_per_px

    @contextmanager
    def _repair(self) -> Iterator[None]:
        """Let nobody look meanwhile, and everybody look at everything afterwards."""
        self._tables.head["generation"] += 1  # odd: under repair
        yield
        self._tables.head["generation"] += 1

    def _free_tiles(self, segment: int) -> None:
        tables = self._tables
        count = int(tables.head["tiles"][0])
        for index in np.flatnonzero(tables.tiles["segment"][:count] == segment).tolist():
            tables.tiles[index] = (0, FREE, 0, 0)
            self._free.append(index)

    @contextmanager
    def _writing(self, block: slice) -> Iterator[Any]:
        """Let everybody read the rows of a block again that are written over meanwhile."""
        writings, rows = self._tables.block(block.start // self._tables.rows_together)
        writings += 1
        yield rows[: block.stop - block.start]
        writings += 1
        self._tables.head["relocations"] += 1

    def new_tile(self, segment: int, row: int, col: int, image: int = 0) -> Tile:
        """Give a segment a blank tile."""
        tables = self._tables
        count = int(tables.head["tiles"][0])
        index = self._free.pop() if self._free else count
        tile = tables.pixels(index)
        if index < count:
            tile.value[:] = tile.weight[:] = 0
        tables.tiles[index] = (image, segment, row, col)
        tables.head["tiles"] = max(count, index + 1)
        return tile

    def close(self) -> None:
        """Delete everything; who looks at it keeps what it has copied."""
        self._tables.close()


class BoardTiles:
    """The tiles of one segment on a board.

    Parameters
    ----------
    board : MosaicBoard
        Where they are kept.
    segment : int
        Its number.
    image : int
        Of those that are laid along the track.
    """

    def __init__(self, board: MosaicBoard, segment: int, image: int = 0) -> None:
        self._board, self._segment, self._image = board, segment, image
        self._tiles: dict[tuple[int, int], Tile] = {}

    def tile(self, row: int, col: int) -> Tile:
        """Return a tile, blank if it was never drawn on."""
        found = self._tiles.get((row, col))
        if found is None:
            found = self._tiles[row, col] = self._board.new_tile(self._segment, row, col, self._image)
        return found

    def keys(self) -> list[tuple[int, int]]:
        """Return (row, col) of the tiles that exist."""
        return list(self._tiles)

    def clear(self) -> None:
        """Forget all tiles, and those of the segment's other images."""
        self._tiles.clear()
        self._board.release(self._segment)
