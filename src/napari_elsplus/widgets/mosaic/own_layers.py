"""The layers of a mosaic in the user's viewer: used again, placed, kept in order, and not brought back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus import __version__
from napari_elsplus.viewing.layers import MOSAIC

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    import napari.viewer
    from napari.layers import Layer

TRACK, MARKS, COVERAGE, QUALITY = "track", "track marks", "coverage", "quality"
_ABOVE_IMAGES: Final = (COVERAGE, QUALITY, TRACK, MARKS)
"""From below upwards."""


class OwnLayers:
    """Layers by what they show: the name of a mode, or one of the four above.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        self._viewer = viewer
        self._taken: set[str] = set()
        self._um_per_px: float | None = None

    @property
    def present(self) -> dict[str, Layer]:
        """Layers that are in the viewer."""
        known = ((layer.metadata.get("elsplus"), layer) for layer in self._viewer.layers)
        return {facts[MOSAIC]: layer for facts, layer in known if isinstance(facts, dict) and MOSAIC in facts}

    @property
    def step(self) -> float:
        """Micrometres, or else pixels, that a pixel of the mosaic spans."""
        return self._um_per_px or 1.0

    def begin(self, kinds: Collection[str], um_per_px: float | None) -> None:
        """Show another mosaic from now on: take away what it has not, and use the rest again."""
        self._taken, self._um_per_px = set(), um_per_px
        for kind, layer in self.present.items():
            if kind not in kinds:
                self._viewer.layers.remove(layer)

    def clear(self) -> None:
        """Take them all away."""
        for layer in self.present.values():
            self._viewer.layers.remove(layer)

    def fresh(self, kind: str) -> bool:
        """Whether nothing was taken for this mosaic yet."""
        return kind not in self._taken

    def take(self, kind: str, make: Callable[[], Layer], *, select: bool = False) -> tuple[Layer | None, bool]:
        """Return the layer that shows something, and whether it was made just now; no layer if the user removed it.

        Parameters
        ----------
        kind : str
            What it shows.
        make : callable
            Makes it, where there is none from before.
        select : bool
            Whether a layer that is made becomes the one that is selected.
        """
        layer, fresh = self.present.get(kind), self.fresh(kind)
        self._taken.add(kind)
        made = layer is None and fresh
        if made:
            layer = make()
        if layer is not None and fresh:
            layer.scale = (self.step, self.step)
            layer.units = ("um", "um") if self._um_per_px else ("pixel", "pixel")
            layer.axis_labels = ("row", "col")
        if made:
            self._insert(layer, kind, select)
        return layer, made

    def _insert(self, layer: Layer, kind: str, select: bool) -> None:
        layer.metadata["elsplus"] = {
            "kind": f"{MOSAIC} {kind}",
            MOSAIC: kind,
            "software": f"napari-elsplus {__version__}",
        }
        selected = set(self._viewer.layers.selection)
        above = [other for one, other in self.present.items() if _height(one) > _height(kind)]
        place = min((self._viewer.layers.index(other) for other in above), default=len(self._viewer.layers))
        self._viewer.layers.insert(place, layer)
        self._viewer.layers.selection = {layer} if select else selected
        self._viewer.canvas.overlays.scale_bar.visible = True


def move(layer: Layer, place: tuple[float, float]) -> None:
    """Put a layer somewhere, unless it is there: each move makes napari look at all extents."""
    if tuple(layer.translate) != place:
        layer.translate = place


def _height(kind: str) -> int:
    """Where a layer lies above the images, which are at 0."""
    return 1 + _ABOVE_IMAGES.index(kind) if kind in _ABOVE_IMAGES else 0
