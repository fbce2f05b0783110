"""A copy of the mosaic and its track in another process's shared memory: only changes are copied."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.acquisition.mosaic.board_tables import CHANGES, FREE, MAX_TILES, TILE, Tables
from napari_elsplus.acquisition.streaming import shared_memory as shared
from napari_elsplus.io import TrackTable
from napari_elsplus.processing.mosaicing.tiles import Rectangle, Tile, TiledCanvas, bounding_rectangle, tile_rectangle

if TYPE_CHECKING:
    from collections.abc import Sequence

MAX_ROWS_PER_UPDATE: Final = 1 << 16
"""Rows copied by one update; chosen: 5 MB, a few milliseconds."""


class TileCopy(TiledCanvas):
    """A copy of a segment in shared memory; it stays when the original is deleted."""

    def copy(self, part: Rectangle, tiles: dict[tuple[int, int], Tile]) -> None:
        """Copy a part of the original from its tiles; where there is no tile nothing was inserted.

        Parameters
        ----------
        part : Rectangle
            Pixels of the canvas.
        tiles : dict of (row, col) to Tile
            Tiles of the original.
        """
        with self._lock:
            for key in part.tiles():
                if key in tiles:
                    at = tile_rectangle(*key)
                    there = part.intersection(at).slices(at)
                    target, source = self._store.tile(*key), tiles[key]
                    target.value[there], target.weight[there] = source.value[there], source.weight[there]
            self._mark_drawn(part)


def _drawn(key: tuple[int, int], tile: Tile) -> Rectangle | None:
    """Return the part of the canvas that a tile covers with inserted pixels."""
    rows, cols = (np.flatnonzero((tile.weight > 0).any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return None
    at = tile_rectangle(*key)
    return Rectangle(
        at.top + int(rows[0]), at.left + int(cols[0]), at.top + int(rows[-1]) + 1, at.left + int(cols[-1]) + 1
    )


class MosaicFeed:
    """Copies new rows and rectangles from a board of another process.

    Parameters
    ----------
    name : str
        Of the board.
    blended : bool
        Frames are averaged there.

    Attributes
    ----------
    rows : TrackTable
        The track, as far as it was copied; always the same object.
    canvases : dict of int to dict of int to TileCopy
        Segments of each image, as far as they were copied.
    revision : int
        Changes when a segment was removed.

    Raises
    ------
    FileNotFoundError
        If there is no such board.
    """

    def __init__(self, name: str, *, blended: bool = False) -> None:
        self._tables = Tables(shared.attach(name), owned=False)
        self._blended = blended
        self.rows = TrackTable()
        self.canvases: dict[int, dict[int, TileCopy]] = {}
        self.revision = self._relocations = 0
        self._versions: list[int] = []
        self._turn = 0
        self._changes_seen = 0
        self._known = np.full(MAX_TILES, np.array((0, FREE, 0, 0), TILE))
        self._tiles: dict[tuple[int, int], dict[tuple[int, int], Tile]] = {}

    def update(self, *, all_rows: bool = False) -> bool:
        """Copy what is new; return True if there was anything.

        Parameters
        ----------
        all_rows : bool
            Copy the whole track, however long that takes; else a long one is copied by several updates.
        """
        head = self._tables.head[0].copy()
        generation, count = int(head["generation"]), int(head["changes"])
        if generation % 2:
            return False
        if generation != self.revision:
            self._reset()
            self.revision = generation
        copied = self._copy_rows(int(head["rows"]), int(head["relocations"]), all_rows=all_rows)
        if count == self._changes_seen:
            return copied
        self._copy_tiles(count)
        if int(self._tables.head["generation"][0]) != generation:  # one was removed: the copy may be mixed
            self._reset()
            return False
        self._changes_seen = count
        return True

    def close(self) -> None:
        """Detach from the shared memory; what was copied stays."""
        self._tiles.clear()
        self._tables.close()

    def _copy_tiles(self, count: int) -> None:
        """Copy the rectangles that changed, up to a count of changes."""
        behind = count - self._changes_seen
        self._read_tile_table(int(self._tables.head["tiles"][0]))  # after the changes, which may lie on newer tiles
        only_new = self._changes_seen and behind <= CHANGES // 2
        if only_new:
            parts = self._changed(range(self._changes_seen, count))
        else:
            parts = {
                key: whole
                for key, tiles in self._tiles.items()
                if (whole := bounding_rectangle(filter(None, map(_drawn, tiles, tiles.values())))) is not None
            }
        for (image, segment), part in parts.items():
            copies = self.canvases.setdefault(image, {})
            copy = copies.get(segment) or TileCopy(blended=self._blended)
            if not only_new and copy.extent is not None:
                part = part.union(copy.extent)
            copy.copy(part, self._tiles.get((image, segment), {}))
            copies[segment] = copy

    def _reset(self) -> None:
        self.canvases, self._tiles = {}, {}
        self._changes_seen = 0
        self._known["segment"] = FREE

    def _read_tile_table(self, count: int) -> None:
        table, known = self._tables.tiles[:count], self._known[:count]
        for index in np.flatnonzero(table != known).tolist():
            image, segment, row, col = table[index].tolist()
            if segment != FREE:
                self._tiles.setdefault((image, segment), {})[row, col] = self._tables.pixels(index)
        known[:] = table

    def _changed(self, numbers: Sequence[int]) -> dict[tuple[int, int], Rectangle]:
        parts: dict[tuple[int, int], Rectangle] = {}
        for number in numbers:
            image, segment, *edges = self._tables.changes[number % CHANGES].tolist()
            key, part = (image, segment), Rectangle(*edges)
            parts[key] = part if key not in parts else parts[key].union(part)
        return parts

    def _copy_rows(self, count: int, relocations: int, *, all_rows: bool) -> bool:
        """Copy new rows, then rewritten blocks; return True if there were any."""
        room = count + len(self.rows) if all_rows else MAX_ROWS_PER_UPDATE
        together, before = self._tables.rows_together, room
        while len(self.rows) < count and room > 0:
            number, within = divmod(len(self.rows), together)
            rows = slice(within, min(together, count - number * together, within + room))
            if not self._copy_block(number, rows):
                break
            room -= rows.stop - rows.start
        if relocations == self._relocations:
            return room < before
        blocks = len(self._versions)
        for _ in range(blocks):
            self._turn = (self._turn + 1) % blocks
            rows = slice(0, min(together, len(self.rows) - self._turn * together))
            if int(self._tables.block(self._turn).version[0]) == self._versions[self._turn]:
                continue
            if room < rows.stop:
                self._turn -= 1
                return True
            if not self._copy_block(self._turn, rows):
                return True
            room -= rows.stop
        self._relocations = relocations
        return room < before

    def _copy_block(self, number: int, rows: slice) -> bool:
        """Copy rows of a block; return False if it is being rewritten: it is left to the next update."""
        block = self._tables.block(number)
        version = int(block.version[0])
        copy = block.rows[rows].copy()
        if version % 2 or int(block.version[0]) != version:
            return False
        self.rows.write(number * self._tables.rows_together + rows.start, copy)
        if number == len(self._versions):
            self._versions.append(version)
        elif rows.start == 0:
            self._versions[number] = version
        return True
