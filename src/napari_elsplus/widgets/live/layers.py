"""Layers of live images: created once, updated in place, with the user's display settings kept."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from threading import Thread
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from napari.layers import Image, Layer, Points

from napari_elsplus._view import change_layer, fit_visible_layers
from napari_elsplus.acquisition.engine.live_images import RAW
from napari_elsplus.instrument.calibration import utc_now
from napari_elsplus.io.formats.ome_xml import SOFTWARE
from napari_elsplus.processing.analysis.image_quality import white_level
from napari_elsplus.processing.analysis.saturation import largest_level
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.viewing.common_axes import plane_axes
from napari_elsplus.viewing.layers import GAP_PX, MOSAIC, SMOOTH, TITLE_RISE, titles_layer
from napari_elsplus.viewing.provenance import GIVES_WAY, LAYER, PROVENANCE, provenance_of, reused_layers
from napari_elsplus.widgets.shared.choosing import LIVE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import napari.viewer
    from numpy.typing import NDArray

    from napari_elsplus.acquisition.streaming.ring import Ring, Stamp
    from napari_elsplus.instrument.calibration import Calibration

KINDS: Final[dict[str, str]] = {RAW: "raw", **{mode.value: mode.label for mode in Mode}}
"""Titles of the images, by field of the display ring."""
TITLES: Final = f"{LIVE} titles"
"""Name and kind of the layer of their titles."""
RAW_GAP: Final = 0.2
"""Rows between the images and the raw frame below them, fraction of an image's rows; chosen: its title fits in."""
MIN_LIT: Final = 10.0
"""Grey level of white below which an image is dark: the galvo is parked, or the laser off. Chosen: noise without light
is a few grey levels, and a dimmer image loses nothing, since its contrast follows it."""


@cache
def import_ahead() -> Thread:
    """Begin to import pandas in a thread, once in a process; return the thread.

    napari imports it for the first points layer, that of the titles: the window would stand still at the first live
    image, for half of the second that creating the layers takes.
    """
    thread = Thread(target=import_module, args=("pandas",), name="import for layers")
    thread.start()
    return thread


class LiveLayers:
    """One layer per kind of live image, in the user's viewer.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer. Those of a panel that was closed are used again, with the user's colormap and contrast.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        self._viewer = viewer
        left = {facts["kind"]: layer for facts, layer in reused_layers(viewer.layers)}
        self._layers: dict[str, Image] = {kind: left[f"{LIVE} {kind}"] for kind in KINDS if f"{LIVE} {kind}" in left}
        self._titles: Points | None = left.get(TITLES)
        self._last_sequence = -1
        self._unscaled: set[str] = set()
        self._dark: dict[str, tuple[float, float]] = {}
        self._begins, self._fits = True, False
        self._arrangement: tuple[frozenset[str], bool] = frozenset(), True

    @property
    def images(self) -> dict[str, Image]:
        """Layers that are in the viewer, by kind."""
        return {kind: layer for kind, layer in self._layers.items() if layer in self._viewer.layers}

    @property
    def hidden(self) -> bool:
        """True if there are images, and the user or a recording that was opened has hidden all of them."""
        return bool(self.images) and not any(layer.visible for layer in self.images.values())

    def removed(self, kinds: Sequence[str]) -> list[str]:
        """Return those of some `kinds` whose layers were removed from the viewer since they were arranged."""
        present = self.images
        return [kind for kind in kinds if kind in self._layers and kind not in present]

    def begin(self) -> None:
        """Let the next arrangement display the images in place of what covers them, as where a stream begins."""
        self._begins = True

    @property
    def _ours(self) -> list[Layer]:
        titles = [self._titles] if self._titles is not None and self._titles in self._viewer.layers else []
        return [*self.images.values(), *titles]

    def arrange(
        self,
        kinds: Sequence[str],
        ring: Ring,
        calibration: Calibration | None,
        *,
        side_by_side: bool,
        calibration_file: Path | None = None,
        rig: str | None = None,
    ) -> bool:
        """Display the given kinds and hide the others; layers of the same kind and size are reused.

        A call creates one image at most, since napari takes a tenth of a second for each, and longer on a busy
        computer: the first is displayed, and the window answers, before the next is created. When a stream begins, the
        viewer's other layers are hidden except mosaics, which move aside. The view is fitted to the layers where they
        are new in the viewer, or where the user chose further ones or another arrangement.

        Parameters
        ----------
        kinds : sequence of str
            Keys of `KINDS`.
        ring : Ring
            The engine's display ring; gives shapes and data types.
        calibration : Calibration or None
            Gives the scale; kept in the metadata.
        side_by_side : bool
            Images side by side, and the raw frame below them; otherwise all in one place.
        calibration_file : pathlib.Path, optional
            Its file, for the metadata.
        rig : str, optional
            Name of the rig, for the metadata.

        Returns
        -------
        bool
            True if all are displayed with their titles, False if this is to be called again.
        """
        shapes = {name: (shape, dtype) for name, shape, dtype in ring.layout.fields}
        self._layers = self.images
        known = self._ours
        others = [layer for layer in self._viewer.layers if layer not in known]
        axes, adopted = plane_axes(None if calibration is None else calibration.um_per_px, others)
        complete = True
        (before, was_apart), self._arrangement = self._arrangement, (frozenset(kinds), side_by_side)
        self._fits |= (self._begins and not known) or not before.issuperset(kinds) or side_by_side != was_apart
        shown = {kind: shapes[kind] for kind in KINDS if kind in kinds and kind in shapes}
        corners = _corners_px({kind: shape for kind, (shape, _) in shown.items()}, side_by_side=side_by_side)
        for kind, image in self.images.items():
            change_layer(image, visible=kind in shown)
        for kind, (shape, dtype) in shown.items():
            layer = self.images.get(kind)
            if layer is not None and layer.data.shape != shape:
                self._viewer.layers.remove(layer)
                layer = None
            translate = tuple(step * px for step, px in zip(axes["scale"], corners[kind], strict=True))
            place: dict[str, Any] = {**axes, "translate": translate}
            facts: dict[str, Any] = {
                "kind": f"{LIVE} {kind}", "stack": None, "path": None, "calibration": calibration,
                "calibration_path": calibration_file, "file": {}, "software": SOFTWARE,
                "rig": rig, "displayed_since": utc_now(), GIVES_WAY: True, **adopted,
            }  # fmt: skip
            if layer is None and complete:
                self._add(kind, shape, dtype, {**place, "metadata": {PROVENANCE: facts}})
                complete = False
            elif layer is not None:
                change_layer(layer, **place)
                layer.metadata[PROVENANCE] = facts | {LAYER: layer.unique_id}
        self._last_sequence = -1
        if complete or self._titles in self._viewer.layers:
            rise = {kind: TITLE_RISE * shape[0] for kind, (shape, _) in shown.items()}
            titles = {KINDS[kind]: (row - rise[kind], float(col)) for kind, (row, col) in corners.items()}
            self._arrange_titles(titles if side_by_side else {}, axes)
        if self._begins and self.images:
            covering = [layer for layer in others if layer.visible and MOSAIC not in provenance_of(layer.metadata)]
            for layer in covering:
                layer.visible = False
            self._fits |= bool(covering)
            self._viewer.canvas.overlays.scale_bar.visible = True
        if self._fits:
            fit_visible_layers(self._viewer)
        if complete and self.images:
            self._begins = self._fits = False
        return complete

    def update(self, ring: Ring, *, whole: bool) -> Stamp | None:
        """Copy the newest frame into the layers and redraw the visible ones; None if there is no new frame.

        Parameters
        ----------
        ring : Ring
            The engine's display ring.
        whole : bool
            Full refresh, also of thumbnails and extent.

        Notes
        -----
        A layer's slice is a view of the array that is written here, so that the event ``set_data`` suffices: 0.7 ms
        against 1.8 ms for a refresh without thumbnail, extent and highlight (520 x 520 pixels, napari 0.9.2).
        """
        shapes = {name: shape for name, shape, _ in ring.layout.fields}
        images = self.images.items()  # a hidden one may still have the shape of another preset
        filled = {kind: layer for kind, layer in images if layer.data.shape == shapes.get(kind)}
        stamp = ring.newest_after(self._last_sequence, {kind: layer.data for kind, layer in filled.items()})
        if stamp is None:
            return None
        self._last_sequence = stamp.sequence
        for kind, layer in filled.items():
            if not layer.visible:
                continue
            first = kind in self._unscaled
            if first or (whole and self._dark.get(kind) == tuple(layer.contrast_limits)):
                self._unscaled.discard(kind)
                self.rescale_contrast(kind)
            if whole or first:
                layer.refresh()
            else:
                layer.events.set_data()
        return stamp

    def rescale_contrast(self, kind: str) -> None:
        """Set the contrast limits of a kind's layer: 0.01 % of the pixels saturated, or all grey levels for raw.

        Those of a dark image are set anew by :meth:`update` until it is lit, unless the user has changed them.
        """
        layer = self.images[kind]
        if kind == RAW:
            layer.contrast_limits = (0, largest_level(layer.data))
            return
        image = np.asarray(layer.data)
        white = white_level(image)
        layer.contrast_limits = (0.0, max(float(white), 1.0))
        self._dark.pop(kind, None)
        if white < MIN_LIT:
            self._dark[kind] = tuple(layer.contrast_limits)

    def keep_contrast(self) -> None:
        """Leave the contrast limits of dark images as they are."""
        self._dark.clear()

    def _arrange_titles(self, corners: dict[str, tuple[float, float]], place: dict[str, Any]) -> None:
        """Write each image's kind above it, at its corner (row, col) in pixels of a scale and units."""
        data, attributes, _ = titles_layer(TITLES, list(corners), list(corners.values()), place)
        if self._titles is not None and self._titles in self._viewer.layers:
            written = self._titles.data.tolist(), self._titles.features["title"].tolist()
            if written != (data.tolist(), list(corners)):
                self._titles.data, self._titles.features = data, attributes["features"]
            change_layer(self._titles, visible=True, scale=place["scale"], units=place["units"])
        elif corners:
            self._titles = Points(data, **attributes)
            self._titles.editable = False
            self._titles.metadata[PROVENANCE] = {"kind": TITLES, GIVES_WAY: True, LAYER: self._titles.unique_id}
            active = self._viewer.layers.selection.active
            self._viewer.layers.append(self._titles)
            self._viewer.layers.selection.active = active

    def _add(self, kind: str, shape: tuple[int, ...], dtype: str, place: dict[str, Any]) -> None:
        buffer: NDArray[Any] = np.zeros(shape, dtype)
        options = {"name": f"{LIVE} {KINDS[kind]}", "colormap": "gray", "contrast_limits": (0, 1), "cache": False}
        options["interpolation2d"] = "nearest" if kind == RAW else SMOOTH
        layer = Image(buffer, **options, **place)
        layer.metadata[PROVENANCE][LAYER] = layer.unique_id
        self._layers[kind] = layer
        self._unscaled.add(kind)
        self._viewer.layers.append(layer)


def _corners_px(shapes: Mapping[str, tuple[int, ...]], *, side_by_side: bool) -> dict[str, tuple[int, int]]:
    """Return row and column of the corner of images: side by side, the raw frame below them, or all in one place.

    Parameters
    ----------
    shapes : mapping of str to tuple of int
        (rows, cols) by kind, in their order.
    side_by_side : bool
        Otherwise in one place.
    """
    if not side_by_side:
        return dict.fromkeys(shapes, (0, 0))
    corners, left_px = {}, 0
    for kind, (_, cols) in shapes.items():
        if kind != RAW:
            corners[kind] = 0, left_px
            left_px += cols + GAP_PX
    rows = max((shapes[kind][0] for kind in corners), default=0)
    return {RAW: (round((1 + RAW_GAP) * rows), 0), **corners} if RAW in shapes else corners
