"""Mosaics that are looked at while they grow, whoever makes them: what they tell of themselves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan
from typing import TYPE_CHECKING, Protocol

from napari_elsplus.processing.tracking.pose import State

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from napari_elsplus.io import TrackPoint
    from napari_elsplus.processing.mosaicing.tiles import Canvas
    from napari_elsplus.processing.sectioning import Mode


class Mosaics(Protocol):
    """What is looked at while it grows: a track and mosaics, made here or by a running engine."""

    @property
    def rows(self) -> Sequence[TrackPoint]:
        """The track so far, a row for every frame."""

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
    canvases: Mapping[Mode, Mapping[int, Canvas]], rows: Sequence[TrackPoint]
) -> tuple[dict[Mode, dict[int, Canvas]], list[TrackPoint]] | None:
    """Return mosaics and track without the last segment, its frames called lost; None if there is no segment."""
    numbers = {number for segments in canvases.values() for number in segments}
    if not numbers:
        return None
    last = max(numbers)
    kept = {
        mode: {number: canvas for number, canvas in segments.items() if number != last}
        for mode, segments in canvases.items()
    }
    return kept, [_lost(row) if row.segment == last else row for row in rows]


def _lost(row: TrackPoint) -> TrackPoint:
    return replace(
        row, row_px=nan, col_px=nan, row_um=nan, col_um=nan, score=nan, sigma_px=nan, state=State.LOST.value
    )  # fmt: skip
