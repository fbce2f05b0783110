"""The bundle pair in the viewer, while it is looked at: its image, with both discs outlined."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.processing.calibration.draft import LitPair, Step
from napari_elsplus.viewing.outlines import outline_layer

if TYPE_CHECKING:
    import napari.viewer

    from napari_elsplus.processing.calibration.draft import Draft
    from napari_elsplus.widgets.calibration.session import ShownResult

IMAGE, OUTLINES = "calibration: bundle", "calibration: outlines"


def show_bundle(viewer: napari.viewer.Viewer, shown: ShownResult | None, draft: Draft) -> None:
    """Show the pair if that is what is looked at; else take its layers away.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer.
    shown : ShownResult or None
        What is looked at.
    draft : Draft
        What was accepted so far.
    """
    for name in (IMAGE, OUTLINES):
        if name in viewer.layers:
            viewer.layers.remove(name)
    if shown is None or not isinstance(shown.found, LitPair):
        return
    lit = shown.found
    accepted = draft if draft.found.get(Step.PAIR) is lit else draft.take(lit, shown.setup)
    data, attributes, _ = outline_layer(accepted.calibration, OUTLINES)
    placed = {key: attributes[key] for key in ("scale", "units") if key in attributes}
    viewer.add_image(lit.image, name=IMAGE, **placed)
    viewer.add_shapes(data, **attributes)
