"""The Compare panel: LS, ELSA and ELS+ of one recording side by side, with profiles and numbers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from magicgui.widgets import ComboBox, SpinBox
from napari.utils.notifications import show_info

from napari_elsplus._problems import notify_errors
from napari_elsplus._view import prepare_shapes
from napari_elsplus.errors import InputError
from napari_elsplus.io.formats.registry import PICTURE, TABLE
from napari_elsplus.processing.analysis.image_quality import Scaling, white_level, white_levels
from napari_elsplus.processing.analysis.line_profiles import PROFILE_WIDTH_PX, line_profiles
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.viewing.comparison import (
    Comparison,
    ImageStatistics,
    compare_stack,
    comparison_script,
    difference_planes,
    image_statistics,
)
from napari_elsplus.viewing.provenance import provenance_of
from napari_elsplus.widgets.analysis.comparison_layers import ComparedImage, ComparisonLayers
from napari_elsplus.widgets.analysis.panel import AnalysisPanel
from napari_elsplus.widgets.shared.choosing import (
    LayerChoice,
    calibrated_recordings,
    chosen_recording,
    shown_index,
)
from napari_elsplus.widgets.shared.files import choose_file_to_write, note_folder
from napari_elsplus.widgets.shared.panel import (
    button_row,
    copy_as_script,
    form_layout,
    next_hint,
    panel_layout,
    pin_below,
    push_button,
    set_enabled,
    timer,
)
from napari_elsplus.widgets.shared.plots import Curve
from napari_elsplus.workflows.pictures.comparison import ComparisonFigure, scaled_images
from napari_elsplus.workflows.pictures.curves import MODE_COLOURS, MODE_DASHES

if TYPE_CHECKING:
    import napari.viewer
    from napari.layers import Image

    from napari_elsplus.widgets.shared.choosing import ChosenRecording
    from napari_elsplus.widgets.shared.plots import ThemedPlot

SIDE_BY_SIDE, BLINK, DIFFERENCE = "side by side", "blink", "difference"
DIFFERENCES: Final = ((Mode.LS, Mode.ELS), (Mode.ELSA, Mode.ELS))
"""Light removed by the subtraction; motion between ELSA's two frames."""
REFRESH_MS: Final = 100
"""Delay of table and profiles after a change, milliseconds; chosen, 10 Hz while the slider moves."""
BLINK_MS: Final = 600
"""Time for which each image is displayed, milliseconds; chosen, long enough to compare one detail."""
ROUND: Final = (1, 1.5, 2, 2.5, 3, 4, 5, 6, 7)
"""Limits of the difference view within a decade; chosen, no image is dimmed by more than a third."""
FIGURES: Final = "Figures (*.pdf *.svg *.png)"
PREPARING: Final = "Computing the first images; the first time after installation this takes some seconds."
HINT: Final = "select a recording and press Compare; then draw a line on any of the images."


class ComparePanel(AnalysisPanel):
    """Compare LS, ELSA and ELS+ of a recording in the viewer.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer. The user's layers are hidden during the comparison and restored afterwards.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer, "position along the line / px", "grey levels")
        self._comparison: Comparison | None = None
        self._source: Image | None = None
        self._displayed: list[tuple[ComboBox, str]] = []
        self.display = ComparisonLayers(viewer, self._schedule_refresh)
        self._build()
        self._refresh = timer(self, REFRESH_MS, self.show_numbers, once=True)
        self._blink = timer(self, BLINK_MS, self.display.show_next)
        self._ending = timer(self, 0, self._end_if_incomplete, once=True)
        self.line_width.changed.connect(self.show_numbers)
        self.scaling.changed.connect(self.rescale_contrast)
        for choice in (self.cores, self.view, self.recording):
            choice.changed.connect(self._restart)
        self.connect_signal(viewer.dims.events.current_step, self._schedule_refresh)
        self._layers_changed()

    @property
    def comparing(self) -> bool:
        """True while the images of a comparison are in the viewer."""
        return self._comparison is not None

    def toggle(self) -> None:
        """Start the comparison, or end it."""
        if self.comparing:
            self.end()
        else:
            self.begin()

    def begin(self) -> None:
        """Compute LS, ELSA and ELS+ of the selected recording in a thread, and display them."""
        with notify_errors(self):
            source, cores, index = chosen_recording(self.recording), self.cores.value, self._index()
            note_folder(provenance_of(source.layer.metadata).get("path"))

            def made() -> Comparison:
                comparison = compare_stack(source.stack, source.calibration, cores)
                for planes in self.work.progress(list(comparison.images.values())):
                    planes[index]
                prepare_shapes()
                return comparison

            self.work.begin(0, made, lambda comparison: self._show(comparison, source))
        self._layers_changed()
        self.show_numbers()

    def end(self) -> None:
        """Remove the images of the comparison and restore the user's layers."""
        self._blink.stop()
        self._comparison = self._source = None
        self.plot.draw([])
        self._layers_changed()
        self.display.end()  # last: the window may be closed while it answers

    def cleanup(self) -> None:
        """End the comparison and disconnect from the viewer."""
        self._refresh.stop()
        self._ending.stop()
        if self.comparing:
            self.end()
        super().cleanup()

    def rescale_contrast(self) -> None:
        """Set the contrast limits from the displayed frame."""
        if self._comparison is None:
            return
        index, inside = self._index(), self._comparison.inside
        if self.view.value == DIFFERENCE:
            for layer in self.display.images:
                white = _round_up(white_level(np.abs(np.asarray(layer.data[index]))[inside]))
                layer.contrast_limits = (-white, white)
            return
        levels = white_levels(self._comparison.at(index), inside, self.scaling.value)
        for layer, level in zip(self.display.images, levels.values(), strict=True):
            layer.contrast_limits = (0, level)

    def show_numbers(self) -> None:
        """Show contrast, background and line profiles of the displayed frame."""
        if self._comparison is None:
            hint = next_hint(HINT if self.recording.choices else self.recording.remedy)
            self.numbers.setText(PREPARING if self.work.busy else hint)
            return
        images = self._comparison.at(self._index())
        self.numbers.setText(_table(image_statistics(images, self._comparison.inside), self.plot))
        if self.display.line is None:
            return
        with notify_errors(self, resolves=False):
            found = line_profiles(images, *self.display.line, self._comparison.um_per_px, self.line_width.value)
            unit = "\N{MICRO SIGN}m" if found.unit == "um" else "px"
            curves = [
                Curve(mode.label, found.position, values, MODE_COLOURS[mode], MODE_DASHES[mode])
                for mode, values in found.values.items()
            ]
            self.plot.draw(curves, bottom=f"position along the line / {unit}")

    def save_figure_to(self, path: str | Path) -> None:
        """Save the displayed frame's images and profiles as a figure for a paper; an existing file is replaced.

        Parameters
        ----------
        path : path-like
            Ends in ``.png``, ``.pdf`` or ``.svg``.
        """
        with notify_errors(self):
            if self._comparison is None:
                raise InputError("there is no comparison to save", "press Compare first")
            images, inside = self._comparison.at(self._index()), self._comparison.inside
            scaled = scaled_images(images, inside, self.scaling.value)
            um_per_px, width_px = self._comparison.um_per_px, int(self.line_width.value)
            figure = ComparisonFigure(scaled, inside, self.display.line or (), width_px, um_per_px)
            saved = f"saved {Path(path).name}"
            self.work.begin(0, lambda: figure.save(path, force=True), lambda _: show_info(saved), saves=True)
        self._layers_changed()

    def copy_script(self) -> None:
        """Copy a script that makes this comparison to the clipboard."""
        with notify_errors(self):
            source, index = chosen_recording(self.recording), self._index()
            cores, scaling = self.cores.value, self.scaling.value
            copy_as_script(comparison_script(source.stack, source.calibration_path, cores, scaling, index))

    def _build(self) -> None:
        self.recording = LayerChoice(self.viewer, calibrated_recordings, "recording", "Raw layers with a calibration")
        self.cores = ComboBox(label="core filter", choices=[kind.value for kind in CoreFilter])
        self.cores.tooltip = "Suppression of the core pattern (honeycomb), the same in all images"
        self.scaling = ComboBox(label="scaling", choices=[kind.value for kind in Scaling])
        self.scaling.tooltip = (
            "Grey level of white. 0.01 % saturated: as in the paper, ELSA with the factor of ELS+; "
            "shared: one level for all; individual: 0.01 % of each image"
        )
        self.view = ComboBox(label="view", choices=[SIDE_BY_SIDE, BLINK, DIFFERENCE])
        self.view.tooltip = "Side by side; alternating in one place; LS - ELS+ and ELSA - ELS+ in grey levels"
        self.line_width = SpinBox(label="line width (px)", value=PROFILE_WIDTH_PX, min=1, max=51)
        self.line_width.tooltip = "Pixels across the line that are averaged in the profiles, 1 to 51"
        self.start = push_button("Compare", self.toggle)
        self.rescale = push_button("Rescale", self.rescale_contrast)
        self.save = self.save_button("Save profiles...", "Save the profiles", "profiles.png", PICTURE, TABLE)
        self.save_figure = push_button("Save figure...", self._ask_where_to_save_figure)
        layout = panel_layout(self)
        layout.addLayout(form_layout(self.recording, self.cores, self.scaling, self.view, self.line_width))
        layout.addLayout(button_row(self.start, self.rescale))
        layout.addWidget(self.work)
        layout.addWidget(self.numbers)
        layout.addWidget(self.plot, 1)
        pin_below(self, button_row(self.save_figure, self.save, self.script))

    def _show(self, comparison: Comparison, source: ChosenRecording) -> None:
        """Hide the user's layers and display the images, in place of an earlier comparison."""
        if source.layer not in self.viewer.layers:
            return
        step = self.viewer.dims.current_step
        with notify_errors(self):
            compared = self._compared_images(comparison)  # may raise, so before the viewer is changed
            line = self.display.line if source.layer == self._source else None
            if self.comparing:
                self.end()
            apart = self.view.value != BLINK
            self._comparison, self._source = comparison, source.layer
            self._displayed = [(choice, choice.value) for choice in (self.cores, self.view)]
            self.display.begin(compared, source.stack, source.calibration, apart=apart, line=line)
            if not self.comparing:
                return  # ended while the window answered
            self.viewer.dims.current_step = step
            self.rescale_contrast()
            if not apart:
                self.display.show_next()
                self._blink.start()
        self._layers_changed()
        self.show_numbers()

    def _compared_images(self, comparison: Comparison) -> list[ComparedImage]:
        colours = self._title_colours(comparison)
        if self.view.value == DIFFERENCE:
            pairs = [(a, b) for a, b in DIFFERENCES if a in comparison.images]
            return [
                ComparedImage(f"{a.label} - {b.label}", difference_planes(comparison, a, b), colour, signed=True)
                for (a, b), colour in zip(pairs, colours, strict=False)
            ]
        return [
            ComparedImage(mode.label, planes, colour)
            for (mode, planes), colour in zip(comparison.images.items(), colours, strict=True)
        ]

    def _title_colours(self, comparison: Comparison) -> list[str]:
        """Return the colours of the titles for the present background."""
        plain = self.view.value == DIFFERENCE
        return [self.plot.colour("grey" if plain else MODE_COLOURS[mode]) for mode in comparison.images]

    def _index(self) -> int:
        layer = self.display.images[0] if self.display.images else chosen_recording(self.recording).layer
        return shown_index(self.viewer, layer)

    def _restart(self) -> None:
        if self.comparing:
            self.begin()

    def _schedule_refresh(self) -> None:
        if self.comparing and not self._refresh.isActive():
            self._refresh.start()

    @property
    def _incomplete(self) -> bool:
        """True if a layer of the comparison, or its recording, is no longer in the viewer."""
        return self.comparing and not (self.display.intact and self._source in self.viewer.layers)

    def _end_if_incomplete(self) -> None:
        if self._incomplete:
            self.end()

    def _layers_changed(self) -> None:
        if self._incomplete:
            self._ending.start()  # the user removed one of them; napari may be about to remove more
            return
        if self.comparing:
            self.display.hide_opened()
        idle = not self.work.busy
        self.recording.refresh(newest=idle and not self.comparing)
        available = bool(self.recording.choices)
        if not self.comparing:
            self.show_numbers()
        for choice in (self.recording, self.cores, self.view):
            choice.enabled = idle
        self.start.text = "End comparison" if self.comparing else "Compare"
        shows = "Display LS, ELSA and ELS+ of the recording; press again to end"
        set_enabled(
            self.start, available and idle, shows, "wait for the images" if available else self.recording.remedy
        )
        set_enabled(self.script, available, "Copy a Python script that makes this comparison", self.recording.remedy)
        set_enabled(
            self.rescale, self.comparing, "Set the contrast limits from the displayed frame", "start the comparison"
        )
        set_enabled(self.save, self.comparing, "Save the profiles as PNG or CSV", "start the comparison")
        figure = "Save images and profiles as a figure of one column's width (85 mm): PNG, PDF or SVG"
        reason = "wait for the images" if self.comparing else "start the comparison"
        set_enabled(self.save_figure, self.comparing and idle, figure, reason)

    def _work_ended(self) -> None:
        if self.comparing and self._source is not None:  # what failed, or was cancelled, is not selected
            self.recording.select(self._source)
            for choice, value in self._displayed:
                with choice.changed.blocked():
                    choice.value = value
        super()._work_ended()
        self.show_numbers()

    def _theme_changed(self) -> None:
        super()._theme_changed()
        if self._comparison is not None:
            self.display.set_title_colours(self._title_colours(self._comparison)[: len(self.display.images)])
        self.show_numbers()

    def _ask_where_to_save_figure(self) -> None:
        choose_file_to_write(self, "Save the figure", "comparison.pdf", FIGURES, self.save_figure_to)


def _round_up(level: float) -> float:
    """Return the next number at which the ticks of a colour bar are labelled near both of its ends."""
    decade = 10.0 ** np.floor(np.log10(level)) if level > 0 else 1.0
    return float(decade * next((step for step in ROUND if decade * step >= level), 10))


def _table(found: dict[Mode, ImageStatistics], plot: ThemedPlot) -> str:
    """Return the statistics as rich text, each mode in its colour."""

    def row(*cells: str) -> str:
        first, *rest = cells
        return f"<tr><td>{first}</td>" + "".join(f"<td align=right>{cell}</td>" for cell in rest) + "</tr>"

    rows = [row("", "contrast", "background", "background, % of LS")]
    for mode, one in found.items():
        title = f"<b style='color:{plot.colour(MODE_COLOURS[mode])}'>{mode.label}</b>"
        rows.append(row(title, f"{one.contrast:.2f}", f"{one.background:.1f}", f"{100 * one.background_left:.0f} %"))
    return f"<table width='100%' cellspacing=3>{''.join(rows)}</table>"
