"""The layers of a mosaic that grows: multiscale images, its track with marks, and maps; made once, filled in place."""

from __future__ import annotations

from contextlib import nullcontext
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from napari.layers import Image, Points, Vectors

from napari_elsplus import __version__
from napari_elsplus.processing.mosaicing.coverage import CELL_PX, coverage_maps
from napari_elsplus.viewing.growing import GrowingImage
from napari_elsplus.viewing.layers import MOSAIC, TITLES
from napari_elsplus.viewing.track import BEGINS, LOST, PREDICTED, TrackDrawing, placed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from contextlib import AbstractContextManager

    import napari.viewer
    from napari.layers import Layer

    from napari_elsplus.processing.sectioning import Mode
    from napari_elsplus.viewing.mosaicking import Mosaics, MosaicScale

GAP_PX: Final = 40
TRACK, MARKS, COVERAGE, QUALITY = "track", "track marks", "coverage", "quality"
SCORES: Final = (0.5, 1.0)
"""Correlations at the ends of the track's colours."""
_ABOVE_IMAGES: Final = (COVERAGE, QUALITY, TRACK, MARKS)
"""From below upwards."""
_COLOURS: Final = {PREDICTED: "#e69f00", LOST: "#d55e00", BEGINS: "#56b4e9"}
_SYMBOLS: Final = {PREDICTED: "ring", LOST: "x", BEGINS: "disc"}
_LINE_SHARE: Final = 0.004
_MARK_SHARE: Final = 0.015
_FILLED: Final = 0.9


class MosaicLayers:
    """Layers for mosaics and their track, in the user's viewer.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer. Layers that are there from before are used again, with the user's colours.
    quietly : callable
        Makes a context in which the viewer's list of layers hears of no change.

    Attributes
    ----------
    drawing : TrackDrawing or None
        What is known of the track that is shown.
    """

    def __init__(
        self, viewer: napari.viewer.Viewer, quietly: Callable[[], AbstractContextManager[Any]] = nullcontext
    ) -> None:
        self._viewer, self._quietly = viewer, quietly
        self._mosaics: Mosaics | None = None
        self.drawing: TrackDrawing | None = None

    @property
    def ours(self) -> dict[str, Layer]:
        """Layers of mosaics that are in the viewer, by what they show."""
        known = ((layer.metadata.get("elsplus"), layer) for layer in self._viewer.layers)
        return {facts[MOSAIC]: layer for facts, layer in known if isinstance(facts, dict) and MOSAIC in facts}

    def show(self, mosaics: Mosaics, lead: Mode, titles: Mapping[Mode, str] = TITLES) -> None:
        """Show other mosaics from now on.

        Parameters
        ----------
        mosaics : Mosaics
            May be empty yet.
        lead : Mode
            The mode over which the track is drawn, and after which the others are arranged.
        titles : mapping
            What the modes are called.
        """
        self._mosaics, self._lead, self._titles = mosaics, lead, titles
        self._images = {mode: GrowingImage() for mode in mosaics.canvases}
        self._revision = mosaics.revision
        self.drawing = TrackDrawing(mosaics.scale.camera_px_per_pixel)
        self._camera: tuple[Any, float] | None = None
        self._origin = (0.0, 0.0)
        keep = {mode.value for mode in self._images} | {TRACK, MARKS, COVERAGE, QUALITY}
        for kind, layer in self.ours.items():
            if kind not in keep:
                self._viewer.layers.remove(layer)
        self._made: set[str] = set()

    def forget(self) -> None:
        """Take the layers away."""
        self._mosaics = self.drawing = None
        for layer in self.ours.values():
            self._viewer.layers.remove(layer)

    @property
    def covered_px(self) -> float:
        """Pixels of the mosaic that were drawn on."""
        return 0.0 if self._mosaics is None else self._images[self._lead].covered_px

    def update(self, *, whole: bool) -> bool:
        """Show what came since the last time.

        Parameters
        ----------
        whole : bool
            Also the track, the maps that are shown, and thumbnails.

        Returns
        -------
        bool
            Whether there was anything new.
        """
        mosaics = self._mosaics
        if mosaics is None:
            return False
        assert self.drawing is not None
        if mosaics.revision != self._revision:
            self._revision = mosaics.revision
            self.drawing = TrackDrawing(mosaics.scale.camera_px_per_pixel)
            whole = True
        canvases = mosaics.canvases
        lead = self._images[self._lead]
        changes = {self._lead: lead.update(canvases[self._lead])}
        for mode, image in self._images.items():
            if mode is not self._lead:
                changes[mode] = image.update(canvases[mode], lead.sheet)
        moved = self.drawing.add(mosaics.rows)
        if not lead.levels:
            return False
        reframed = any(change.frame for change in changes.values()) or (whole and self._is_covered)
        self._show_images(changes, reframed, whole)
        if reframed or whole:
            self._draw_track(mosaics.scale)
            self._draw_maps(mosaics)
        if reframed:
            self._look()
        return moved or any(change.pixels for change in changes.values())

    # inside

    def _show_images(self, changes: Mapping[Mode, Any], reframed: bool, whole: bool) -> None:
        assert self._mosaics is not None
        present, step = self.ours, self._step
        if reframed:
            self._origin = self._beside_others()
        left_px = 0
        for mode, image in self._images.items():
            if not image.levels:
                continue
            layer = present.get(mode.value)
            if layer is None and mode.value in self._made:
                continue  # the user took it away
            if layer is None or mode.value not in self._made:
                layer = self._image(mode, image, layer)
            elif changes[mode].frame:
                layer.data = image.levels
            elif changes[mode].pixels and layer.visible:
                with nullcontext() if whole else self._quietly():
                    layer.refresh(thumbnail=whole, extent=False, highlight=False)
            if reframed:
                row, col = self._origin
                aside = left_px if mode is not self._lead else self._lead_left_px()
                layer.translate = (row + image.frame.top * step, col + (image.frame.left + aside) * step)
            left_px += image.frame.shape[1] + GAP_PX

    def _image(self, mode: Mode, image: GrowingImage, layer: Layer | None) -> Layer:
        """Make a layer, or take one that is there from before."""
        assert self._mosaics is not None
        self._made.add(mode.value)
        if layer is not None:
            layer.data = image.levels
            layer.contrast_limits = (0.0, image.white_level)
            self._place(layer, self._step)
            return layer
        words = {"multiscale": True, "contrast_limits": (0.0, image.white_level), "interpolation2d": "linear"}
        layer = Image(image.levels, name=f"mosaic {self._titles[mode]}", **words)
        self._place(layer, self._step)
        self._add(layer, mode.value)
        return layer

    def _draw_track(self, scale: MosaicScale) -> None:
        assert self.drawing is not None
        lead = self._images[self._lead]
        drawn = self.drawing.drawing(lead.sheet.place)
        row, col = self._origin
        place = (row, col + self._lead_left_px() * self._step)
        if len(drawn.lines):
            features = {"score": np.nan_to_num(drawn.score, nan=1.0), "segment": drawn.segment + 1}
            layer = self.ours.get(TRACK)
            if layer is None and TRACK not in self._made:
                layer = Vectors(
                    drawn.lines, features=features, edge_color="score", edge_colormap="viridis",
                    edge_contrast_limits=SCORES, edge_width=2, vector_style="line", name="mosaic track",
                )  # fmt: skip
                self._place(layer, self._step)
                self._add(layer, TRACK)
            elif layer is not None:
                layer.data = drawn.lines
                layer.features = features
                layer.refresh_colors()
            self._made.add(TRACK)
            if layer is not None:
                _move(layer, place)
                width = max(2.0, _LINE_SHARE * max(lead.frame.shape))
                if layer.edge_width != width:
                    layer.edge_width = width
        self._draw_marks(drawn, place)

    def _draw_marks(self, drawn: Any, place: tuple[float, float]) -> None:
        if not len(drawn.marks):
            return
        colours = [_COLOURS[kind] for kind in drawn.kinds]
        symbols = [_SYMBOLS[kind] for kind in drawn.kinds]
        features = {"kind": drawn.kinds, "label": drawn.labels}
        layer = self.ours.get(MARKS)
        if layer is not None and np.array_equal(layer.data, drawn.marks) and MARKS in self._made:
            _move(layer, place)
            return
        if layer is None:
            if MARKS in self._made:
                return
            layer = Points(
                drawn.marks, features=features, symbol=symbols, face_color=colours, border_color=colours,
                text={"string": "{label} ", "color": _COLOURS[BEGINS], "anchor": "lower_right", "size": 11},
                name="mosaic track marks",
            )  # fmt: skip
            self._place(layer, self._step)
            self._add(layer, MARKS)
        else:
            layer.data = drawn.marks
            layer.features = features
            layer.symbol, layer.face_color, layer.border_color = symbols, colours, colours
        self._made.add(MARKS)
        layer.size = max(8.0, _MARK_SHARE * max(self._images[self._lead].frame.shape))
        _move(layer, place)

    def _draw_maps(self, mosaics: Mosaics) -> None:
        """Make the maps hidden; fill those that are looked at."""
        lead = self._images[self._lead]
        shown = {kind: self.ours.get(kind) for kind in (COVERAGE, QUALITY)}
        fresh = [kind for kind, layer in shown.items() if kind not in self._made]
        if not fresh and not any(layer is not None and layer.visible for layer in shown.values()):
            return
        scale = mosaics.scale
        places, scores = placed(mosaics.rows, lead.sheet.place, scale.camera_px_per_pixel)
        maps = coverage_maps(places, scores, scale.radius_px, lead.frame)
        cell = CELL_PX * self._step
        row, col = self._origin
        corner = (
            row + lead.frame.top * self._step + (cell - self._step) / 2,
            col + (lead.frame.left + self._lead_left_px()) * self._step + (cell - self._step) / 2,
        )
        for kind, data, limits in (
            (COVERAGE, maps[0], (0.0, max(1.0, float(maps[0].max())))),
            (QUALITY, maps[1], SCORES),
        ):
            layer = shown[kind]
            if layer is None:
                if kind in self._made:
                    continue
                layer = Image(
                    data, name=f"mosaic {kind}", colormap="viridis", contrast_limits=limits, opacity=0.6, visible=False
                )
                self._place(layer, cell)
                self._add(layer, kind)
            else:
                layer.data = data
                if kind == COVERAGE:
                    layer.contrast_limits = limits
            self._made.add(kind)
            layer.scale, layer.translate = (cell, cell), corner

    @property
    def _step(self) -> float:
        assert self._mosaics is not None
        return self._mosaics.scale.um_per_px or 1.0

    def _lead_left_px(self) -> int:
        """Where the leading mode's column begins, from those before it."""
        left = 0
        for mode, image in self._images.items():
            if mode is self._lead:
                break
            left += image.frame.shape[1] + GAP_PX
        return left

    def _place(self, layer: Layer, step: float) -> None:
        assert self._mosaics is not None
        known = self._mosaics.scale.um_per_px
        layer.scale = (step, step)
        layer.units = ("um", "um") if known else ("pixel", "pixel")
        layer.axis_labels = ("row", "col")

    def _add(self, layer: Layer, kind: str) -> None:
        layer.metadata["elsplus"] = {
            "kind": f"{MOSAIC} {kind}",
            MOSAIC: kind,
            "software": f"napari-elsplus {__version__}",
        }
        selected = set(self._viewer.layers.selection)
        above = [other for one, other in self.ours.items() if _height(one) > _height(kind)]
        place = min((self._viewer.layers.index(other) for other in above), default=len(self._viewer.layers))
        self._viewer.layers.insert(place, layer)
        self._viewer.layers.selection = {layer} if kind == self._lead.value else selected
        self._viewer.canvas.overlays.scale_bar.visible = True

    @property
    def _is_covered(self) -> bool:
        """Whether something is shown now where the mosaics lie."""
        return bool(self._made) and self._beside_others()[1] > self._origin[1]

    def _beside_others(self) -> tuple[float, float]:
        """Where the first mosaic's (0, 0) lies: to the right of what else is shown, or at the origin."""
        ours = set(self.ours.values())
        others = [layer for layer in self._viewer.layers if layer.visible and layer not in ours]
        edges = [layer.extent.world[:, -2:] for layer in others]
        edges = [edge for edge in edges if np.isfinite(edge).all()]
        if not edges:
            return 0.0, 0.0
        frame = next(iter(self._images.values())).frame
        step = self._step
        top, right = min(edge[0, 0] for edge in edges), max(edge[1, 1] for edge in edges)
        return float(top - frame.top * step), float(right + (GAP_PX - frame.left) * step)

    def _look(self) -> None:
        """Look at all of it, unless the user has chosen another view since."""
        camera = self._viewer.scene.camera
        if self._camera is not None and (tuple(camera.center), camera.zoom) != self._camera:
            return
        edges = np.array([layer.extent.world[:, -2:] for layer in self._viewer.layers if layer.visible])
        low, high = edges[:, 0].min(axis=0), edges[:, 1].max(axis=0)
        height, width = self._viewer.canvas.size
        zoom = _FILLED * min(height / max(high[0] - low[0], 1e-9), width / max(high[1] - low[1], 1e-9))
        if isfinite(zoom):
            camera.center = tuple((low + high) / 2)
            camera.zoom = zoom
        self._camera = (tuple(camera.center), camera.zoom)


def _move(layer: Layer, place: tuple[float, float]) -> None:
    """Put a layer somewhere, unless it is there: each move makes napari look at all extents."""
    if tuple(layer.translate) != place:
        layer.translate = place


def _height(kind: str) -> int:
    """Where a layer lies above the images, which are at 0."""
    return 1 + _ABOVE_IMAGES.index(kind) if kind in _ABOVE_IMAGES else 0
