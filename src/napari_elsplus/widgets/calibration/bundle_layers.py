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


def show_bundle(viewer: napari.viewer.Viewer, shown: ShownResult | None, draft: Draft) -> None:
    """Add the layers of the bundle pair if it is the displayed result; else remove them.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer.
    shown : ShownResult or None
        The displayed result.
    draft : Draft
        Results accepted so far.
    """
    for name in (IMAGE, OUTLINES):
        if name in viewer.layers:
            viewer.layers.remove(name)
    if shown is None or not isinstance(shown.found, BundlePair):
        return
    pair = shown.found
    accepted = draft if draft.pair is pair else PAIR.accept(draft, pair, shown.setup)
    data, attributes, _ = outline_layer(accepted.calibration, OUTLINES)
    placed = {key: attributes[key] for key in ("scale", "units") if key in attributes}
    viewer.add_image(pair.image, name=IMAGE, **placed)
    viewer.add_shapes(data, **attributes)
