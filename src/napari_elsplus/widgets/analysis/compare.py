"""The Compare panel: LS, ELSA and ELS+ of one recording side by side, with profiles and numbers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from magicgui.widgets import ComboBox, Container, PushButton
from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QFileDialog, QLabel, QVBoxLayout

from napari_elsplus.io.formats.registry import PICTURE, TABLE, dialog_filter
from napari_elsplus.processing.analysis.image_quality import white_level
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.viewing.comparison import (
    Comparison,
    Figures,
    Scaling,
    compare_stack,
    comparison_script,
    difference_planes,
    figures,
    line_profiles,
    white_levels,
)
from napari_elsplus.viewing.layers import TITLES
from napari_elsplus.widgets.analysis.stage import Exhibit, Stage
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
    from napari.layers import Image

COLOURS: Final = {Mode.LS: "blue", Mode.ELSA: "orange", Mode.ELS: "green"}
DASHES: Final = {Mode.LS: "dotted", Mode.ELSA: "dashed", Mode.ELS: "solid"}
SIDE_BY_SIDE, BLINK, DIFFERENCE = "side by side", "blink", "difference"
DIFFERENCES: Final = ((Mode.LS, Mode.ELS), (Mode.ELSA, Mode.ELS))
"""What the subtraction takes away; what moved between ELSA's two frames."""
REFRESH_MS: Final = 100
BLINK_MS: Final = 600
PREPARING: Final = "Making the first images; on a new installation this takes some seconds, once."
HINT: Final = "Choose a recording and press Compare; then draw a line on any of the images."


class ComparePanel(Panel):
    """Compare LS, ELSA and ELS+ of a recording that is open in the viewer.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer. Its own layers are hidden while comparing, and shown again afterwards as they were.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer)
        self._comparison: Comparison | None = None
        self._source: Image | None = None
        self.stage = Stage(viewer, self._soon)
        self.work = Work(self._work_ended)
        self._build()
        self._refresh = _timer(self, REFRESH_MS, self.show_numbers, once=True)
        self._blink = _timer(self, BLINK_MS, self.stage.show_next)
        self.start.clicked.connect(self.toggle)
        self.rescale.clicked.connect(self.take_white_levels)
        self.script.clicked.connect(self.copy_script)
        self.save.clicked.connect(self._ask_where_to_save)
        self.scaling.changed.connect(self.take_white_levels)
        for choice in (self.cores, self.view, self.recording):
            choice.changed.connect(self._again)
        self.listen(viewer.layers.events.inserted, self._layers_changed)
        self.listen(viewer.layers.events.removed, self._layers_changed)
        self.listen(viewer.dims.events.current_step, self._soon)
        self.listen(viewer.events.theme, self._theme_changed)
        self._layers_changed()
        self.show_numbers()

    @property
    def comparing(self) -> bool:
        """Whether the comparison's images are in the viewer."""
        return self._comparison is not None

    def toggle(self) -> None:
        """Begin comparing, or end it."""
        if self.comparing:
            self.end()
        else:
            self.begin()

    def begin(self) -> None:
        """Make LS, ELSA and ELS+ of the chosen recording, in a thread of its own, and show them."""
        with told():
            source = self._chosen()
            known, cores, index = source.metadata["elsplus"], self.cores.value, self._index()

            def made() -> Comparison:
                comparison = compare_stack(known["stack"], known["calibration"], cores)
                comparison.at(index)
                prepare_shapes()
                return comparison

            self.work.begin(0, made, lambda comparison: self._show(comparison, source))
        self._layers_changed()
        self.show_numbers()

    def end(self) -> None:
        """Take the comparison's images away, and show the user's layers as they were."""
        self._blink.stop()
        self._comparison = self._source = None
        self.stage.end()
        self.plot.draw([])
        self._layers_changed()
        self.show_numbers()

    def cleanup(self) -> None:
        """End the comparison and let go of the viewer."""
        self.work.cancel()
        self._refresh.stop()
        if self.comparing:
            self.end()
        super().cleanup()

    def take_white_levels(self) -> None:
        """Take the white levels from the frame that is shown."""
        if self._comparison is None:
            return
        index, inside = self._index(), self._comparison.inside
        if self.view.value == DIFFERENCE:
            for layer in self.stage.images:
                white = white_level(np.abs(np.asarray(layer.data[index])), inside)
                layer.contrast_limits = (-white, white)
            return
        levels = white_levels(self._comparison.at(index), inside, self.scaling.value)
        for layer, level in zip(self.stage.images, levels.values(), strict=True):
            layer.contrast_limits = (0, level)

    def show_numbers(self) -> None:
        """Put contrast, background and profiles of the frame that is shown beside the images."""
        if self._comparison is None:
            self.numbers.setText(PREPARING if self.work.busy else HINT)
            return
        images = self._comparison.at(self._index())
        self.numbers.setText(_table(figures(images, self._comparison.inside), self.plot))
        if self.stage.line is None:
            return
        with told():
            found = line_profiles(images, *self.stage.line, self._comparison.um_per_px)
            unit = "\N{MICRO SIGN}m" if found.unit == "um" else "px"
            curves = [
                Curve(TITLES[mode], found.position, values, COLOURS[mode], DASHES[mode])
                for mode, values in found.values.items()
            ]
            self.plot.draw(curves, bottom=f"position along the line / {unit}")

    def copy_script(self) -> None:
        """Copy Python that makes this comparison to the clipboard."""
        with told():
            known = self._chosen().metadata["elsplus"]
            calibration_file = known["calibration_path"]
            text = comparison_script(
                known["stack"], calibration_file, self.cores.value, self.scaling.value, self._index()
            )
            copy_as_script(text)

    def _build(self) -> None:
        self.recording = ComboBox(
            label="recording",
            choices=lambda _: calibrated_recordings(self.viewer),
            tooltip="Raw layers with a calibration",
        )
        self.cores = ComboBox(label="core filter", choices=[kind.value for kind in CoreFilter])
        self.cores.tooltip = "How the honeycomb of the cores is suppressed, in all of them alike"
        self.scaling = ComboBox(label="scaling", choices=[kind.value for kind in Scaling])
        self.scaling.tooltip = "White: 0.01 % saturation, and ELSA by ELS+'s factor; one level for all; each its own"
        self.view = ComboBox(label="view", choices=[SIDE_BY_SIDE, BLINK, DIFFERENCE])
        self.view.tooltip = "Next to each other; in turn in one place; LS - ELS+ and ELSA - ELS+ in grey levels"
        self.start = PushButton(text="Compare")
        self.rescale = PushButton(text="Rescale")
        self.script = PushButton(text="Copy as script")
        self.save = PushButton(text="Save plot...")
        form = Container(widgets=[self.recording, self.cores, self.scaling, self.view], labels=True)
        form.margins = (0, 0, 0, 0)
        self.numbers = QLabel()
        self.numbers.setWordWrap(True)
        self.plot = ThemedPlot("position along the line / px", "grey levels", self.viewer.theme)
        self.plot.setMinimumHeight(180)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(6, 6, 6, 6)
        layout.addWidget(form.native)
        layout.addLayout(button_row(self.start, self.rescale))
        layout.addWidget(self.work)
        layout.addWidget(self.numbers)
        layout.addWidget(self.plot, 1)
        layout.addLayout(button_row(self.script, self.save))

    def _chosen(self) -> Image:
        return chosen_image(self.viewer, self.recording, "recording with a calibration")

    def _show(self, comparison: Comparison, source: Image) -> None:
        """Hide the user's layers and show the images; those of a comparison before go."""
        if source not in self.viewer.layers:
            return
        step = self.viewer.dims.current_step
        with told():
            exhibits = self._exhibits(comparison)  # what can fail comes before the viewer is touched
            if self.comparing:
                self.end()
            known, apart = source.metadata["elsplus"], self.view.value != BLINK
            self.stage.begin(exhibits, known["stack"], known["calibration"], apart=apart)
            self.viewer.dims.current_step = step
            self._comparison, self._source = comparison, source
            self.take_white_levels()
            if not apart:
                self.stage.show_next()
                self._blink.start()
        self._layers_changed()
        self.show_numbers()

    def _exhibits(self, comparison: Comparison) -> list[Exhibit]:
        inks = self._inks(comparison)
        if self.view.value == DIFFERENCE:
            pairs = [(a, b) for a, b in DIFFERENCES if a in comparison.images]
            return [
                Exhibit(f"{TITLES[a]} - {TITLES[b]}", difference_planes(comparison, a, b), ink, signed=True)
                for (a, b), ink in zip(pairs, inks, strict=False)
            ]
        return [
            Exhibit(TITLES[mode], planes, ink)
            for (mode, planes), ink in zip(comparison.images.items(), inks, strict=True)
        ]

    def _inks(self, comparison: Comparison) -> list[str]:
        """Colours of the titles on the present ground."""
        plain = self.view.value == DIFFERENCE
        return [self.plot.ink("grey" if plain else COLOURS[mode]) for mode in comparison.images]

    def _index(self) -> int:
        layer = self.stage.images[0] if self.stage.images else self._chosen()
        return shown_index(self.viewer, layer)

    def _again(self) -> None:
        if self.comparing:
            self.begin()

    def _soon(self) -> None:
        if self.comparing and not self._refresh.isActive():
            self._refresh.start()

    def _layers_changed(self) -> None:
        if self.comparing and not (self.stage.intact and self._source in self.viewer.layers):
            self.end()  # the user took one of them away
            return
        renew_choices(self.recording)
        able, idle = bool(self.recording.choices), not self.work.busy
        for choice in (self.recording, self.cores, self.view):
            choice.enabled = idle
        self.start.text = "End comparison" if self.comparing else "Compare"
        shows = "Show LS, ELSA and ELS+ of the recording; press again to end"
        allow(self.start, able and idle, shows, "wait for the images" if able else OPEN_ONE)
        allow(self.script, able, "Copy Python that makes this comparison", OPEN_ONE)
        allow(self.rescale, self.comparing, "Take the white levels from the frame that is shown", "begin comparing")
        allow(self.save, self.comparing, "Save the profiles as PNG or CSV", "begin comparing")

    def _work_ended(self) -> None:
        self._layers_changed()
        self.show_numbers()

    def _theme_changed(self) -> None:
        self.plot.follow(self.viewer.theme)
        if self._comparison is not None:
            self.stage.ink_titles(self._inks(self._comparison)[: len(self.stage.images)])
        self.show_numbers()

    def _ask_where_to_save(self) -> None:
        kinds = dialog_filter(PICTURE, TABLE)
        path, _ = QFileDialog.getSaveFileName(self, "Save the profiles", "profiles.png", kinds)
        if path:
            with told():
                self.plot.save(Path(path))


def _timer(parent: Panel, milliseconds: int, slot: Any, *, once: bool = False) -> QTimer:
    timer = QTimer(parent)
    timer.setInterval(milliseconds)
    timer.setSingleShot(once)
    timer.timeout.connect(slot)
    return timer


def _table(found: dict[Mode, Figures], plot: ThemedPlot) -> str:
    """Write the numbers as rich text, each mode in its colour."""

    def row(*cells: str) -> str:
        first, *rest = cells
        return f"<tr><td>{first}</td>" + "".join(f"<td align=right>{cell}</td>" for cell in rest) + "</tr>"

    rows = [row("", "contrast", "background", "of LS's")]
    for mode, one in found.items():
        title = f"<b style='color:{plot.ink(COLOURS[mode])}'>{TITLES[mode]}</b>"
        rows.append(row(title, f"{one.contrast:.2f}", f"{one.background:.1f}", f"{100 * one.background_left:.0f} %"))
    return f"<table width='100%' cellspacing=3>{''.join(rows)}</table>"
