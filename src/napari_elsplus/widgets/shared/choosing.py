"""Which layers a panel can work on, and which of their frames is shown."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from napari.layers import Image

from napari_elsplus.acquisition.engine.live_images import RAW
from napari_elsplus.errors import InputError

LIVE: Final = "live"
"""Kind of the layers that show live images, before the kind of the image."""
OPEN_ONE: Final = "open a recording with a calibration, or a sample: File > Open Sample > ELS+ endomicroscopy"
"""What comes first where nothing can be chosen."""

if TYPE_CHECKING:
    import napari.viewer
    from magicgui.widgets import ComboBox


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


def renew_choices(choice: ComboBox) -> None:
    """Offer what there is now; what was chosen stays chosen while it is there, and no change is told."""
    chosen = choice.value
    with choice.changed.blocked():
        choice.reset_choices()
        if chosen in choice.choices:
            choice.value = chosen


def chosen_image(viewer: napari.viewer.Viewer, choice: ComboBox, what: str) -> Image:
    """Return the layer that is chosen.

    Raises
    ------
    InputError
        If there is none; it says what could have been chosen.
    """
    if choice.value is None:
        raise InputError(f"no {what} is open", "open one, or File > Open Sample > ELS+ endomicroscopy")
    layer = viewer.layers[choice.value]
    assert isinstance(layer, Image)
    return layer
