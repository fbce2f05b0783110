"""Have napari search for garbage only among what is made from now on.

After each layer that is removed, napari collects all garbage: 0.34 s of processor time where half a million objects
are searched, most of them of imported libraries; 0.03 s where these are left out.
"""

from __future__ import annotations

import gc
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

from napari_elsplus.viewing.provenance import GIVES_WAY, provenance_of

if TYPE_CHECKING:
    import napari.viewer
    from napari.layers import Layer


def leave_out_present_objects(viewer: napari.viewer.Viewer) -> None:
    """Leave out what exists, until ``gc.unfreeze``.

    Parameters
    ----------
    viewer : napari.Viewer
        If one of its present layers is removed that may hold a file or large data, all is searched again.
    """
    before = WeakSet(layer for layer in viewer.layers if not _is_simulated(layer))

    def search_all(event: Any) -> None:
        if event.value in before:
            gc.unfreeze()

    viewer.layers.events.removed.connect(search_all, position="first")  # before napari collects
    gc.freeze()


def _is_simulated(layer: Layer) -> bool:
    """Return True for a layer of a sample or of live images, which holds neither a file nor large data."""
    facts = provenance_of(layer.metadata)
    stack = facts.get("stack")
    return GIVES_WAY in facts if stack is None else stack.recording is None
