"""Layers of a growing mosaic: multiscale images side by side, with track and maps over the first."""

from __future__ import annotations

from contextlib import nullcontext
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from napari.layers import Image, Points

from napari_elsplus._view import fit_visible_layers
from napari_elsplus.processing.mosaicing.coverage import Coverage
from napari_elsplus.viewing.layers import TITLE_RISE, titles_layer
from napari_elsplus.viewing.mosaic.growing import GrowingImage
from napari_elsplus.viewing.mosaic.growing_maps import GrowingMaps
from napari_elsplus.viewing.mosaic.track import TrackDrawing
from napari_elsplus.widgets.mosaic.map_layers import draw_maps, maps_visible
from napari_elsplus.widgets.mosaic.own_layers import COVERAGE, MARKS, NAMES, QUALITY, TRACK, OwnLayers
from napari_elsplus.widgets.mosaic.track_layers import draw_track

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from contextlib import AbstractContextManager

    import napari.viewer
    from numpy.typing import NDArray

    from napari_elsplus.processing.images.sectioning import Mode
    from napari_elsplus.viewing.mosaic.growing import Change
    from napari_elsplus.viewing.mosaic.mosaics import Mosaics

GAP_PX: Final = 40
"""Columns between mosaics, pixels of the mosaic; chosen."""


class MosaicLayers:
    """Layers of mosaics and their track in the user's viewer.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer. Existing layers of mosaics are reused, with the user's colormap.
    quietly : callable
        Returns a context in which the viewer's layer list receives no signals.

    Attributes
    ----------
    own : OwnLayers
        Layers that are in the viewer.
    drawing : TrackDrawing or None
        Lines and marks of the displayed track.
    """

    def __init__(
        self, viewer: napari.viewer.Viewer, quietly: Callable[[], AbstractContextManager[Any]] = nullcontext
    ) -> None:
        self._viewer, self._quietly = viewer, quietly
        self.own = OwnLayers(viewer)
        self._mosaics: Mosaics | None = None
        self.drawing: TrackDrawing | None = None

    def show(self, mosaics: Mosaics, lead: Mode, title: str | None = None) -> None:
        """Display mosaics, in place of earlier ones.

        Parameters
        ----------
        mosaics : Mosaics
            May still be empty.
        lead : Mode
            Mode over which the track is drawn, and whose layout the others follow.
        title : str, optional
            Title of the only mosaic of finished images; by default the labels of the modes.
        """
        self._mosaics, self._lead, self._title = mosaics, lead, title
        self._images = {mode: GrowingImage() for mode in mosaics.canvases}
        self._revision = mosaics.revision
        self._reset_track(mosaics)
        self._camera: tuple[Any, float] | None = None
        self._origin = (0.0, 0.0)
        kinds = {mode.value for mode in self._images} | {TRACK, MARKS, COVERAGE, QUALITY}
        kinds |= {NAMES} if len(self._images) > 1 else set()
        self.own.begin(kinds, mosaics.scale.um_per_px)

    def remove(self) -> None:
        """Remove the layers."""
        self._mosaics = self.drawing = None
        self.own.clear()

    @property
    def covered_px(self) -> float:
        """Number of covered pixels of the mosaic."""
        return 0.0 if self._mosaics is None else self._images[self._lead].covered_px

    @property
    def removed(self) -> bool:
        """True if the user has removed the layer of the leading mode."""
        kind = "" if self._mosaics is None else self._lead.value
        return self._mosaics is not None and not self.own.is_new(kind) and kind not in self.own.present

    @property
    def behind(self) -> bool:
        """True while layers are to be created, or rows of the track or the maps drawn: each update does some."""
        if self._mosaics is None or self.drawing is None:
            return False
        lead = self._images[self._lead]
        unmapped = maps_visible(self.own) and self._maps.behind(lead.frame, lead.sheet.origins)
        return self.own.postponed or self.drawing.behind > 0 or unmapped

    def update(self, *, whole: bool) -> bool:
        """Draw what is new.

        Parameters
        ----------
        whole : bool
            Draw also track, visible maps and thumbnails.

        Returns
        -------
        bool
            True if anything was new.
        """
        mosaics = self._mosaics
        if mosaics is None:
            return False
        assert self.drawing is not None
        if mosaics.revision != self._revision:
            self._revision, whole = mosaics.revision, True
        if mosaics.rows is not self.drawing.rows:
            self._reset_track(mosaics)
        canvases = mosaics.canvases
        lead = self._images[self._lead]
        changes = {self._lead: lead.update(canvases[self._lead])}
        for mode, image in self._images.items():
            if mode is not self._lead:
                changes[mode] = image.update(canvases[mode], lead.sheet)
        moved = self.drawing.add()
        if not lead.levels:
            return False
        if maps_visible(self.own):
            self._maps.add(lead.frame, lead.sheet.origins)
        reframed = any(change.frame for change in changes.values()) or (whole and self._is_covered)
        reframed |= self.own.postponed
        self.own.begin_update()
        self._show_images(changes, reframed, whole)
        if reframed or whole:
            self._draw_over(mosaics)
        if reframed or whole:
            self._fit_camera()
        return moved or any(change.pixels for change in changes.values())

    def _show_images(self, changes: Mapping[Mode, Change], reframed: bool, whole: bool) -> None:
        own = self.own
        if reframed:
            self._origin = self._beside_others()
        for mode, image in self._images.items():
            if not image.levels:
                continue
            new = own.is_new(mode.value)
            layer, made = own.obtain(mode.value, partial(self._made, mode, image), select=mode is self._lead)
            if layer is None:
                continue
            if new and not made:
                layer.data, layer.contrast_limits = image.levels, (0.0, image.white_level)
            elif changes[mode].frame and not made:
                layer.data = image.levels
            elif changes[mode].pixels and layer.visible and not made:
                with nullcontext() if whole else self._quietly():
                    layer.refresh(thumbnail=whole, extent=False, highlight=False)
            if reframed:
                row, col = self._place(mode)
                layer.translate = (row + image.frame.top * own.step, col + image.frame.left * own.step)
        if (reframed or whole) and len(self._images) > 1:
            self._draw_titles()

    def _draw_titles(self) -> None:
        """Write the title of each mosaic above it."""
        step, drawn = self.own.step, self._drawn()
        corners = [(top - TITLE_RISE * (bottom - top), left) for (top, left), (bottom, _) in drawn.values()]
        corners = [(row / step, col / step) for row, col in corners]
        data, attributes, _ = titles_layer("mosaic titles", [mode.label for mode in drawn], corners, {})
        layer, made = self.own.obtain(NAMES, lambda: Points(data, **attributes))
        if layer is not None and not made and not np.array_equal(layer.data, data):
            layer.data, layer.features = data, attributes["features"]

    def _made(self, mode: Mode, image: GrowingImage) -> Image:
        return Image(
            image.levels, multiscale=True, contrast_limits=(0.0, image.white_level), interpolation2d="linear",
            name=f"mosaic {self._title or mode.label}",
        )  # fmt: skip

    def _draw_over(self, mosaics: Mosaics) -> None:
        """Draw track and maps over the mosaic of the leading mode."""
        assert self.drawing is not None
        lead, place = self._images[self._lead], self._place(self._lead)
        draw_track(self.own, self.drawing.geometry(lead.sheet.origin), place, max(lead.frame.shape))
        counted = self._maps.whole if maps_visible(self.own) else None
        if counted is not None or self.own.is_new(COVERAGE) or self.own.is_new(QUALITY):
            draw_maps(self.own, counted or Coverage(lead.frame, mosaics.scale.radius_px), place)

    def _reset_track(self, mosaics: Mosaics) -> None:
        """Draw another track."""
        scale = mosaics.scale
        self.drawing = TrackDrawing(mosaics.rows, scale.camera_px_per_pixel)
        self._maps = GrowingMaps(mosaics.rows, scale.radius_px, scale.camera_px_per_pixel)

    def _place(self, mode: Mode) -> tuple[float, float]:
        """Return the world position of (0, 0) of a mode's mosaic: each has its own column, whether visible or not."""
        left_px = 0
        for before, image in self._images.items():
            if before is mode:
                break
            left_px += image.frame.shape[1] + GAP_PX if image.levels else 0
        row, col = self._origin
        return row, col + left_px * self.own.step

    def _drawn(self) -> dict[Mode, NDArray[np.float64]]:
        """Return the first and last corner, in the world, of what is drawn of each mosaic; its frame is larger."""
        parts = {mode: image.sheet.drawn for mode, image in self._images.items() if image.levels}
        edges = {mode: np.reshape(part, (2, 2)) for mode, part in parts.items() if part is not None}
        return {mode: np.array(self._place(mode)) + self.own.step * corners for mode, corners in edges.items()}

    @property
    def _is_covered(self) -> bool:
        """True if other layers now cover the place of the mosaics."""
        return not self.own.is_new(self._lead.value) and self._beside_others()[1] > self._origin[1]

    def _beside_others(self) -> tuple[float, float]:
        """Return the world position of the first mosaic's (0, 0): right of other visible layers, or the origin."""
        ours = set(self.own.present.values())
        others = [layer for layer in self._viewer.layers if layer.visible and layer not in ours]
        edges = [layer.extent.world[:, -2:] for layer in others]
        edges = [edge for edge in edges if np.isfinite(edge).all()]
        if not edges:
            return 0.0, 0.0
        frame = next(iter(self._images.values())).frame
        step = self.own.step
        top, right = min(edge[0, 0] for edge in edges), max(edge[1, 1] for edge in edges)
        return float(top - frame.top * step), float(right + (GAP_PX - frame.left) * step)

    def _fit_camera(self) -> None:
        """Show what is drawn, and all other visible layers, unless the user has moved the camera."""
        camera = self._viewer.scene.camera
        if self._camera is not None and (tuple(camera.center), camera.zoom) != self._camera:
            return
        present, drawn = self.own.present, self._drawn()
        parts = {present[mode.value]: corners for mode, corners in drawn.items() if mode.value in present}
        if self._lead in drawn:
            parts |= {present[kind]: drawn[self._lead] for kind in (COVERAGE, QUALITY) if kind in present}
        fit_visible_layers(self._viewer, parts)
        self._camera = (tuple(camera.center), camera.zoom)
