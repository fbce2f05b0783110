"""Layout of the mosaics of all segments on one canvas, one below the other, with room to grow."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.mosaicing.tiles import Canvas, Rectangle, bounding_rectangle

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

GAP_PX: Final = 16
"""Empty rows between the reserved areas of two segments, pixels; chosen: narrow, but visible."""
RESERVED_STEP_PX: Final = 64
"""Edges of reserved areas are multiples of this, pixels; chosen: mostly the last segment grows, with none below it."""


class _Place(NamedTuple):
    canvas: Canvas
    row: int
    col: int
    reserved: Rectangle
    """Area that the segment may fill before those below it have to move, in its own pixels."""

    def on_sheet(self, part: Rectangle) -> Rectangle:
        return part.translated(self.row, self.col)


class Sheet:
    """Canvas that shows the canvases of all segments, one below the other in the order of their numbers.

    The first keeps its own pixel coordinates. Each has an area reserved for growth, so that the others move seldom.

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
        """Arrange canvases on a new sheet as :meth:`arrange` does, without consuming their dirty rectangles."""
        sheet = cls()
        sheet._places = sheet._stacked(canvases) if like is None else like.placed_as(canvases)
        return sheet

    def arrange(self, canvases: Mapping[int, Canvas], like: Sheet | None = None) -> bool:
        """Update the layout and consume the dirty rectangles of the segments' canvases.

        Parameters
        ----------
        canvases : mapping of int to Canvas
            Canvas of each segment, by its number.
        like : Sheet, optional
            Sheet whose layout is copied; its segments extend at least as far as those of the same numbers here.

        Returns
        -------
        bool
            True if a segment that was there before has moved or is gone.
        """
        dirty = {number: canvas.take_dirty() for number, canvas in canvases.items()}
        before = self._places
        self._places = self._stacked(canvases) if like is None else like.placed_as(canvases)
        moved = False
        for number, place in self._places.items():
            known, part = before.get(number), dirty[number]
            if known is None or known[:3] != place[:3]:
                self._mark_dirty(place.on_sheet(place.reserved))
            elif part is not None:
                self._mark_dirty(place.on_sheet(part))
        for number, known in before.items():
            now = self._places.get(number)
            if now is None or known[:3] != now[:3]:
                moved = True
                self._mark_dirty(known.on_sheet(known.reserved))
        return moved

    def origin(self, number: int) -> tuple[int, int]:
        """Return row and column of the sheet of pixel (0, 0) of the segment with a number; (0, 0) if it is absent."""
        return self.origins.get(number, (0, 0))

    @property
    def origins(self) -> dict[int, tuple[int, int]]:
        """Row and column of the sheet of each segment's pixel (0, 0), by its number."""
        return {number: (place.row, place.col) for number, place in self._places.items()}

    @property
    def extent(self) -> Rectangle | None:
        """Rectangle around the reserved areas of all segments; None if there are none."""
        return bounding_rectangle(place.on_sheet(place.reserved) for place in self._places.values())

    @property
    def drawn(self) -> Rectangle | None:
        """Rectangle around everything that was drawn; None if nothing was."""
        extents = ((place, place.canvas.extent) for place in self._places.values())
        return bounding_rectangle(place.on_sheet(extent) for place, extent in extents if extent is not None)

    def take_dirty(self) -> Rectangle | None:
        """Return the rectangle that changed up to the last :meth:`arrange`, or None; the next call returns None."""
        dirty, self._dirty = self._dirty, None
        return dirty

    def read(self, part: Rectangle | None = None) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Copy a part of the sheet, by default all; return grey levels and weights as :meth:`TiledCanvas.read` does."""
        part = part or self.extent or Rectangle(0, 0, 0, 0)
        image, weight = np.zeros(part.shape, np.float32), np.zeros(part.shape, np.float32)
        for place in self._places.values():
            shared = part.intersection(place.on_sheet(place.reserved))
            if 0 not in shared.shape:
                here = shared.slices(part)
                image[here], weight[here] = place.canvas.read(shared.translated(-place.row, -place.col))
        return image, weight

    def _stacked(self, canvases: Mapping[int, Canvas]) -> dict[int, _Place]:
        """Place each segment below the one before; those already placed keep their columns and reserved areas."""
        places: dict[int, _Place] = {}
        left = below = 0
        for number in sorted(canvases):
            canvas, known = canvases[number], self._places.get(number)
            extent = canvas.extent
            if extent is None:
                continue
            stays = known is not None and known.canvas is canvas
            whole = extent.union(known.reserved) if known is not None and stays else extent
            reserved = whole.aligned(RESERVED_STEP_PX)  # so that segments below seldom move while this one grows
            if not places:
                left, row, col = reserved.left, 0, 0
            else:
                row, col = below - reserved.top, left - reserved.left
                col = known.col if known is not None and stays else col
            places[number] = _Place(canvas, row, col, reserved)
            below = row + reserved.bottom + GAP_PX
        return places

    def placed_as(self, canvases: Mapping[int, Canvas]) -> dict[int, _Place]:
        """Return the places of other canvases, those of the segments of the same numbers on this sheet."""
        return {
            number: self._places[number]._replace(canvas=canvas)
            for number, canvas in canvases.items()
            if number in self._places
        }

    def _mark_dirty(self, part: Rectangle) -> None:
        self._dirty = part if self._dirty is None else self._dirty.union(part)
