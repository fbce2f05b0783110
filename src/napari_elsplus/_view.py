"""The view of a viewer while layers are opened: drawn between them, fitted to what is visible, with a scale bar."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from qtpy.QtCore import QEventLoop, QTimer
from qtpy.QtWidgets import QApplication

from napari_elsplus.viewing.common_axes import PIXEL

if TYPE_CHECKING:
    import napari.viewer

FILLED: Final = 0.95
"""Share of the canvas that the layers fill, as with napari's own reset of the view."""
SETTLED_MS: Final = 50
"""Time without another layer after which all are open and laid out, milliseconds; chosen, some turns of the loop."""


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


def fit_first_layers(viewer: napari.viewer.Viewer | None) -> None:
    """Fit the layers that are being opened into the canvas if there are none before, and show the scale bar.

    napari fits the first layer before the controls beside it have narrowed the canvas, and fits hidden raw frames, too.

    Parameters
    ----------
    viewer : napari.Viewer or None
        Displays two dimensions, else its view is left as it is, as it is where a script has set it meanwhile. The scale
        bar is shown where the scale is known.
    """
    if viewer is None or len(viewer.layers):
        return
    opened_with: list[object] = []
    settled = QTimer()
    settled.setSingleShot(True)
    settled.setInterval(SETTLED_MS)
    seen, inserted = weakref.ref(viewer), viewer.layers.events.inserted

    def restart(_: Any) -> None:
        opened_with[:] = _view_of(seen())
        settled.start()

    def fit() -> None:
        inserted.disconnect(restart)
        opened = seen()
        if opened is None or not len(opened.layers) or opened.dims.ndisplay != 2:
            return
        if _view_of(opened) == opened_with:
            fit_visible_layers(opened)
        if all(PIXEL not in map(str, layer.units[-2:]) for layer in opened.layers):
            opened.canvas.overlays.scale_bar.visible = True

    settled.timeout.connect(fit)
    inserted.connect(restart, position="last")  # after napari's own reset of the view


def answer_between_layers(viewer: napari.viewer.Viewer | None, count: int) -> None:
    """Draw the window, and let its timers run, after each of the layers that are being opened.

    napari inserts all layers of a file in one turn of the event loop. Each takes a tenth of a second, and several on a
    busy computer: live images stood still, and the engine took the window for frozen.

    Parameters
    ----------
    viewer : napari.Viewer or None
        Into which they are opened.
    count : int
        Number of layers.
    """
    if viewer is None or QApplication.instance() is None:
        return
    inserted, left = viewer.layers.events.inserted, [count]

    def answer(_: Any) -> None:
        left[0] -= 1
        if left[0] <= 0:
            inserted.disconnect(answer)
        QApplication.processEvents(QEventLoop.ProcessEventsFlag.ExcludeUserInputEvents)

    inserted.connect(answer, position="last")


def _view_of(viewer: napari.viewer.Viewer | None) -> list[object]:
    """Return centre and zoom of a viewer's camera."""
    return [] if viewer is None else [tuple(viewer.scene.camera.center), viewer.scene.camera.zoom]
