"""Coverage and quality maps of a growing mosaic, updated a limited number of frames at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus.processing.mosaicing.coverage import Coverage
from napari_elsplus.viewing.mosaic.track import placed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from napari_elsplus.io import TrackTable
    from napari_elsplus.processing.mosaicing.tiles import Rectangle

    Layout = tuple[Rectangle, Mapping[int, tuple[int, int]], int]
    """Part that the maps cover, positions of the segments, and number of rewrites of the track."""

ROWS_AT_ONCE: Final = 1 << 13
"""Frames counted per call: about 5 ms, chosen."""


class GrowingMaps:
    """Number of frames at each place of a mosaic, and their mean registration score.

    New frames are added. After a change of poses all frames are counted again; until that is finished the previous maps
    remain valid.

    Parameters
    ----------
    rows : TrackTable
        The track.
    radius_px : float
        Radius of the inserted disc of a frame, pixels of the mosaic.
    camera_px_per_pixel : float
        Camera pixels per pixel of the mosaic.

    Attributes
    ----------
    whole : Coverage or None
        Maps of all frames at their latest complete count.
    """

    def __init__(self, rows: TrackTable, radius_px: float, camera_px_per_pixel: float) -> None:
        self.rows, self._radius_px, self._scale = rows, radius_px, camera_px_per_pixel
        self.whole: Coverage | None = None
        self._counted: Coverage | None = None
        self._layout: Layout | None = None
        self._seen = 0

    def behind(self, part: Rectangle, places: Mapping[int, tuple[int, int]]) -> bool:
        """Return True if there is more to count; parameters as of :meth:`add`."""
        return self._seen < len(self.rows) or self._layout != (part, places, self.rows.rewritten)

    def add(self, part: Rectangle, places: Mapping[int, tuple[int, int]]) -> None:
        """Count the next frames, a limited number.

        Parameters
        ----------
        part : Rectangle
            Part of the sheet that the maps cover.
        places : mapping of int to tuple of int
            Row and column of each segment's (0, 0) on the sheet.
        """
        layout = part, places, self.rows.rewritten
        if self._counted is None or (self._seen == len(self.rows) and layout != self._layout):
            self._counted, self._layout, self._seen = Coverage(part, self._radius_px), layout, 0
        fresh = self.rows.columns[self._seen : self._seen + ROWS_AT_ONCE]
        self._counted.add(*placed(fresh, lambda segment: places.get(segment, (0, 0)), self._scale))
        self._seen += len(fresh)
        if self._seen == len(self.rows):
            self.whole = self._counted
