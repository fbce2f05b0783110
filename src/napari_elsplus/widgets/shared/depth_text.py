"""The depth of the displayed plane, as text on the canvas: napari's slider counts planes."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.widgets.shared.choosing import shown_index

if TYPE_CHECKING:
    import napari

_CONNECTED: Final = "elsplus depth text"


def show_depth(viewer: napari.Viewer) -> None:
    """Display the depth in micrometres on the canvas of a viewer while an axial scan is visible; once per viewer."""
    if any(
        getattr(callback, "keywords", {}).get("name") == _CONNECTED for callback in viewer.dims.events.point.callbacks
    ):
        return
    update = partial(_update, viewer, name=_CONNECTED)
    for emitter in (viewer.dims.events.point, viewer.layers.events.inserted, viewer.layers.events.removed):
        emitter.connect(update)


def _update(viewer: napari.Viewer, _event: Any = None, *, name: str) -> None:
    overlay, text = viewer.canvas.overlays.text, ""
    for layer in viewer.layers:
        stack = layer.metadata.get("elsplus", {}).get("stack")
        if layer.visible and stack is not None and stack.depth_um is not None and layer.ndim == 3:
            text = f"depth {stack.depth_um[shown_index(viewer, layer)]:.1f} µm"
    if text or overlay.text.startswith("depth "):
        overlay.text, overlay.visible = text, bool(text)
