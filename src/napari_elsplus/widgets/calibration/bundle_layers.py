"""Layers of the bundle pair while its result is displayed: its image, and the outlines of both discs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.processing.calibration.measurements import BundlePair
from napari_elsplus.processing.calibration.steps import PAIR
from napari_elsplus.viewing.outlines import outline_layer

if TYPE_CHECKING:
    import napari.viewer

    from napari_elsplus.processing.calibration.draft import Draft
    from napari_elsplus.widgets.calibration.session import ShownResult

IMAGE, OUTLINES = "calibration: bundle", "calibration: outlines"
PAIR_KEY = "pair"
"""Of the displayed result in the image's metadata."""


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
    for layer in [] if same else present:
        viewer.layers.remove(layer)
    if shown is None or pair is None:
        return
    accepted = draft if draft.pair is pair else PAIR.accept(draft, pair, shown.setup)
    data, attributes, _ = outline_layer(accepted.calibration, OUTLINES)
    placed = {key: attributes[key] for key in ("scale", "units") if key in attributes}
    if same:
        for layer in present:
            layer.scale, layer.units = placed["scale"], placed["units"]
        return
    viewer.add_image(pair.image, name=IMAGE, metadata={PAIR_KEY: pair}, **placed)
    viewer.add_shapes(data, **attributes)
