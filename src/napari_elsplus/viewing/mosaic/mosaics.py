"""Interface of growing mosaics, whether made from a stack or by a running engine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping

    from napari_elsplus.io import TrackTable
    from napari_elsplus.processing.images.sectioning import Mode
    from napari_elsplus.processing.mosaicing.tiles import Canvas


class Mosaics(Protocol):
    """A track and its mosaics, which may be read while they grow."""

    @property
    def rows(self) -> TrackTable:
        """Track so far, a row for every frame; another object after it was recomputed."""

    @property
    def canvases(self) -> Mapping[Mode, Mapping[int, Canvas]]:
        """Segments of each mode."""

    @property
    def revision(self) -> int:
        """Number that changes when existing poses or segments change."""

    @property
    def scale(self) -> MosaicScale:
        """Pixel sizes and limits."""


@dataclass(frozen=True)
class MosaicScale:
    """Pixel size of a mosaic, radius of a frame, and limit of the probe's speed.

    Attributes
    ----------
    camera_px_per_pixel : float
        Camera pixels per pixel of the mosaic.
    camera_um_per_px : float or None
        Scale of a camera pixel.
    radius_px : float
        Radius of the inserted disc of a frame, pixels of the mosaic.
    max_px_per_frame : float
        Largest trackable displacement, camera pixels per frame.
    """

    camera_px_per_pixel: float
    camera_um_per_px: float | None
    radius_px: float
    max_px_per_frame: float

    @property
    def um_per_px(self) -> float | None:
        """Scale of a pixel of the mosaic."""
        return None if self.camera_um_per_px is None else self.camera_um_per_px * self.camera_px_per_pixel


def without_last_segment(
    canvases: Mapping[Mode, Mapping[int, Canvas]], rows: TrackTable
) -> dict[Mode, dict[int, Canvas]] | None:
    """Mark the frames of the last segment as lost, and return the mosaics without it.

    Parameters
    ----------
    canvases : mapping
        Segments of each mode, by number.
    rows : TrackTable
        The track; changed in place.

    Returns
    -------
    dict or None
        The remaining segments of each mode; None if there was no segment.
    """
    numbers = {number for segments in canvases.values() for number in segments}
    if not numbers:
        return None
    last = max(numbers)
    rows.lose(last)
    return {
        mode: {number: canvas for number, canvas in segments.items() if number != last}
        for mode, segments in canvases.items()
    }
