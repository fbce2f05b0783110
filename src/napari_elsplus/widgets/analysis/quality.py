"""The Quality panel: alignment error with and without the core filter, USAF resolution, artefact at the rim."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from magicgui.widgets import ComboBox
from napari.layers import Image, Shapes
from qtpy.QtWidgets import QSizePolicy

from napari_elsplus._problems import notify_errors
from napari_elsplus._view import prepare_shapes
from napari_elsplus.errors import CalibrationError
from napari_elsplus.io.formats.registry import PICTURE, TABLE
from napari_elsplus.processing.analysis.resolution import RESOLVED_CONTRAST
from napari_elsplus.processing.calibration.bundle.cancellation import PAPER_TEXT
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.viewing.layers import SMOOTH
from napari_elsplus.viewing.lazy import image_planes
from napari_elsplus.viewing.quality import (
    EdgeMap,
    Element,
    Resolution,
    measure_alignment,
    measure_edge,
    measure_resolution,
    quality_script,
)
from napari_elsplus.viewing.stack import images_origin_px, space, um_per_px_of
from napari_elsplus.widgets.analysis.panel import AnalysisPanel
from napari_elsplus.widgets.shared.choosing import (
    LayerChoice,
    calibrated_recordings,
    chosen_recording,
    shown_index,
)
from napari_elsplus.widgets.shared.panel import (
    button_row,
    copy_as_script,
    form_layout,
    next_hint,
    panel_layout,
    pin_below,
    push_button,
    set_enabled,
)
from napari_elsplus.widgets.shared.plots import Curve

if TYPE_CHECKING:
    import napari.viewer
    from napari.layers import Layer

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.bundle.cancellation import AlignmentErrors
    from napari_elsplus.viewing.quality import Box
    from napari_elsplus.viewing.stack import Stack

BOXES: Final = "quality elements"
EDGE: Final = "edge map: residual / central level"
"""Name of its layer, displayed on the canvas: what the colour bar counts."""
BOX_COLOUR: Final = "#f0e442"
NOT_ALIGNMENT: Final = 0.1
"""Filtered alignment error above which the views do not show one scene (laser on); chosen, ten times the paper's."""
HINT: Final = (
    "one of three. <b>Alignment</b>: display a frame lit from the distal end. <b>Measure USAF resolution</b>: display "
    "a USAF 1951 target, and draw a box closely around the three bars of each element. <b>Edge map</b>: select a "
    "recording of a moving probe."
)
DRAW: Final = "draw a box closely around the three bars of each element; the contrast is that of the LS image."


class QualityPanel(AnalysisPanel):
    """Measure the image quality of an instrument as the paper does.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer; a layer for the marked elements and one for the edge map are added to it.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer, "row from the centre / µm", "residual / central level")
        self.alignment: AlignmentErrors | None = None
        self.resolution: Resolution | None = None
        self.edge: EdgeMap | None = None
        self._boxes: Shapes | None = None
        self._aligned_frame = 0
        self._measured: Layer | None = None
        self._averaging = False
        self._build()
        self.cores.changed.connect(self.measure_resolution)
        self.recording.changed.connect(self._recording_changed)
        self._layers_changed()

    def measure_alignment(self) -> None:
        """Measure the alignment error of the displayed frame."""
        with notify_errors(self):
            stack, calibration, frame = self._chosen()
            self.alignment = None
            self._aligned_frame = frame
            self.alignment = measure_alignment(stack, calibration, frame)
        self.show_numbers()

    def mark_elements(self) -> None:
        """Add a layer for boxes around the elements of a USAF target; each is measured when it is drawn."""
        with notify_errors(self):
            stack, calibration, _ = self._chosen()
            _scale(stack, calibration)  # refused here, not after the first box
            self.work.begin(0, prepare_shapes, lambda _: self._draw_boxes())
        self._layers_changed()

    def measure_resolution(self) -> None:
        """Measure the marked elements in the LS image of the displayed frame."""
        boxes = self.boxes_px
        self.resolution = None
        if boxes:
            with notify_errors(self):
                stack, calibration, frame = self._chosen()
                image = image_planes(stack.planes, calibration, Mode.LS, cores=self.cores.value)[frame]
                self.resolution = measure_resolution(image, boxes, _scale(stack, calibration))
        self.show_numbers()

    def measure_edge(self) -> None:
        """Average the residual images of the recording in a thread; ended if another recording is selected."""
        with notify_errors(self):
            stack, calibration, _ = self._chosen()
            place = self._place()
            self._averaging = True
            self.work.begin(
                len(stack.planes),
                lambda: measure_edge(stack, calibration, self.work.progress),
                lambda edge: self._edge_measured(edge, place),
            )
            self._layers_changed()

    @property
    def boxes_px(self) -> list[Box]:
        """Edges (top, left, bottom, right) of the marked elements, in pixels of the images."""
        if self._boxes is None:
            return []
        corners = [np.asarray(box)[:, -2:] for box in self._boxes.data]
        return [(*box.min(0).tolist(), *box.max(0).tolist()) for box in corners]

    def show_numbers(self) -> None:
        """Show the results."""
        parts = []
        if self.alignment is not None:
            of = f"{self.recording.value}, frame {self._aligned_frame}"
            parts.append(f"<b>Alignment error</b> of {of}: {self.alignment.text}")
            if self.alignment.after > NOT_ALIGNMENT:
                parts.append(
                    "More than misalignment can explain: is the bundle lit from its distal end, and the laser off?"
                )
            else:
                parts.append(f"({PAPER_TEXT})")
        if self.resolution is not None:
            parts.append(_table(self.resolution))
        if self.edge is not None:
            top, bottom = (half.min() for half in np.array_split(self.edge.profile, 2))
            parts.append(
                f"<b>Residual at the rim</b> {top:.2f} (top) and {bottom:.2f} (bottom) of the central level, "
                f"mean of {self.edge.frames} frames"
            )
        if self._boxes is not None and not self.boxes_px:
            parts.append(next_hint(DRAW))
        hint = next_hint(HINT if self.recording.choices else self.recording.remedy)
        self.numbers.setText("<br>".join(parts) or hint)
        set_enabled(
            self.save, self.edge is not None, "Save the profile through the edge map as PNG or CSV", "make an edge map"
        )

    def copy_script(self) -> None:
        """Copy a script that makes these measurements to the clipboard."""
        with notify_errors(self):
            stack, _, frame = self._chosen()
            source = chosen_recording(self.recording).calibration_path
            copy_as_script(quality_script(stack, source, self.cores.value, frame, self.boxes_px))

    def cleanup(self) -> None:
        """Cancel the measurement and disconnect from the viewer."""
        if self._boxes is not None:
            self._boxes.events.data.disconnect(self.measure_resolution)
            self._boxes = None
        super().cleanup()

    def _build(self) -> None:
        self.recording = LayerChoice(self.viewer, calibrated_recordings, "recording", "Raw layers with a calibration")
        self.cores = ComboBox(label="core filter", choices=[kind.value for kind in CoreFilter], value="median")
        self.cores.tooltip = "Suppression of the core pattern (honeycomb) where the resolution is measured"
        self.align = push_button("Alignment", self.measure_alignment)
        self.mark = push_button("Measure USAF resolution", self.mark_elements)
        self.average = push_button("Edge map", self.measure_edge)
        self.save = self.save_button("Save plot...", "Save the profile", "edge.png", PICTURE, TABLE)
        self.numbers.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)  # it follows the dock
        layout = panel_layout(self)
        layout.addLayout(form_layout(self.recording, self.cores))
        layout.addLayout(button_row(self.align, self.mark, self.average))
        layout.addWidget(self.work)
        layout.addWidget(self.numbers)
        layout.addWidget(self.plot, 1)
        pin_below(self, button_row(self.script, self.save))

    def _chosen(self) -> tuple[Stack, Calibration, int]:
        layer, stack, calibration, _ = chosen_recording(self.recording)
        return stack, calibration, shown_index(self.viewer, layer)

    def _place(self) -> dict[str, Any]:
        """Return scale, translation and units of the selected recording's images, as layer attributes."""
        stack, calibration, _ = self._chosen()
        return space(um_per_px_of(stack, calibration), images_origin_px(calibration))

    def _draw_boxes(self) -> None:
        with notify_errors(self):
            place = self._place()
            if self._boxes is None:
                self._boxes = Shapes(
                    name=BOXES, ndim=2, face_color="transparent", edge_color=BOX_COLOUR, edge_width=1, **place
                )
                self._boxes.events.data.connect(self.measure_resolution)
                self.viewer.layers.append(self._boxes)
            self.viewer.layers.selection.active = self._boxes
            self._boxes.mode = "add_rectangle"
        self.show_numbers()

    def _move_boxes(self) -> None:
        """Place the boxes on the same pixels of the selected recording's images."""
        if self._boxes is not None and self.recording.value is not None:
            with notify_errors(self):
                for name, value in self._place().items():
                    setattr(self._boxes, name, value)

    def _edge_measured(self, edge: EdgeMap, place: dict[str, Any]) -> None:
        self.edge = edge
        curve = Curve("residual", edge.position_um, edge.profile, "green")
        self.plot.draw([curve])
        if EDGE in self.viewer.layers:
            self.viewer.layers.remove(EDGE)
        image = edge.image.astype(np.float32)
        layer = Image(image, name=EDGE, contrast_limits=(0, 1.2), colormap="viridis", interpolation2d=SMOOTH, **place)
        layer.colorbar.visible = layer.name_overlay.visible = True
        self.viewer.layers.append(layer)
        self.show_numbers()

    def _layers_changed(self) -> None:
        if self._boxes is not None and self._boxes not in self.viewer.layers:
            self._boxes, self.resolution = None, None
            self.show_numbers()
        self.recording.refresh(newest=not self.work.busy and self._boxes is None and self.edge is None)
        if self.recording.value is None:
            self.alignment = None
        self._recording_changed()
        available = bool(self.recording.choices)
        idle, first = (
            available and not self.work.busy,
            "wait until the measurement ends" if available else self.recording.remedy,
        )
        set_enabled(
            self.align, available, "Measure the mean difference of the two views of this frame", self.recording.remedy
        )
        set_enabled(
            self.mark, idle, "Draw boxes around the elements of a USAF 1951 target, to measure their contrast", first
        )
        set_enabled(self.average, idle, "Average the residual images of the recording", first)
        set_enabled(self.script, available, "Copy a Python script that makes these measurements", self.recording.remedy)
        self.show_numbers()

    def _work_ended(self) -> None:
        self._averaging = False
        super()._work_ended()

    def _recording_changed(self) -> None:
        """Measure again what is displayed; an edge map, also one that is being made, is of the recording before."""
        if self.recording.layer == self._measured:
            return
        self._measured = self.recording.layer
        if self._averaging:
            self.work.cancel()
        self._move_boxes()
        if self.edge is not None:
            self.edge = None
            self.plot.draw([])
        if self.alignment is not None and self.recording.value is not None:
            self.measure_alignment()
        self.measure_resolution()


def _scale(stack: Stack, calibration: Calibration) -> float:
    um_per_px = um_per_px_of(stack, calibration)
    if um_per_px is None:
        raise CalibrationError("the scale is unknown", "calibrate with --um-per-px or --bundle-um")
    return um_per_px


def _table(found: Resolution) -> str:
    """Return the elements as rich text, coarsest first, each with the contrasts of its boxes."""
    periods: dict[tuple[float, str], list[Element]] = {}
    for one in found.elements:
        periods.setdefault((-one.line_pair_um, f"{one.group}-{one.element}"), []).append(one)
    rows = ["<tr><td>element</td><td align=right>µm / line pair</td><td align=right>contrast</td></tr>"]
    for (negative_um, name), marked in sorted(periods.items()):
        contrasts = ", ".join(f"{one.contrast:.2f}" for one in marked)
        cell = contrasts if all(one.resolved for one in marked) else f"<i>{contrasts}</i>"
        rows.append(f"<tr><td>{name}</td><td align=right>{-negative_um:.2f}</td><td align=right>{cell}</td></tr>")
    finest = f"{found.finest_um:.2f} µm" if np.isfinite(found.finest_um) else "none"
    criterion = f"contrast of at least {RESOLVED_CONTRAST:g} there and at all coarser elements"
    table = f"<table width='100%' cellspacing=2>{''.join(rows)}</table>"
    return f"{table}<b>Smallest resolved line pair</b> {finest} ({criterion})"
