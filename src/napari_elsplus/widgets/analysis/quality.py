"""The Quality panel: alignment before and after the core filter, resolution on a bar target, artefacts at the rim."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from magicgui.widgets import ComboBox, Container, PushButton
from napari.layers import Image, Shapes
from qtpy.QtWidgets import QFileDialog, QLabel, QSizePolicy, QVBoxLayout

from napari_elsplus.errors import CalibrationError
from napari_elsplus.io.formats.registry import PICTURE, TABLE, dialog_filter
from napari_elsplus.processing.analysis.image_quality import PAPER_ALIGNMENT_PERCENT
from napari_elsplus.processing.analysis.resolution import RESOLVED_CONTRAST
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.viewing.lazy import image_planes
from napari_elsplus.viewing.quality import (
    AlignmentErrors,
    EdgeMap,
    Element,
    Resolution,
    measure_alignment,
    measure_edge,
    measure_resolution,
    quality_script,
)
from napari_elsplus.viewing.stack import images_origin_px, space, um_per_px_of
from napari_elsplus.widgets.shared.choosing import (
    OPEN_ONE,
    calibrated_recordings,
    chosen_image,
    renew_choices,
    shown_index,
)
from napari_elsplus.widgets.shared.panel import Panel, allow, button_row, copy_as_script, told
from napari_elsplus.widgets.shared.plots import Curve, ThemedPlot
from napari_elsplus.widgets.shared.shapes import prepare_shapes
from napari_elsplus.widgets.shared.work import Work

if TYPE_CHECKING:
    import napari.viewer

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.viewing.quality import Box
    from napari_elsplus.viewing.stack import Stack

BOXES: Final = "quality elements"
EDGE: Final = "quality edge"
BOX_COLOUR: Final = "#f0e442"
NOT_ALIGNMENT: Final = 0.1
"""Filtered error above which the two views cannot show the same scene: where the laser is on, they never do."""
HINT: Final = (
    "<b>Alignment</b>: show a frame lit from the far end. <b>Mark elements</b>: show a USAF 1951 target, and draw "
    "a box closely around the three bars of each element. <b>Edge map</b>: take a recording of a moving probe."
)


class QualityPanel(Panel):
    """Check an instrument as the paper does.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer; gets a layer for the marked elements and one for the edge map.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer)
        self.alignment: AlignmentErrors | None = None
        self.resolution: Resolution | None = None
        self.edge: EdgeMap | None = None
        self._boxes: Shapes | None = None
        self.work = Work(self._layers_changed)
        self._build()
        self.align.clicked.connect(self.measure_alignment)
        self.mark.clicked.connect(self.mark_elements)
        self.average.clicked.connect(self.measure_edge)
        self.script.clicked.connect(self.copy_script)
        self.save.clicked.connect(self._ask_where_to_save)
        self.cores.changed.connect(self.measure_resolution)
        self.listen(viewer.layers.events.inserted, self._layers_changed)
        self.listen(viewer.layers.events.removed, self._layers_changed)
        self.listen(viewer.events.theme, self._theme_changed)
        self._layers_changed()
        self.show_numbers()

    def measure_alignment(self) -> None:
        """Measure how well the two views of the frame that is shown cancel."""
        with told():
            stack, calibration, frame = self._chosen()
            self.alignment = measure_alignment(stack, calibration, frame, self.cores.value)
            self.show_numbers()

    def mark_elements(self) -> None:
        """Add a layer in which boxes are drawn around the elements of a target; each is measured as it is drawn."""
        with told():
            stack, calibration, _ = self._chosen()
            place = space(_scale(stack, calibration), images_origin_px(calibration))
            self.work.begin(0, prepare_shapes, lambda _: self._draw_boxes(place))
        self._layers_changed()

    def measure_resolution(self) -> None:
        """Measure the marked elements in the LS image of the frame that is shown."""
        boxes = self.boxes_px
        self.resolution = None
        if boxes:
            with told():
                stack, calibration, frame = self._chosen()
                image = image_planes(stack.planes, calibration, Mode.LS, cores=self.cores.value)[frame]
                self.resolution = measure_resolution(image, boxes, _scale(stack, calibration))
        self.show_numbers()

    def measure_edge(self) -> None:
        """Average the residual images of the recording, in a thread of its own."""
        with told():
            stack, calibration, _ = self._chosen()
            place = space(um_per_px_of(stack, calibration), images_origin_px(calibration))
            self.work.begin(
                len(stack.planes),
                lambda: measure_edge(stack, calibration, self.work.watch),
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
        """List what was measured."""
        parts = []
        if self.alignment is not None:
            before, after = self.alignment.before, self.alignment.after
            papers = " and ".join(f"{percent} %" for percent in PAPER_ALIGNMENT_PERCENT)
            parts.append(
                f"<b>Alignment error</b> {100 * before:.2f} %, filtered {100 * after:.2f} % (the paper: {papers})"
            )
            if after > NOT_ALIGNMENT:
                parts.append("So much is more than misalignment: is the bundle lit from its far end, the laser off?")
        if self.resolution is not None:
            parts.append(_table(self.resolution))
        if self.edge is not None:
            top, bottom = (half.min() for half in np.array_split(self.edge.profile, 2))
            parts.append(
                f"<b>Residual at the rim</b> {top:.2f} (top) and {bottom:.2f} (bottom) of that in the middle, "
                f"mean of {self.edge.frames} frames"
            )
        self.numbers.setText("<br>".join(parts) or HINT)
        allow(
            self.save, self.edge is not None, "Save the profile through the edge map as PNG or CSV", "make an edge map"
        )

    def copy_script(self) -> None:
        """Copy Python that makes these checks to the clipboard."""
        with told():
            stack, _, frame = self._chosen()
            source = self.viewer.layers[self.recording.value].metadata["elsplus"]["calibration_path"]
            copy_as_script(quality_script(stack, source, self.cores.value, frame, self.boxes_px))

    def cleanup(self) -> None:
        """Stop measuring and let go of the viewer."""
        self.work.cancel()
        if self._boxes is not None:
            self._boxes.events.data.disconnect(self.measure_resolution)
            self._boxes = None
        super().cleanup()

    def _build(self) -> None:
        self.recording = ComboBox(label="recording", choices=lambda _: calibrated_recordings(self.viewer))
        self.recording.tooltip = "Raw layers with a calibration"
        self.cores = ComboBox(label="core filter", choices=[kind.value for kind in CoreFilter], value="median")
        self.cores.tooltip = "How the honeycomb of the cores is suppressed; alignment is told without it, too"
        names = ("Alignment", "Mark elements", "Edge map", "Copy as script", "Save plot...")
        self.align, self.mark, self.average, self.script, self.save = (PushButton(text=name) for name in names)
        form = Container(widgets=[self.recording, self.cores], labels=True)
        form.margins = (0, 0, 0, 0)
        self.numbers = QLabel()
        self.numbers.setWordWrap(True)
        self.numbers.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)  # it follows the dock
        self.plot = ThemedPlot("row from the centre / µm", "residual / middle", self.viewer.theme)
        self.plot.setMinimumHeight(160)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(6, 6, 6, 6)
        layout.addWidget(form.native)
        layout.addLayout(button_row(self.align, self.mark, self.average))
        layout.addWidget(self.work)
        layout.addWidget(self.numbers)
        layout.addWidget(self.plot, 1)
        layout.addLayout(button_row(self.script, self.save))

    def _chosen(self) -> tuple[Stack, Calibration, int]:
        layer = chosen_image(self.viewer, self.recording, "recording with a calibration")
        known = layer.metadata["elsplus"]
        return known["stack"], known["calibration"], shown_index(self.viewer, layer)

    def _draw_boxes(self, place: dict[str, Any]) -> None:
        if self._boxes is None:
            self._boxes = Shapes(
                name=BOXES, ndim=2, face_color="transparent", edge_color=BOX_COLOUR, edge_width=1, **place
            )
            self._boxes.events.data.connect(self.measure_resolution)
            self.viewer.layers.append(self._boxes)
        self.viewer.layers.selection.active = self._boxes
        self._boxes.mode = "add_rectangle"
        self.show_numbers()

    def _edge_measured(self, edge: EdgeMap, place: dict[str, Any]) -> None:
        self.edge = edge
        curve = Curve("residual", edge.position_um, edge.profile, "green")
        self.plot.draw([curve])
        if EDGE in self.viewer.layers:
            self.viewer.layers.remove(EDGE)
        self.viewer.layers.append(
            Image(
                edge.image.astype(np.float32),
                name=EDGE,
                contrast_limits=(0, 1.2),
                colormap="viridis",
                **place,
            )
        )
        self.show_numbers()

    def _layers_changed(self) -> None:
        if self._boxes is not None and self._boxes not in self.viewer.layers:
            self._boxes, self.resolution = None, None
            self.show_numbers()
        renew_choices(self.recording)
        able = bool(self.recording.choices)
        idle, first = able and not self.work.busy, "wait for the end" if able else OPEN_ONE
        allow(self.align, able, "How well the two views of this frame cancel", OPEN_ONE)
        allow(self.mark, idle, "Draw boxes around the elements of a USAF 1951 target", first)
        allow(self.average, idle, "Average the residual images of the recording", first)
        allow(self.script, able, "Copy Python that makes these checks", OPEN_ONE)

    def _theme_changed(self) -> None:
        self.plot.follow(self.viewer.theme)

    def _ask_where_to_save(self) -> None:
        kinds = dialog_filter(PICTURE, TABLE)
        path, _ = QFileDialog.getSaveFileName(self, "Save the profile", "edge.png", kinds)
        if path:
            with told():
                self.plot.save(Path(path))


def _scale(stack: Stack, calibration: Calibration) -> float:
    um_per_px = um_per_px_of(stack, calibration)
    if um_per_px is None:
        raise CalibrationError("the scale is unknown", "calibrate with --um-per-px or --bundle-um")
    return um_per_px


def _table(found: Resolution) -> str:
    """Write the elements as rich text, the coarsest first, each with the contrasts of its boxes."""
    periods: dict[tuple[float, str], list[Element]] = {}
    for one in found.elements:
        periods.setdefault((-one.line_pair_um, f"{one.group}-{one.element}"), []).append(one)
    rows = ["<tr><td>element</td><td align=right>µm / line pair</td><td align=right>contrast</td></tr>"]
    for (negative_um, name), marked in sorted(periods.items()):
        contrasts = ", ".join(f"{one.contrast:.2f}" for one in marked)
        said = contrasts if all(one.resolved for one in marked) else f"<i>{contrasts}</i>"
        rows.append(f"<tr><td>{name}</td><td align=right>{-negative_um:.2f}</td><td align=right>{said}</td></tr>")
    finest = f"{found.finest_um:.2f} µm" if np.isfinite(found.finest_um) else "none"
    least = f"contrast of at least {RESOLVED_CONTRAST:g} there and at all coarser elements"
    table = f"<table width='100%' cellspacing=2>{''.join(rows)}</table>"
    return f"{table}<b>Smallest resolved line pair</b> {finest} ({least})"
