"""The mosaics of all segments on one sheet, below one another, each where it stays while it grows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.mosaicing.tiles import Canvas, Rectangle, bounding_rectangle

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

GAP_PX: Final = 16
"""Empty rows between the rooms of two segments."""
RESERVED_STEP_PX: Final = 64
"""The edges of a room are multiples of this: mostly the last segment grows, and nothing lies below it."""


class _Place(NamedTuple):
    canvas: Canvas
    row: int
    col: int
    room: Rectangle
    """What the segment may fill before those below it have to move, in its own pixels."""

    def on_sheet(self, part: Rectangle) -> Rectangle:
        return part.translated(self.row, self.col)


class Sheet:
    """Canvases put below one another in the order of their numbers; itself a canvas.

    The first keeps its own pixels. Each has some room to grow, so that the others move seldom.

    Examples
    --------
    >>> from napari_elsplus.processing.tracking.front_end.grid import Grid
    >>> from napari_elsplus.processing.mosaicing.mosaic import Mosaic
    >>> from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter
    >>> grid = Grid(120, 1, (0, 0), (59.5, 59.5), 116.0, RollingShutter(150.0))
    >>> first, second = Mosaic(grid), Mosaic(grid)
    >>> for mosaic in (first, second):
    ...     _ = mosaic.insert(np.ones((120, 120), np.float32), 0.0, 0.0)
    >>> sheet = Sheet()
    >>> _ = sheet.arrange({0: first, 1: second})
    >>> sheet.origin(0), sheet.origin(1)
    ((0, 0), (144, 0))
    """

    def __init__(self) -> None:
        self._places: dict[int, _Place] = {}
        self._dirty: Rectangle | None = None

    @classmethod
    def of(cls, canvases: Mapping[int, Canvas], like: Sheet | None = None) -> Sheet:
        """Put canvases on a new sheet as :meth:`arrange` does, but leave what changed on them to others."""
        sheet = cls()
        sheet._places = sheet._stacked(canvases) if like is None else like.placed_as(canvases)
        return sheet

    def arrange(self, canvases: Mapping[int, Canvas], like: Sheet | None = None) -> bool:
        """Take the segments' canvases with what changed on them, and make room where one has grown.

        Parameters
        ----------
        canvases : mapping of int to Canvas
            The segments by their numbers.
        like : Sheet, optional
            Put them where that sheet has those of the same numbers, which reach at least as far.

        Returns
        -------
        bool
            Whether any that was there before has moved or is gone.
        """
        dirty = {number: canvas.take_dirty() for number, canvas in canvases.items()}
        before = self._places
        self._places = self._stacked(canvases) if like is None else like.placed_as(canvases)
        moved = False
        for number, place in self._places.items():
            known, part = before.get(number), dirty[number]
            if known is None or known[:3] != place[:3]:
                self._soil(place.on_sheet(place.room))
            elif part is not None:
                self._soil(place.on_sheet(part))
        for number, known in before.items():
            now = self._places.get(number)
            if now is None or known[:3] != now[:3]:
                moved = True
                self._soil(known.on_sheet(known.room))
        return moved

    def origin(self, number: int) -> tuple[int, int]:
        """Row and column of the sheet where a segment's (0, 0) lies; (0, 0) for one that is not there."""
        found = self._places.get(number)
        return (0, 0) if found is None else (found.row, found.col)

    @property
    def origins(self) -> dict[int, tuple[int, int]]:
        """Row and column of the sheet where each segment's (0, 0) lies."""
        return {number: (place.row, place.col) for number, place in self._places.items()}

    @property
    def extent(self) -> Rectangle | None:
        """What may be drawn on, the segments' rooms."""
        return bounding_rectangle(place.on_sheet(place.room) for place in self._places.values())

    @property
    def drawn(self) -> Rectangle | None:
        """What has been drawn on."""
        extents = ((place, place.canvas.extent) for place in self._places.values())
        return bounding_rectangle(place.on_sheet(extent) for place, extent in extents if extent is not None)

    def take_dirty(self) -> Rectangle | None:
        """Return what changed up to the last arrangement, or None if that was taken already."""
        dirty, self._dirty = self._dirty, None
        return dirty

    def read(self, part: Rectangle | None = None) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Copy a part of the sheet: grey levels and weights, as a mosaic's."""
        part = part or self.extent or Rectangle(0, 0, 0, 0)
        image, weight = np.zeros(part.shape, np.float32), np.zeros(part.shape, np.float32)
        for place in self._places.values():
            shared = part.intersection(place.on_sheet(place.room))
            if 0 not in shared.shape:
                here = shared.slices(part)
                image[here], weight[here] = place.canvas.read(shared.translated(-place.row, -place.col))
        return image, weight

    def _stacked(self, canvases: Mapping[int, Canvas]) -> dict[int, _Place]:
        """Put each below the one before; who was there keeps its columns and its room."""
        places: dict[int, _Place] = {}
        left = below = 0
        for number in sorted(canvases):
            canvas, known = canvases[number], self._places.get(number)
            extent = canvas.extent
            if extent is None:
                continue
            stays = known is not None and known.canvas is canvas
            room = _room(extent.union(known.room) if known is not None and stays else extent)
            if not places:
                left, row, col = room.left, 0, 0
            else:
                row, col = below - room.top, left - room.left
                col = known.col if known is not None and stays else col
            places[number] = _Place(canvas, row, col, room)
            below = row + room.bottom + GAP_PX
        return places

    def placed_as(self, canvases: Mapping[int, Canvas]) -> dict[int, _Place]:
        """Return the places of other canvases, where this sheet has those of the same numbers."""
        return {
            number: self._places[number]._replace(canvas=canvas)
            for number, canvas in canvases.items()
            if number in self._places
        }

    def _soil(self, part: Rectangle) -> None:
        self._dirty = part if self._dirty is None else self._dirty.union(part)


def _room(extent: Rectangle) -> Rectangle:
    """Round outwards, so that those below seldom move while a segment grows."""
    top, left = (RESERVED_STEP_PX * (first // RESERVED_STEP_PX) for first in (extent.top, extent.left))
    bottom, right = (-RESERVED_STEP_PX * (-last // RESERVED_STEP_PX) for last in (extent.bottom, extent.right))
    return Rectangle(top, left, bottom, right)
