"""Layers of the bundle pair while its result is displayed: its image, and the outlines of both discs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus._view import remove_layers
from napari_elsplus.processing.calibration.bundle.pair import BundlePair
from napari_elsplus.processing.calibration.steps import PAIR
from napari_elsplus.viewing.common_axes import plane_axes
from napari_elsplus.viewing.outlines import outline_layer
from napari_elsplus.viewing.provenance import PROVENANCE

if TYPE_CHECKING:
    from collections.abc import Sequence

    import napari.viewer
    from napari.layers import Layer

    from napari_elsplus.processing.calibration.draft import Draft
    from napari_elsplus.widgets.calibration.session import ShownResult

IMAGE, OUTLINES = "calibration: bundle", "calibration: outlines"
PAIR_KEY, COVERED_KEY, SELECTED_KEY = "pair", "covered", "selected"
"""Of the displayed result, of the layers that it hides, and of those that were selected, in the image's metadata."""


def show_bundle(viewer: napari.viewer.Viewer, shown: ShownResult | None, draft: Draft) -> None:
    """Add the layers of the bundle pair if it is the displayed result; else remove them. Those of the same pair remain.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer.
    shown : ShownResult or None
        The displayed result.
    draft : Draft
        Results accepted so far.
    """
    pair = shown.found if shown is not None and isinstance(shown.found, BundlePair) else None
    present = [viewer.layers[name] for name in (IMAGE, OUTLINES) if name in viewer.layers]
    same = pair is not None and len(present) == len((IMAGE, OUTLINES)) and present[0].metadata.get(PAIR_KEY) is pair
    if not same:
        _remove(viewer, present)
    if shown is None or pair is None:
        return
    accepted = draft if draft.pair is pair else PAIR.accept(draft, pair, shown.setup)
    data, attributes, _ = outline_layer(accepted.calibration, OUTLINES)
    placed, adopted = plane_axes(accepted.calibration.um_per_px, viewer.layers)
    facts = {"kind": IMAGE, **adopted}
    if same:
        present[0].metadata[PROVENANCE] = facts
        for layer in present:
            layer.scale, layer.units = placed["scale"], placed["units"]
        return
    covered = [layer for layer in viewer.layers if layer.visible]
    for layer in covered:
        layer.visible = False
    selected = set(viewer.layers.selection)
    metadata = {PAIR_KEY: pair, COVERED_KEY: covered, SELECTED_KEY: selected, PROVENANCE: facts}
    viewer.add_image(pair.image, name=IMAGE, metadata=metadata, **placed)
    viewer.add_shapes(data, **{**attributes, **placed})


def _remove(viewer: napari.viewer.Viewer, layers: Sequence[Layer]) -> None:
    """Remove our layers, and show and select those again that were visible and selected before."""
    for layer in layers:
        for covered in layer.metadata.get(COVERED_KEY, ()):
            covered.visible = True
    remove_layers(viewer, layers)
    if layers and not viewer.layers.selection:
        selected = {layer for one in layers for layer in one.metadata.get(SELECTED_KEY, ())}
        viewer.layers.selection = selected.intersection(viewer.layers)
