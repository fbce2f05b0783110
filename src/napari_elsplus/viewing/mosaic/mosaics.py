"""Mosaics that are looked at while they grow, whoever makes them: what they tell of themselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping

    from napari_elsplus.io import TrackTable
    from napari_elsplus.processing.images.sectioning import Mode
    from napari_elsplus.processing.mosaicing.tiles import Canvas


class Mosaics(Protocol):
    """What is looked at while it grows: a track and mosaics, made here or by a running engine."""

    @property
    def rows(self) -> TrackTable:
        """The track so far, a row for every frame; another object where it was made anew."""

    @property
    def canvases(self) -> Mapping[Mode, Mapping[int, Canvas]]:
        """The segments of each mode."""

    @property
    def revision(self) -> int:
        """Another number once what was there before has changed."""

    @property
    def scale(self) -> MosaicScale:
        """How large things are."""


@dataclass(frozen=True)
class MosaicScale:
    """How large the pixels of a mosaic are, and how far a frame reaches.

    Attributes
    ----------
    camera_px_per_pixel : float
        Camera pixels per pixel of the mosaic.
    camera_um_per_px : float or None
        Scale of a camera pixel.
    radius_px : float
        Of what is used of a frame, pixels of the mosaic.
    fastest_px : float
        Camera pixels per frame that can be followed.
    """

    camera_px_per_pixel: float
    camera_um_per_px: float | None
    radius_px: float
    fastest_px: float

    @property
    def um_per_px(self) -> float | None:
        """Scale of a pixel of the mosaic."""
        return None if self.camera_um_per_px is None else self.camera_um_per_px * self.camera_px_per_pixel


def without_last_segment(
    canvases: Mapping[Mode, Mapping[int, Canvas]], rows: TrackTable
) -> dict[Mode, dict[int, Canvas]] | None:
    """Call the frames of the last segment lost, and return the mosaics without it; None if there is no segment."""
    numbers = {number for segments in canvases.values() for number in segments}
    if not numbers:
        return None
    last = max(numbers)
    rows.lose(last)
    return {
        mode: {number: canvas for number, canvas in segments.items() if number != last}
        for mode, segments in canvases.items()
    }
