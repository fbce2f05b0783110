"""The mosaic and its track in shared memory: one process draws, others look, and only what changed is copied.

A board is a table of what there is: which tile lies where, how many rows the track has, and which rectangles changed of
late. Tiles and rows lie in further segments that are added as the mosaic grows; their names follow from the board's.
"""

from __future__ import annotations

from contextlib import contextmanager, suppress
from dataclasses import astuple
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.acquisition import shared
from napari_elsplus.io import TrackPoint
from napari_elsplus.processing.mosaicing.tiles import TILE_PX, Rectangle, Tile, TiledCanvas, around_all, tile_rectangle
from napari_elsplus.processing.tracking.tracker import State

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from multiprocessing.shared_memory import SharedMemory

    from numpy.typing import NDArray

MOST_TILES: Final = 1 << 14
"""Tiles that a board can name: 32 GB of them."""
CHANGES: Final = 1 << 12
"""Rectangles that are remembered; who has not looked for longer reads everything."""
TILES_TOGETHER: Final = 8
ROWS_TOGETHER: Final = 1 << 14
_FREE: Final = -1
_HEAD: Final = np.dtype(
    [("generation", "<i8"), ("tiles", "<i8"), ("rows", "<i8"), ("changes", "<i8"), ("relocations", "<i8")]
)  # fmt: skip
_TILE: Final = np.dtype([("image", "<i4"), ("segment", "<i4"), ("row", "<i4"), ("col", "<i4")])
_CHANGE: Final = np.dtype(
    [("image", "<i4"), ("segment", "<i4"), ("top", "<i4"), ("left", "<i4"), ("bottom", "<i4"), ("right", "<i4")]
)  # fmt: skip
_ROW: Final = np.dtype(
    [
        ("frame", "<i8"), ("time_s", "<f8"), ("segment", "<i8"), ("row_px", "<f8"), ("col_px", "<f8"),
        ("row_um", "<f8"), ("col_um", "<f8"), ("score", "<f8"), ("sigma_px", "<f8"), ("state", "<i8"),
    ]
)  # fmt: skip
_STATES: Final = tuple(state.value for state in State)
_TILE_SHAPE: Final = (TILES_TOGETHER, 2, TILE_PX, TILE_PX)
_TILES_BYTES: Final = TILES_TOGETHER * 2 * TILE_PX * TILE_PX * 4
_BOARD_BYTES: Final = _HEAD.itemsize + MOST_TILES * _TILE.itemsize + CHANGES * _CHANGE.itemsize


class _Tables:
    """The board's tables in a segment, and the segments that go with it."""

    def __init__(self, board: SharedMemory, *, owned: bool) -> None:
        self._board, self._owned = board, owned
        self._parts: dict[str, SharedMemory] = {}
        self.head: Any = np.ndarray((1,), _HEAD, board.buf)
        self.tiles: Any = np.ndarray((MOST_TILES,), _TILE, board.buf, _HEAD.itemsize)
        self.changes: Any = np.ndarray(
            (CHANGES,), _CHANGE, board.buf, _HEAD.itemsize + MOST_TILES * _TILE.itemsize
        )  # fmt: skip
        self._pixels: list[NDArray[np.float32]] = []
        self._rows: list[Any] = []

    @property
    def name(self) -> str:
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
        part, within = divmod(index, ROWS_TOGETHER)
        while len(self._rows) <= part:
            segment = self._part(f"r{len(self._rows)}", ROWS_TOGETHER * _ROW.itemsize)
            self._rows.append(np.ndarray((ROWS_TOGETHER,), _ROW, segment.buf))
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


class MosaicBoard:
    """Where the process that tracks keeps track and tiles; one thread writes.

    Raises
    ------
    DeviceError
        If there is no shared memory left.
    """

    def __init__(self) -> None:
        self._tables = _Tables(shared.create(_BOARD_BYTES), owned=True)
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
        rows, within = self._tables.rows(count)
        *values, state = astuple(point)
        rows[within] = (*values, _STATES.index(state))
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
            for rows in self._chunks():
                gone = rows[rows["segment"] == segment]
                for name in ("row_px", "col_px", "row_um", "col_um", "score", "sigma_px"):
                    gone[name] = np.nan
                gone["state"] = _STATES.index(State.LOST.value)
                rows[rows["segment"] == segment] = gone

    def release(self, segment: int) -> None:
        """Give the tiles of a segment back, whose frames were found to belong to another one."""
        with self._repair():
            self._free_tiles(segment)

    def relocate(
        self, segment: NDArray[np.int64], row_px: NDArray[np.float64], col_px: NDArray[np.float64], um_per_px: float
    ) -> None:
        """Say of the first frames of the track where they belong, camera pixels.

        Parameters
        ----------
        segment, row_px, col_px : numpy.ndarray
            (n,) one for each frame.
        um_per_px : float
            Of a camera pixel; NaN if unknown.
        """
        self._tables.head["relocations"] += 1  # odd: under repair
        for first, rows in zip(range(0, len(segment), ROWS_TOGETHER), self._chunks(), strict=False):
            part = slice(first, min(first + ROWS_TOGETHER, len(segment)))
            here = rows[: part.stop - first]
            here["segment"] = segment[part]
            for name, values in (("row", row_px[part]), ("col", col_px[part])):
                here[f"{name}_px"], here[f"{name}_um"] = values, values * um_per_px
        self._tables.head["relocations"] += 1

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
            tables.tiles[index] = (0, _FREE, 0, 0)
            self._free.append(index)

    def _chunks(self) -> Iterator[Any]:
        """Go through the rows of the track as they lie together."""
        for first in range(0, int(self._tables.head["rows"][0]), ROWS_TOGETHER):
            yield self._tables.rows(first)[0]

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
        self._tables = _Tables(shared.attach(name), owned=False)
        self._blended = blended
        self.rows: list[TrackPoint] = []
        self.canvases: dict[int, dict[int, Mirror]] = {}
        self._generation = self._relocations = 0
        self._changes_seen = 0
        self._known = np.full(MOST_TILES, np.array((0, _FREE, 0, 0), _TILE))
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
        self._known["segment"] = _FREE

    def _learn_tiles(self, count: int) -> None:
        table, known = self._tables.tiles[:count], self._known[:count]
        for index in np.flatnonzero(table != known).tolist():
            image, segment, row, col = table[index].tolist()
            if segment != _FREE:
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
            self.rows += [TrackPoint(*[*values[:-1], _STATES[values[-1]]]) for values in fresh]
