"""Layers of a mosaic in the user's viewer: reused, ordered, and not recreated after the user removed them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus._view import remove_layers
from napari_elsplus.io.formats.ome_xml import SOFTWARE
from napari_elsplus.viewing.common_axes import plane_axes
from napari_elsplus.viewing.layers import MOSAIC
from napari_elsplus.viewing.provenance import LAYER, PROVENANCE, reused_layers

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    import napari.viewer
    from napari.layers import Layer

TRACK, MARKS, COVERAGE, QUALITY, NAMES = "track", "track marks", "coverage", "quality", "titles"
_ABOVE_IMAGES: Final = (COVERAGE, QUALITY, NAMES, TRACK, MARKS)
"""Order above the images, from bottom to top."""


class OwnLayers:
    """Layers by kind: the name of a mode, or one of the five above.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer.

    Attributes
    ----------
    postponed : bool
        A layer is still to be created: an update creates one, since napari takes a second for it on a slow computer.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        self._viewer = viewer
        self._obtained: set[str] = set()
        self._may_make = self.postponed = False
        self._axes, self._adopted = plane_axes(None, ())

    @property
    def present(self) -> dict[str, Layer]:
        """Layers in the viewer, by kind; copies that the user has made of them are the user's."""
        return {facts[MOSAIC]: layer for facts, layer in reused_layers(self._viewer.layers) if MOSAIC in facts}

    @property
    def step(self) -> float:
        """Size of a mosaic's pixel in the viewer: micrometres, or that of calibrated layers, or 1."""
        size: float = self._axes["scale"][0]
        return size

    def begin(self, kinds: Collection[str], um_per_px: float | None) -> None:
        """Prepare for another mosaic: remove layers that it does not have, and reuse the rest.

        Parameters
        ----------
        kinds : collection of str
            Kinds of layers of the new mosaic.
        um_per_px : float or None
            Size of its pixel; if unknown, it is displayed with that of calibrated layers.
        """
        ours = list(self.present.values())
        self._obtained, self.postponed = set(), False
        self._axes, self._adopted = plane_axes(um_per_px, [one for one in self._viewer.layers if one not in ours])
        remove_layers(self._viewer, [layer for kind, layer in self.present.items() if kind not in kinds])

    def begin_update(self) -> None:
        """Allow that one more layer is created."""
        self._may_make, self.postponed = True, False

    def clear(self) -> None:
        """Remove all of them."""
        remove_layers(self._viewer, list(self.present.values()))

    def is_new(self, kind: str) -> bool:
        """Return True if no layer of this kind was obtained for the present mosaic yet."""
        return kind not in self._obtained

    def obtain(self, kind: str, make: Callable[[], Layer], *, select: bool = False) -> tuple[Layer | None, bool]:
        """Return the layer of a kind, created if necessary, and True if it was; None if the user has removed it.

        None, too, where this update has created another: `postponed` is set then, and the next one creates it.

        Parameters
        ----------
        kind : str
            A mode, or one of the five above.
        make : callable
            Creates the layer.
        select : bool
            Select a layer that is created.
        """
        layer, new = self.present.get(kind), self.is_new(kind)
        made = layer is None and new
        if made and not self._may_make:
            self.postponed = True
            return None, False
        self._obtained.add(kind)
        if made:
            self._may_make = False
            layer = make()
        if layer is not None and new:
            layer.scale, layer.units = self._axes["scale"], self._axes["units"]
            layer.axis_labels = ("row", "col")
            layer.metadata[PROVENANCE] = {
                "kind": f"{MOSAIC} {kind}",
                MOSAIC: kind,
                LAYER: layer.unique_id,
                "software": SOFTWARE,
                **self._adopted,
            }
        if made:
            self._insert(layer, kind, select)
        return layer, made

    def _insert(self, layer: Layer, kind: str, select: bool) -> None:
        selected = set(self._viewer.layers.selection)
        above = [other for one, other in self.present.items() if _height(one) > _height(kind)]
        place = min((self._viewer.layers.index(other) for other in above), default=len(self._viewer.layers))
        self._viewer.layers.insert(place, layer)
        self._viewer.layers.selection = {layer} if select else selected
        self._viewer.canvas.overlays.scale_bar.visible = True


def _height(kind: str) -> int:
    """Return the position of a kind above the images, which are at 0."""
    return 1 + _ABOVE_IMAGES.index(kind) if kind in _ABOVE_IMAGES else 0
