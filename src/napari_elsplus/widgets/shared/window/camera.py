"""The camera of the window, fitted to what is displayed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    import napari.viewer

FILLED: Final = 0.95
"""Share of the canvas that the layers fill, as with napari's own reset of the view."""


def fit_visible_layers(viewer: napari.viewer.Viewer) -> None:
    """Fit the visible layers into the canvas.

    napari's reset of the view fits the hidden ones, too, among them raw frames that are wider than their images.

    Parameters
    ----------
    viewer : napari.Viewer
        Displays two dimensions.
    """
    extents = [layer.extent.world[:, -2:] for layer in viewer.layers if layer.visible]
    extents = [one for one in extents if np.isfinite(one).all()]  # layers without points have none
    if not extents:
        return
    low, high = np.min(extents, axis=(0, 1)), np.max(extents, axis=(0, 1))
    viewer.scene.camera.center = tuple((low + high) / 2)
    viewer.scene.camera.zoom = FILLED * float((viewer.canvas.size / np.maximum(high - low, 1e-9)).min())
