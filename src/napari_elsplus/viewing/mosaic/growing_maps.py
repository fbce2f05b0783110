"""Maps of a mosaic while its track grows and is put elsewhere: a few frames at a time, however many there are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus.processing.mosaicing.coverage import Coverage
from napari_elsplus.viewing.mosaic.track import placed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from napari_elsplus.io import TrackTable
    from napari_elsplus.processing.mosaicing.tiles import Rectangle

    Layout = tuple[Rectangle, Mapping[int, tuple[int, int]], int]
    """What the maps cover, where segments lie, and how often rows were written over."""

ROWS_AT_ONCE: Final = 1 << 13
"""Frames that are counted at a time: some five milliseconds' worth."""


class GrowingMaps:
    """How often each place was seen, and how well its frames fit.

    Frames that are new are added. Where some lie elsewhere now, all are counted anew, and until that is done the maps
    are those from before.

    Parameters
    ----------
    rows : TrackTable
        The track.
    radius_px : float
        Of what is used of a frame, pixels of the mosaic.
    camera_px_per_pixel : float
        Camera pixels per pixel of the mosaic.

    Attributes
    ----------
    whole : Coverage or None
        All frames counted, as they lay not long ago.
    """

    def __init__(self, rows: TrackTable, radius_px: float, camera_px_per_pixel: float) -> None:
        self.rows, self._radius_px, self._scale = rows, radius_px, camera_px_per_pixel
        self.whole: Coverage | None = None
        self._counted: Coverage | None = None
        self._layout: Layout | None = None
        self._seen = 0

    def behind(self, part: Rectangle, places: Mapping[int, tuple[int, int]]) -> bool:
        """Whether there is more to count; parameters as of :meth:`add`."""
        return self._seen < len(self.rows) or self._layout != (part, places, self.rows.rewritten)

    def add(self, part: Rectangle, places: Mapping[int, tuple[int, int]]) -> None:
        """Count frames, not too many at once.

        Parameters
        ----------
        part : Rectangle
            The part of the sheet that the maps are to cover.
        places : mapping of int to tuple of int
            Row and column of the sheet where each segment's (0, 0) lies.
        """
        layout = part, places, self.rows.rewritten
        if self._counted is None or (self._seen == len(self.rows) and layout != self._layout):
            self._counted, self._layout, self._seen = Coverage(part, self._radius_px), layout, 0
        fresh = self.rows.columns[self._seen : self._seen + ROWS_AT_ONCE]
        self._counted.add(*placed(fresh, lambda segment: places.get(segment, (0, 0)), self._scale))
        self._seen += len(fresh)
        if self._seen == len(self.rows):
            self.whole = self._counted
