"""The view of a viewer in which layers are opened: drawn between them, fitted to what is visible, in two dimensions."""

from __future__ import annotations

import weakref
from concurrent.futures import ThreadPoolExecutor, wait
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import napari
import numpy as np
import pint
from napari.layers import Shapes
from napari.utils.notifications import show_warning
from qtpy.QtCore import QEventLoop, QTimer
from qtpy.QtWidgets import QApplication

from napari_elsplus.viewing.common_axes import PIXEL, adopt_axes, reference_axes, unit_name
from napari_elsplus.viewing.provenance import GIVES_WAY, PROVENANCE, provenance_of
from napari_elsplus.viewing.stack import TIME

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from napari.layers import Layer
    from numpy.typing import NDArray

FILLED: Final = 0.95
"""Share of the canvas that the layers fill, as with napari's own reset of the view."""
SETTLED_MS: Final = 50
"""Time from the last layer until all are laid out, milliseconds; chosen, some turns of the loop."""
ANSWER_S: Final = 0.02
"""Interval at which the window answers while it waits for a thread, seconds; chosen."""
_WATCHED: Final = "elsplus"
TWO_DIMENSIONS: Final = (
    "recordings are displayed in two dimensions: in three, napari would compute all frames at once. To display other "
    "layers in three, hide the recording"
)


def fit_visible_layers(viewer: napari.Viewer, parts: Mapping[Layer, NDArray[np.float64]] | None = None) -> None:
    """Fit the visible layers into the canvas.

    napari's reset of the view fits the hidden ones, too, among them raw frames that are wider than their images.

    Parameters
    ----------
    viewer : napari.Viewer
        Displays two dimensions.
    parts : mapping of Layer to (2, 2) numpy.ndarray, optional
        First and last corner, in the world, of what is fitted of some layers; of the others all.
    """
    fitted = parts or {}
    extents = [fitted.get(layer, layer.extent.world[:, -2:]) for layer in viewer.layers if layer.visible]
    extents = [one for one in extents if np.isfinite(one).all()]  # layers without points have none
    if not extents:
        return
    low, high = np.min(extents, axis=(0, 1)), np.max(extents, axis=(0, 1))
    viewer.scene.camera.center = tuple((low + high) / 2)
    viewer.scene.camera.zoom = FILLED * float((viewer.canvas.size / np.maximum(high - low, 1e-9)).min())


def change_layer(layer: Layer, **values: Any) -> None:
    """Set attributes of a layer to `values` but those that it has: napari draws and lists the layer anew each time."""
    for name, value in values.items():
        wanted = tuple(map(pint.Unit, value)) if name == "units" else value
        present = getattr(layer, name)
        if (tuple(present) if isinstance(value, tuple) else present) != wanted:
            setattr(layer, name, value)


def remove_layers(viewer: napari.Viewer, layers: Sequence[Layer]) -> None:
    """Remove `layers` from a `viewer` at once: napari collects all garbage after each removal, for half a second."""
    if layers:
        with viewer.layers.batched_update():
            for layer in layers:
                viewer.layers.remove(layer)


class HiddenLayers:
    """The user's layers while others are displayed in their place; shown in the same view and selected afterwards.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer.
    """

    def __init__(self, viewer: napari.Viewer) -> None:
        self._viewer = viewer
        self._hidden: list[Layer] = []
        self._selected: set[Layer] = set()
        self._view: tuple[int, Any, float] | None = None

    @property
    def active(self) -> bool:
        """True from :meth:`hide` to :meth:`restore`."""
        return self._view is not None

    def hide(self, ours: Collection[Layer] = ()) -> None:
        """Hide the visible layers but `ours`, besides those that are hidden already, and display two dimensions."""
        dims, camera = self._viewer.dims, self._viewer.scene.camera
        if self._view is None:
            self._view = dims.ndisplay, camera.center, camera.zoom
        dims.ndisplay = 2
        self._selected = set(self._viewer.layers.selection)
        for layer in self._viewer.layers:
            if layer.visible and layer not in ours:
                layer.visible = False
                self._hidden.append(layer)

    def restore(self) -> None:
        """Show those that were hidden, in the view of before, and select what was selected, as far as it is there."""
        hidden, self._hidden = self._hidden, []
        view, self._view = self._view, None
        for layer in self._viewer.layers:
            if layer in hidden:
                layer.visible = True
        if selected := self._selected.intersection(self._viewer.layers):
            self._viewer.layers.selection = selected
        self._selected = set()
        if view is not None:
            self._viewer.dims.ndisplay, *camera = view
            self._viewer.scene.camera.center, self._viewer.scene.camera.zoom = camera


def answer() -> None:
    """Draw the window and run its timers between two layers, each of which takes napari a tenth of a second."""
    QApplication.processEvents(QEventLoop.ProcessEventsFlag.ExcludeUserInputEvents)


def answer_during(work: Callable[[], None]) -> None:
    """Run `work` in a thread; the window is drawn, and runs its timers, until it has ended."""
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(work)
        while QApplication.instance() is not None and not running.done():
            wait([running], ANSWER_S)
            answer()
    running.result()


def read_units() -> None:
    """Read pint's table of units, which napari needs for the first layer and reads for a third of a second.

    Not in a thread: while a registry of units is read, it is wrong for whoever else uses it.
    """
    pint.Unit("pixel")


def prepare_shapes() -> None:
    """Compile the drawing of lines, rectangles and ellipses, outside of the window's thread, after :func:`read_units`.

    napari compiles it when the first shape is made: for 11 s, once on every installation.
    """
    corners = np.array([(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)])
    Shapes([corners[:2], corners, corners], shape_type=["line", "rectangle", "ellipse"])


def open_in_viewer(layers: Sequence[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """Return layers that are being opened with the axes of those in the viewer where their own are unknown, or others.

    Unknown axes are those of calibrated layers, with a warning; a scan beside recordings, or a recording beside a scan,
    is displayed frame by frame. The viewer answers between the layers (:func:`view_opened_layers`).

    Parameters
    ----------
    layers : sequence of tuple
        (data, attributes, type) each.
    """
    viewer = napari.current_viewer()
    if viewer is None:
        return [tuple(layer) for layer in layers]
    view_opened_layers(viewer, layers)
    reference, new, warned = reference_axes(viewer.layers), [], False
    for data, words, kind in layers:
        placed, uncalibrated = adopt_axes(words, reference)
        if uncalibrated and not warned:
            warned = True
            show_warning(
                f"{words['name']} has no calibration: it is displayed with the pixel size and frame rate of the other "
                "layers, and not measured in micrometres or seconds"
            )
        new.append((data, placed, kind))
    if reference is None:
        _adopt_later(viewer, layers)
    return new


def _adopt_later(viewer: napari.Viewer, layers: Sequence[tuple[Any, ...]]) -> None:
    """Give layers without a calibration that are open already the axes of calibrated layers that are being opened."""
    steps = next((words for _, words, _ in layers if len(words["units"]) == 3 and PIXEL not in words["units"]), None)
    if steps is None:
        return
    reference = tuple(steps["scale"]), tuple(map(unit_name, steps["units"]))
    for layer in viewer.layers:
        if layer.ndim != 3 or PROVENANCE not in layer.metadata:
            continue
        words = {name: getattr(layer, name) for name in ("scale", "translate", "units", "metadata")}
        placed, _ = adopt_axes(words, reference)
        if placed is not words:
            for name, value in placed.items():
                setattr(layer, name, value)


def view_opened_layers(viewer: napari.Viewer, layers: Sequence[tuple[Any, ...]]) -> None:
    """Answer between the layers that are being opened; display the first frame of those in a viewer that had none.

    napari inserts all layers of a file in one turn of the event loop. Each takes a tenth of a second, and several on a
    busy computer: live images stood still, and the engine took the window for frozen. So the window is drawn, and its
    timers run, after each of them. napari fits the first one before the controls beside it have narrowed the canvas,
    and fits hidden raw frames, too; it displays the middle frame, where an axial scan is dark, and whose grey levels
    are not those that the contrast is set by.

    Images that lie side by side under titles, those of a sample and live ones, are hidden: what is opened would lie
    over one of them, under its title.

    Parameters
    ----------
    viewer : napari.Viewer
        Into which they are opened. From then on the depth of a visible axial scan is written on its canvas, and
        recordings stay in two dimensions. Its view is left as it is where it displays three, or a script has set it
        meanwhile. The scale bar is shown where the scale is known.
    layers : sequence of tuple
        (data, attributes, type) each. Two dimensions are displayed if the first axis of one is time.
    """
    if QApplication.instance() is None:
        return
    opened, inserted, left = weakref.ref(viewer), viewer.layers.events.inserted, [len(layers)]
    first = not len(viewer.layers)
    _watch(viewer)
    if any(TIME in words["axis_labels"] for _, words, _ in layers):
        viewer.dims.ndisplay = 2
    fits = _hide_side_by_side(viewer) or first

    def answer_to(_: Any) -> None:
        here = opened()
        if first and here is not None and left[0] == len(layers):
            for axis in here.dims.not_displayed:
                here.dims.set_current_step(axis, 0)
        left[0] -= 1
        if left[0] <= 0:
            inserted.disconnect(answer_to)
        answer()
        if left[0] <= 0 and fits:
            QTimer.singleShot(SETTLED_MS, partial(_fit_unless_moved, opened, _view_of(opened())))

    inserted.connect(answer_to, position="last")  # after napari's own reset of the view


def _fit_unless_moved(opened: weakref.ref[napari.Viewer], view: list[object]) -> None:
    viewer = opened()
    if viewer is None or not len(viewer.layers) or viewer.dims.ndisplay != 2:
        return
    if _view_of(viewer) == view:
        fit_visible_layers(viewer)
    if all(PIXEL not in map(str, layer.units[-2:]) for layer in viewer.layers):
        viewer.canvas.overlays.scale_bar.visible = True


def _view_of(viewer: napari.Viewer | None) -> list[object]:
    """Return centre and zoom of a viewer's camera."""
    return [] if viewer is None else [tuple(viewer.scene.camera.center), viewer.scene.camera.zoom]


def _hide_side_by_side(viewer: napari.Viewer) -> bool:
    """Hide layers that give way to what is opened, and return True if any was visible."""
    covered = [layer for layer in viewer.layers if layer.visible and provenance_of(layer.metadata).get(GIVES_WAY)]
    for layer in covered:
        layer.visible = False
    return bool(covered)


def _watch(viewer: napari.Viewer) -> None:
    """Keep the time of recordings on the slider of a viewer, and the depth of a scan on its canvas; once per viewer."""
    dims, layers = viewer.dims.events, viewer.layers.events
    if any(getattr(callback, "keywords", {}).get("name") == _WATCHED for callback in dims.point.callbacks):
        return
    for emitter in (dims.point, layers.inserted, layers.removed):
        emitter.connect(partial(_show_depth, viewer, name=_WATCHED))
    camera = dims.ndisplay.callbacks[:1]  # of napari; the next ones compute what is displayed, plugins come last
    dims.ndisplay.connect(partial(_keep_two_dimensions, viewer), position="first", after=list(camera))


def _keep_two_dimensions(viewer: napari.Viewer, event: Any) -> None:
    ours = [layer for layer in viewer.layers if layer.visible and PROVENANCE in layer.metadata]
    if viewer.dims.ndisplay > 2 and any(layer.axis_labels[0] == TIME for layer in ours):
        event.blocked = True  # those that follow are called for what is set here
        viewer.dims.ndisplay = 2
        show_warning(TWO_DIMENSIONS)


def _show_depth(viewer: napari.Viewer, _event: Any = None, *, name: str) -> None:
    """Write the depth of a visible axial scan on the canvas, in micrometres."""
    overlay, text = viewer.canvas.overlays.text, ""
    for layer in viewer.layers:
        stack = provenance_of(layer.metadata).get("stack")
        if layer.visible and stack is not None and stack.depth_um is not None and layer.ndim == 3:
            plane = round((viewer.dims.point[0] - layer.translate[0]) / layer.scale[0])
            text = f"depth {stack.depth_um[min(max(plane, 0), len(stack.depth_um) - 1)]:.1f} µm"
    if text or overlay.text.startswith("depth "):
        overlay.text, overlay.visible = text, bool(text)
