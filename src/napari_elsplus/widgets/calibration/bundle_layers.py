"""Layers of the bundle pair while its result is displayed: its image, and the outlines of both discs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus._view import HiddenLayers, fit_visible_layers, remove_layers
from napari_elsplus.processing.calibration.bundle.pair import BundlePair
from napari_elsplus.processing.calibration.steps import PAIR
from napari_elsplus.viewing.common_axes import plane_axes
from napari_elsplus.viewing.outlines import outline_layer
from napari_elsplus.viewing.provenance import PROVENANCE

if TYPE_CHECKING:
    import napari.viewer
    from napari.layers import Layer

    from napari_elsplus.processing.calibration.draft import Draft
    from napari_elsplus.widgets.calibration.session import ShownResult

IMAGE, OUTLINES = "calibration: bundle", "calibration: outlines"


class BundleLayers:
    """Layers of the displayed bundle pair in the user's viewer; one that the user removes stays away.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer. Its other layers are hidden while a bundle pair is displayed, which fills the canvas.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        self._viewer = viewer
        self._hidden = HiddenLayers(viewer)
        self._pair: BundlePair | None = None
        self._layers: list[Layer] = []

    def show(self, shown: ShownResult | None, draft: Draft) -> None:
        """Add the layers of the bundle pair if it is the displayed result; else remove them. Those of the same remain.

        Parameters
        ----------
        shown : ShownResult or None
            The displayed result.
        draft : Draft
            Results accepted so far.
        """
        pair = shown.found if shown is not None and isinstance(shown.found, BundlePair) else None
        same = pair is self._pair
        if not same:
            remove_layers(self._viewer, [layer for layer in self._layers if layer in self._viewer.layers])
            self._hidden.restore()
            self._pair, self._layers = pair, []
        if shown is None or pair is None:
            return
        accepted = draft if draft.pair is pair else PAIR.accept(draft, pair, shown.setup)
        data, attributes, _ = outline_layer(accepted.calibration, OUTLINES)
        placed, adopted = plane_axes(accepted.calibration.um_per_px, self._viewer.layers)
        if not same:
            self._hidden.hide()
            image = self._viewer.add_image(pair.image, name=IMAGE, **placed)
            self._layers = [image, self._viewer.add_shapes(data, **{**attributes, **placed})]
        rescaled = tuple(self._layers[0].scale) != placed["scale"]
        for layer in self._layers:
            layer.scale, layer.units = placed["scale"], placed["units"]
        self._layers[0].metadata[PROVENANCE] = {"kind": IMAGE, **adopted}
        if rescaled or not same:
            fit_visible_layers(self._viewer)
