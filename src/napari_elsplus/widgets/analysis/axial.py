"""The Axial response panel: drop-offs of LS and ELS+ from one axial scan or several."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from magicgui.widgets import ComboBox, FloatSpinBox

from napari_elsplus._problems import notify_errors
from napari_elsplus.errors import InputError
from napari_elsplus.io import write_json
from napari_elsplus.io.formats.registry import AXIAL_RESPONSES, PICTURE, TABLE
from napari_elsplus.viewing.axial import (
    MANUAL_SCAN,
    ManualScan,
    Scan,
    SlitParameter,
    axial_script,
    drop_offs,
    measure_scan,
    simulated_scan,
)
from napari_elsplus.viewing.provenance import provenance_of
from napari_elsplus.widgets.analysis.axial_plots import drop_off_curves, response_curves, table
from napari_elsplus.widgets.analysis.panel import AnalysisPanel
from napari_elsplus.widgets.shared.choosing import (
    LayerChoice,
    calibrated_frames,
    calibrated_recordings,
    chosen_image,
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
from napari_elsplus.widgets.shared.window import closing

if TYPE_CHECKING:
    import napari.viewer
    from napari.layers import Image

STACK, MANUAL, SIMULATED = "axial stack", "manual steps", "simulated instrument"
OPEN_SCAN: Final = "open a scan with NAME.depths.csv and a calibration beside it, or the sample axial scan"
WAIT: Final = "wait until the present scan is measured"
CURVES: Final = "signal and depth"
MANY: Final = "several scans give drop-offs against slit offset or width."
MIN_DEPTHS: Final = 3
"""Of a manual scan; a response has that many."""


class AxialResponsePanel(AnalysisPanel):
    """Measure the axial response: from a stack, by manual steps of a stage, or of the simulated instrument.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer; its layers are only read.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer, "distance / µm", "signal")
        self.scans: list[Scan] = []
        self._manual, self._saved = ManualScan(), True
        self._build()
        self.source.changed.connect(self._source_changed)
        self.shown.changed.connect(self.show_scans)
        self._source_changed()
        self.show_scans()

    def measure_stack(self) -> None:
        """Measure the selected axial stack in a thread."""
        with notify_errors(self):
            _, stack, calibration, _ = chosen_recording(self.stack, "axial stack")
            self._start(len(stack.planes), lambda: measure_scan(stack, calibration, progress=self.work.progress))

    def measure_simulated(self) -> None:
        """Simulate a scan with the given offset and slit width, and measure it in a thread."""
        offset_um, slit_um = self.offset.value, self.slit.value
        with notify_errors(self):
            stack, calibration = simulated_scan(offset_um, slit_um)
            self._start(len(stack.planes), lambda: measure_scan(stack, calibration, progress=self.work.progress))

    def take_frame(self) -> None:
        """Add the displayed frame at the given depth, and advance the depth by a step."""
        with notify_errors(self):
            layer = chosen_image(self.live, "recording with a calibration")
            calibration = provenance_of(layer.metadata)["calibration"]
            self._manual.take(self._frame(layer), calibration, self.depth_now.value)
            self._saved = False
            self.depth_now.value += self.depth_step.value
            if self._depths >= MIN_DEPTHS:
                scan = self._manual.scan(calibration)
                self.scans = [one for one in self.scans if not one.name.startswith(MANUAL_SCAN)] + [scan]
            self.show_scans()

    def unsaved(self) -> str:
        """Return a question if a manual scan was not saved, which cannot be made again; else an empty string."""
        return "" if self._saved else "The manual scan was not saved. Discard it?"

    def clear_scans(self) -> None:
        """Discard all scans; an unsaved manual one only if the user agrees."""
        if not closing.may_discard(self, self.unsaved()):
            return
        self.scans.clear()
        self._manual, self._saved = ManualScan(), True
        self.show_scans()

    def show_scans(self) -> None:
        """Plot the scans, the last one in full, or their drop-offs against the slit; list the drop-offs."""
        self._show_numbers()
        saves = "Save the plot as PNG, its numbers as CSV, or the scans as JSON"
        set_enabled(self.save, bool(self.scans), saves, "measure a scan")
        set_enabled(self.clear, bool(self.scans), "Discard all scans", "measure a scan")
        if not self.scans:
            self.plot.draw([])
        elif self.shown.value == CURVES:
            curves, marks = response_curves(self.scans)
            self.plot.draw(curves, marks=marks, bottom="distance from contact / µm", left="signal / signal in contact")
        else:
            self.plot.draw([])
            with notify_errors(self):
                against = SlitParameter(self.shown.value)
                curves = drop_off_curves(drop_offs(self.scans, against))
                self.plot.draw(curves, bottom=f"{against.value} / µm", left="ELS+ drop-off / µm")

    def save_to(self, path: str | Path) -> None:
        """Save the scans or the plot.

        Parameters
        ----------
        path : path-like
            ``NAME.json`` for the scans, ``NAME.png`` or ``NAME.csv`` for the plot.

        Raises
        ------
        InputError
            If nothing was measured.
        """
        path = Path(path)
        if path.suffix.lower() != ".json":
            super().save_to(path)
            return  # what is plotted may be another scan, and leaves out how it was measured
        if not self.scans:
            raise InputError("there is no scan to save", "measure one first")
        one = len(self.scans) == 1
        content = self.scans[0].content() if one else {"scans": [scan.content() for scan in self.scans]}
        write_json(path, content, indent=1, allow_nan=False, force=True)
        self._saved = True

    def copy_script(self) -> None:
        """Copy a script that measures the selected stack to the clipboard."""
        with notify_errors(self):
            source = chosen_recording(self.stack, "axial stack")
            copy_as_script(axial_script(source.stack, source.calibration_path))

    def _build(self) -> None:
        self.source = ComboBox(label="scan", choices=[STACK, MANUAL, SIMULATED])
        self.source.tooltip = "Frames at known depths; live frames at manually set depths; or the simulated instrument"
        self.stack = LayerChoice(self.viewer, _axial_stacks, "stack", "Raw layers with depths and a calibration")
        tip = "Raw layers with a calibration, live or recorded"
        self.live = LayerChoice(self.viewer, calibrated_frames, "frames from", tip)
        self.depth_now = FloatSpinBox(label="depth (µm)", value=0, min=-10_000, max=10_000)
        self.depth_now.tooltip = "Present depth of the plate, -10 000 to 10 000 µm"
        self.depth_step = FloatSpinBox(label="step (µm)", value=5, min=-1000, max=1000)
        self.depth_step.tooltip = "Added to the depth after each frame, -1000 to 1000 µm"
        self.offset = FloatSpinBox(label="offset (µm)", value=29, min=3, max=100, step=1)
        self.offset.tooltip = "Distance of the residual slit from the laser line at the bundle, 3 to 100 µm"
        self.slit = FloatSpinBox(label="slit (µm)", value=2.9, min=0.9, max=30, step=0.96)
        self.slit.tooltip = "Slit width at the bundle, rounded to whole camera rows, 0.9 to 30 µm"
        self.measure = push_button("Measure", self.measure_stack)
        self.take = push_button("Add frame", self.take_frame)
        self.simulate = push_button("Simulate and measure", self.measure_simulated)
        kinds = PICTURE, TABLE, AXIAL_RESPONSES
        self.save = self.save_button("Save...", "Save the axial response", "axial.png", *kinds)
        self.clear = push_button("Clear", self.clear_scans)
        self._fields = {
            STACK: (self.stack, self.measure),
            MANUAL: (self.live, self.depth_now, self.depth_step, self.take),
            SIMULATED: (self.offset, self.slit, self.simulate),
        }
        self.shown = ComboBox(label="plot", choices=[CURVES, *(one.value for one in SlitParameter)])
        self.shown.tooltip = (
            "Signal against depth, or ELS+ drop-offs against slit offset or width with the paper's saturating curve"
        )
        self.plot.setMinimumHeight(200)
        layout = panel_layout(self)
        fields = [field for group in self._fields.values() for field in group]
        self._form = form_layout(self.source, *fields, self.shown)
        layout.addLayout(self._form)
        layout.addWidget(self.work)
        layout.addWidget(self.numbers)
        layout.addWidget(self.plot, 1)
        pin_below(self, button_row(self.script, self.save, self.clear))

    @property
    def _depths(self) -> int:
        """Depths of the manual scan."""
        return len(set(self._manual.depth_um))

    def _show_numbers(self) -> None:
        """List the drop-offs, or what is missing for them."""
        taking = self.source.value == MANUAL or not self.scans
        if taking and 0 < self._depths < MIN_DEPTHS:
            text = f"{self._depths} of at least {MIN_DEPTHS} depths acquired"
        else:
            text = table(self.scans) if self.scans else next_hint("" if self.work.busy else self._next_action())
        self.numbers.setText(text)

    def _next_action(self) -> str:
        if self.source.value == STACK:
            return f"press Measure; {MANY}" if self.stack.choices else OPEN_SCAN
        if self.source.value == MANUAL:
            add = f"set the depth of the plate and press Add frame, at {MIN_DEPTHS} depths or more."
            return add if self.live.choices else self.live.remedy
        return f"press Simulate and measure; {MANY}"

    def _start(self, frames: int, work: Any) -> None:
        self.work.begin(frames, work, self._measured)
        self._layers_changed()

    def _measured(self, scan: Scan) -> None:
        self.scans = [one for one in self.scans if one.name != scan.name] + [scan]
        self.show_scans()

    def _frame(self, layer: Image) -> np.ndarray[Any, Any]:
        """Return the displayed raw frame of a layer."""
        if layer.ndim == 2:
            return np.asarray(layer.data)
        return np.asarray(layer.data[shown_index(self.viewer, layer)])

    def _source_changed(self) -> None:
        for name, fields in self._fields.items():
            for field in fields:
                self._form.setRowVisible(field.native, name == self.source.value)
        self._layers_changed()

    def _layers_changed(self) -> None:
        self.stack.refresh(newest=not self.work.busy)
        self.live.refresh(newest=not self._depths)
        idle, stacks = not self.work.busy, bool(self.stack.choices)
        set_enabled(
            self.measure, idle and stacks, "Measure the axial response of the stack", WAIT if stacks else OPEN_SCAN
        )
        set_enabled(self.simulate, idle, "Simulate a scan and measure it", WAIT)
        takes = "Add the displayed frame at this depth, and advance the depth by a step"
        set_enabled(self.take, bool(self.live.choices), takes, self.live.remedy)
        set_enabled(self.script, stacks, "Copy a Python script that measures the selected stack", OPEN_SCAN)
        self._show_numbers()


def _axial_stacks(viewer: napari.viewer.Viewer) -> list[str]:
    layers = [viewer.layers[name] for name in calibrated_recordings(viewer)]
    stacks = {layer.name: provenance_of(layer.metadata).get("stack") for layer in layers}
    return [name for name, stack in stacks.items() if stack is not None and stack.depth_um is not None]
