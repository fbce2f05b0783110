"""The mosaic and its track in another process's shared memory, as they are looked at: only what changed is copied."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.acquisition import shared
from napari_elsplus.acquisition.board_tables import CHANGES, FREE, MOST_TILES, STATES, TILE, Tables
from napari_elsplus.io import TrackPoint
from napari_elsplus.processing.mosaicing.tiles import Rectangle, Tile, TiledCanvas, around_all, tile_rectangle

if TYPE_CHECKING:
    from collections.abc import Sequence


class Mirror(TiledCanvas):
    """A copy of a segment whose original lies in shared memory; it stays when that is gone."""

    def copy(self, part: Rectangle, tiles: dict[tuple[int, int], Tile]) -> None:
        """Copy a part of the original, tile by tile; where there is no tile nothing was drawn."""
        with self._lock:
            for key in part.tiles():
                if key in tiles:
                    at = tile_rectangle(*key)
                    there = part.within(at).slices(at)
                    target, source = self._store.tile(*key), tiles[key]
                    target.value[there], target.weight[there] = source.value[there], source.weight[there]
            self._touched(part)


def _drawn(key: tuple[int, int], tile: Tile) -> Rectangle | None:
    """Return the part of the canvas that was drawn on in a tile."""
    rows, cols = (np.flatnonzero((tile.weight > 0).any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return None
    at = tile_rectangle(*key)
    return Rectangle(
        at.top + int(rows[0]), at.left + int(cols[0]), at.top + int(rows[-1]) + 1, at.left + int(cols[-1]) + 1
    )


class MosaicFeed:
    """Looks at a board of another process: copies the rows and the rectangles that are new.

    Parameters
    ----------
    name : str
        Of the board.
    blended : bool
        Whether frames are averaged there.

    Attributes
    ----------
    rows : list of TrackPoint
        The track, as far as it was copied.
    canvases : dict of int to dict of int to Mirror
        Of each image the segments, as far as they were copied.
    revision : int
        Changes when what was copied before does not hold any more.

    Raises
    ------
    FileNotFoundError
        If there is no such board.
    """

    def __init__(self, name: str, *, blended: bool = False) -> None:
        self._tables = Tables(shared.attach(name), owned=False)
        self._blended = blended
        self.rows: list[TrackPoint] = []
        self.canvases: dict[int, dict[int, Mirror]] = {}
        self._generation = self._relocations = 0
        self._changes_seen = 0
        self._known = np.full(MOST_TILES, np.array((0, FREE, 0, 0), TILE))
        self._tiles: dict[tuple[int, int], dict[tuple[int, int], Tile]] = {}

    @property
    def revision(self) -> int:
        """Another number once what was copied before has changed."""
        return self._generation + self._relocations

    def update(self) -> bool:
        """Copy what is new; whether there was anything."""
        head = self._tables.head[0].copy()
        generation, relocations = int(head["generation"]), int(head["relocations"])
        if generation % 2 or relocations % 2:
            return False
        if generation != self._generation:
            self._forget()
            self._generation = generation
        if relocations != self._relocations:
            self.rows, self._relocations = [], relocations
        count = int(head["changes"])
        behind = count - self._changes_seen
        if behind == 0 and int(head["rows"]) == len(self.rows):
            return False
        self._learn_tiles(int(self._tables.head["tiles"][0]))  # after the changes, which may lie on newer tiles
        only_new = self._changes_seen and behind <= CHANGES // 2
        if only_new:
            parts = self._changed(range(self._changes_seen, count))
        else:
            parts = {
                key: whole
                for key, tiles in self._tiles.items()
                if (whole := around_all(filter(None, map(_drawn, tiles, tiles.values())))) is not None
            }
        self._copy_rows(int(head["rows"]))
        for (image, segment), part in parts.items():
            mirrors = self.canvases.setdefault(image, {})
            mirror = mirrors.get(segment) or Mirror(blended=self._blended)
            if not only_new and mirror.extent is not None:
                part = part.around(mirror.extent)
            mirror.copy(part, self._tiles.get((image, segment), {}))
            mirrors[segment] = mirror
        now = self._tables.head[0].copy()
        if int(now["relocations"]) != relocations:  # some rows may be from before, and some from after
            self.rows, self._relocations = [], relocations - 1
        if int(now["generation"]) != generation:  # dropped meanwhile: what was copied may be mixed
            self._forget()
            return False
        self._changes_seen = count
        return True

    def close(self) -> None:
        """Let go of the shared memory; what was copied stays."""
        self._tiles.clear()
        self._tables.close()

    def _forget(self) -> None:
        self.rows, self.canvases, self._tiles = [], {}, {}
        self._changes_seen = 0
        self._known["segment"] = FREE

    def _learn_tiles(self, count: int) -> None:
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
            parts[key] = part if key not in parts else parts[key].around(part)
        return parts

    def _copy_rows(self, count: int) -> None:
        while len(self.rows) < count:
            rows, within = self._tables.rows(len(self.rows))
            fresh = rows[within : within + count - len(self.rows)].tolist()
            self.rows += [TrackPoint(*[*values[:-1], STATES[values[-1]]]) for values in fresh]
