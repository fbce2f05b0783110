"""Which layers a panel can work on, and which of their frames is shown."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.acquisition.live_images import RAW
from napari_elsplus.widgets.live_layers import LIVE

if TYPE_CHECKING:
    import napari.viewer
    from napari.layers import Image


def calibrated_recordings(viewer: napari.viewer.Viewer) -> list[str]:
    """Return the names of the raw layers that have a calibration."""
    known = {layer.name: layer.metadata.get("elsplus", {}) for layer in viewer.layers}
    return [name for name, facts in known.items() if facts.get("kind") == "raw" and facts.get("calibration")]


def calibrated_frames(viewer: napari.viewer.Viewer) -> list[str]:
    """Return the names of the layers of raw frames that have a calibration: recordings, and the live frame."""
    kinds = {layer.name: layer.metadata.get("elsplus", {}) for layer in viewer.layers}
    live = [name for name, facts in kinds.items() if facts.get("kind") == f"{LIVE} {RAW}" and facts.get("calibration")]
    return [*calibrated_recordings(viewer), *live]


def shown_index(viewer: napari.viewer.Viewer, layer: Image) -> int:
    """Return which plane of a layer (T, rows, cols) the slider is at; the nearest one where it is beside the layer."""
    steps = (viewer.dims.point[0] - layer.translate[0]) / layer.scale[0]
    return int(np.clip(round(steps), 0, layer.data.shape[0] - 1))
