"""The mosaic and its track in shared memory, on the side of the writer."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.acquisition.mosaic.board_tables import BOARD_BYTES, CHANGES, FREE, Tables
from napari_elsplus.acquisition.streaming import shared_memory as shared
from napari_elsplus.io.tables.track_table import lose, packed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from napari_elsplus.io import TrackPoint
    from napari_elsplus.processing.mosaicing.tiles import Rectangle, Tile

_MOVED_PX: Final = 1e-3
"""Corrections below this are not written, pixels; chosen: a hundredth of the accuracy of registration."""


class MosaicBoard:
    """Track and tiles in shared memory of the process that tracks; one thread writes.

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
        """Name by which a :class:`MosaicFeed` attaches."""
        return self._tables.name

    def new_store(self, segment: int, image: int = 0) -> BoardTiles:
        """Make the tile store of a segment of one image of the track."""
        return BoardTiles(self, segment, image)

    def append(self, point: TrackPoint) -> None:
        """Append a point to the track."""
        head = self._tables.head
        count = int(head["rows"][0])
        number, within = divmod(count, self._tables.rows_together)
        self._tables.block(number).rows[within] = packed(point)
        head["rows"] = count + 1

    def changed(self, segment: int, part: Rectangle, image: int = 0) -> None:
        """Publish that a part of a segment of an image has changed."""
        head = self._tables.head
        count = int(head["changes"][0])
        self._tables.changes[count % CHANGES] = (image, segment, *part)
        head["changes"] = count + 1

    def drop(self, segment: int) -> None:
        """Remove a segment from all images: its tiles are free again, its frames lost."""
        with self._removing():
            self._free_tiles(segment)
            for block in self.blocks:
                with self._writing(block) as rows:
                    lose(rows, segment)

    def release(self, segment: int) -> None:
        """Free the tiles of a segment that was joined to another one."""
        with self._removing():
            self._free_tiles(segment)

    @property
    def blocks(self) -> list[slice]:
        """Rows of the track that are rewritten together, as far as there are any."""
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
        """Rewrite the positions of one block of frames, in camera pixels; nothing is done where none moves.

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
    def _removing(self) -> Iterator[None]:
        """Keep readers away meanwhile; they copy everything afterwards."""
        self._tables.head["generation"] += 1  # odd: under removal
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
        """Return the rows of a block for rewriting; readers copy them again afterwards."""
        version, rows = self._tables.block(block.start // self._tables.rows_together)
        version += 1
        yield rows[: block.stop - block.start]
        version += 1
        self._tables.head["relocations"] += 1

    def new_tile(self, segment: int, row: int, col: int, image: int = 0) -> Tile:
        """Return a blank tile for a segment of an image, at a row and col of tiles."""
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
        """Delete everything; readers keep what they have copied."""
        self._tables.close()


class BoardTiles:
    """The tiles of one segment on a board.

    Parameters
    ----------
    board : MosaicBoard
        The board.
    segment : int
        Its number.
    image : int
        Number of the image on the board.
    """

    def __init__(self, board: MosaicBoard, segment: int, image: int = 0) -> None:
        self._board, self._segment, self._image = board, segment, image
        self._tiles: dict[tuple[int, int], Tile] = {}

    def tile(self, row: int, col: int) -> Tile:
        """Return the tile at a row and col of tiles, blank if it is new."""
        found = self._tiles.get((row, col))
        if found is None:
            found = self._tiles[row, col] = self._board.new_tile(self._segment, row, col, self._image)
        return found

    def keys(self) -> list[tuple[int, int]]:
        """Return (row, col) of the tiles that exist."""
        return list(self._tiles)

    def clear(self) -> None:
        """Remove all tiles, and those of the segment's other images."""
        self._tiles.clear()
        self._board.release(self._segment)
