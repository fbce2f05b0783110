"""Fields, buttons and plots of the Calibration panel; their actions are those of the panel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from qtpy.QtCore import QSignalBlocker, Qt
from qtpy.QtWidgets import (
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QGridLayout,
    QLabel,
    QPushButton,
    QSpinBox,
    QWidget,
)

from napari_elsplus.acquisition.calibrating.live import SWEEP_VOLTAGES
from napari_elsplus.errors import InputError
from napari_elsplus.hardware.rigs import rig_names
from napari_elsplus.instrument.optics import MAX_BUNDLE_UM, PRESETS
from napari_elsplus.processing.calibration.step import Capture, StepState
from napari_elsplus.processing.calibration.steps import OFFSET, calibration_steps
from napari_elsplus.viewing.calibration_script import MeasurementSource
from napari_elsplus.widgets.shared.panel import button_row, panel_layout, pin_below, text_label
from napari_elsplus.widgets.shared.plots import ThemedPlot
from napari_elsplus.widgets.shared.rig_choice import preset_label
from napari_elsplus.widgets.shared.window.keys import key_name

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from napari_elsplus.instrument.calibration import OpticsSection
    from napari_elsplus.processing.calibration.step import CalibrationStep
    from napari_elsplus.workflows.calibration_report.picture import Picture
    from napari_elsplus.workflows.calibration_report.report import Number

MARKS: Final = {
    StepState.DONE: "\N{CHECK MARK}",
    StepState.STALE: "\N{WARNING SIGN}",
    StepState.MISSING: "\N{WHITE CIRCLE}",
}
"""Distinguishable without colour."""
MAX_PLOTS: Final = 2
"""Of a step; chosen: more do not fit a dock."""
HEADLINE_PT: Final = 17
FAR_PT: Final = 40
"""In points; chosen: legible from across the bench, with both hands on the tilt mirror."""
NEAR_PT: Final = 11
COLUMNS: Final = 3
"""Of steps, optics and buttons; chosen: their texts fit a dock of 440 px."""
PLOT_STRETCH: Final = 1000
"""Of the layout; chosen: far above 1, so that plots take all free space."""


class Form:
    """Fields, buttons and plots, laid out in a panel.

    Parameters
    ----------
    panel : QWidget
        The panel that they fill.
    work : QWidget
        The progress bar.
    theme : str
        Name of napari's theme.
    """

    def __init__(self, panel: QWidget, work: QWidget, theme: str) -> None:
        self.rig, self.preset = QComboBox(), QComboBox()
        self.rig.addItems(rig_names())
        self.rig.setAccessibleName("rig")
        self.preset.setAccessibleName("preset")
        self.rig.setToolTip("Rigs with a rig file, and the simulated rig")
        for name in PRESETS:
            self.preset.addItem(preset_label(name), name)
        self.preset.setToolTip("Region of the camera and objective")
        self.connect_button = QPushButton()
        self.steps = {step.key: self._step_button(number, step) for number, step in enumerate(calibration_steps(), 1)}
        self.explanation, self.headline, self.numbers = (text_label() for _ in range(3))
        self.headline.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.target, self.voltages = QDoubleSpinBox(), QSpinBox()
        self.target.setRange(3, 100)
        self.target.setValue(29)
        self.target.setToolTip("Target slit offset, either sign, 3 to 100 \N{MICRO SIGN}m; green within 1")
        self.voltages.setRange(20, 4000)
        self.voltages.setValue(SWEEP_VOLTAGES)
        self.voltages.setToolTip("Voltages of the sweep, 20 to 4000; the paper takes at least 400")
        self.bundle_um = _number(
            1,
            MAX_BUNDLE_UM,
            "Diameter of the imaged part of the bundle at the specimen; it gives the micrometres. "
            "Of a probe with a lens: that of the field of view",
        )
        self.line_period_us = _number(4, 1000, "Time from the readout of one row to that of the next")
        self.periods_per_frame = _number(2, 100_000, "Line periods from one frame to the next, idle time included")
        self.measure, self.follow_button, self.from_file = QPushButton(), QPushButton(), QPushButton("From file...")
        self.from_layer = QPushButton("From layer")
        self.accept, self.discard, self.undo = QPushButton("Accept"), QPushButton("Discard"), QPushButton("Undo")
        self.next_step = QPushButton("Next step")
        self.next_step.setToolTip(f"Display the next step ({key_name('next step')})")
        self.load, self.save = QPushButton("Load..."), QPushButton("Save...")
        self.load.setToolTip("Read and activate a calibration")
        self.report, self.history = QPushButton("Save report..."), QPushButton("History...")
        self.history.setToolTip("Plot each number of the calibrations in a folder over days, with warnings of drift")
        self.save_plots, self.script = QPushButton("Save plots..."), QPushButton("Copy as script")
        self.plots = [ThemedPlot("", "", theme) for _ in range(MAX_PLOTS)]
        self._lay_out(panel, work)

    @property
    def target_um(self) -> float:
        """Target slit offset in micrometres."""
        return float(self.target.value())

    def connect(
        self,
        buttons: Mapping[QPushButton, Callable[[], Any]],
        *,
        step: Callable[[str], Any],
        bundle: Callable[[float | None], Any],
        timing: Callable[..., Any],
    ) -> None:
        """Connect buttons and fields.

        Parameters
        ----------
        buttons : mapping of QPushButton to callable
            What each does.
        step : callable
            Called with the key of a step whose button is pressed.
        bundle : callable
            Called with the bundle's diameter in micrometres when it is typed; None is unknown.
        timing : callable
            Called with ``line_period_s`` or ``line_periods_per_frame``.
        """
        for button, slot in buttons.items():
            button.clicked.connect(slot)
        for key, choice in self.steps.items():
            choice.clicked.connect(lambda _, key=key: step(key))
        self.bundle_um.valueChanged.connect(lambda um: bundle(um or None))
        self.line_period_us.valueChanged.connect(lambda us: timing(line_period_s=us / 1e6 or None))
        self.periods_per_frame.valueChanged.connect(lambda periods: timing(line_periods_per_frame=periods or None))

    def save_plots_to(self, path: Path, title: str) -> None:
        """Save the plots: pictures to NAME.png, numbers to NAME.csv; a second plot to NAME-2.

        Parameters
        ----------
        path : pathlib.Path
            Of the first.
        title : str
            The step's, for the message.

        Raises
        ------
        InputError
            If nothing is plotted.
        """
        shown = [plot for plot in self.plots if plot.curves]
        if not shown:
            raise InputError(f"nothing is plotted of the {title}", "measure it first")
        for number, plot in enumerate(shown, 1):
            plot.save(path if number == 1 else path.with_stem(f"{path.stem}-{number}"))

    def live_source(self, step: str, rig: str) -> MeasurementSource:
        """Return the source of a step's frames, by its key, that are taken on a rig, by its name."""
        return MeasurementSource(step, rig=rig, preset=self.preset.currentData(), voltages=self.voltages.value())

    def show_optics(self, bundle_um: float | None, optics: OpticsSection | None) -> None:
        """Display the diameter of the bundle (micrometres) and the timing of the optics; unknown where absent."""
        line_period_s = None if optics is None else optics.line_period_s
        values = (
            (self.bundle_um, bundle_um),
            (self.line_period_us, None if line_period_s is None else 1e6 * line_period_s),
            (self.periods_per_frame, None if optics is None else optics.line_periods_per_frame),
        )
        for field, value in values:
            with QSignalBlocker(field):
                field.setValue(value or 0.0)

    def restore(self, rig: str, preset: str) -> None:
        """Choose the rig and preset of the last time, where they still exist."""
        self.rig.setCurrentText(rig)
        self.preset.setCurrentIndex(max(self.preset.findData(preset), 0))

    def apply_theme(self, theme: str) -> None:
        """Use the colours of one of napari's themes."""
        for plot in self.plots:
            plot.apply_theme(theme)

    def show_states(self, states: Mapping[str, tuple[StepState, str]], chosen: str) -> None:
        """Mark each step as done, stale or missing.

        Parameters
        ----------
        states : mapping
            State and its reason, by the step's key.
        chosen : str
            Key of the displayed step.
        """
        for number, step in enumerate(calibration_steps(), 1):
            button, (state, reason) = self.steps[step.key], states[step.key]
            button.setText(f"{MARKS[state]} {number} {step.title}")
            button.setToolTip(f"{state}{': ' + reason if reason else ''}")
            button.setChecked(step.key == chosen)

    def show_headline(self, text: str) -> None:
        """Display a text in place of the headline."""
        self.headline.setText(text)

    def show_numbers(self, numbers: Sequence[Number]) -> None:
        """Display the `numbers` of a step that was not measured here, for which there is no picture."""
        self.headline.setText("not measured in this session")
        self.numbers.setText("<br>".join(" ".join(part for part in one[1:] if part) for one in numbers))

    def show_picture(self, picture: Picture | None, *, numbers: bool = True) -> None:
        """Display a step's picture.

        Parameters
        ----------
        picture : Picture or None
            None if the step has no result.
        numbers : bool
            Update the lines below the plots, too; left out at times while results follow each other quickly.
        """
        if picture is None:
            self.headline.setText("not measured yet")
            self.numbers.setText("")
            self.numbers.setToolTip("")
            plots: list[Any] = []
        else:
            ink = {
                None: "",
                True: f"color:{self.plots[0].colour('green')}",
                False: f"color:{self.plots[0].colour('orange')}",
            }
            style = f"font-size:{HEADLINE_PT}pt; font-weight:600; {ink[picture.good]}"
            far = f"<span style='{style}; font-size:{FAR_PT}pt'>{picture.far}</span><br>" if picture.far else ""
            smaller = f"font-size:{NEAR_PT}pt" if far else ""
            self.headline.setText(f"{far}<span style='{style}; {smaller}'>{_html(picture.headline)}</span>")
            warn = self.plots[0].colour("vermilion")
            warnings = [
                f"<span style='color:{warn}'>{MARKS[StepState.STALE]} {line}</span>" for line in picture.warnings
            ]
            if numbers:
                self.numbers.setText("<br>".join([*picture.lines, *warnings]))
                self.numbers.setToolTip("\n".join(picture.details))
            plots = list(picture.plots)
        for index, widget in enumerate(self.plots):
            if index < len(plots):
                plot = plots[index]
                widget.draw(plot.curves, marks=plot.marks, bands=plot.bands, bottom=plot.bottom, left=plot.left)
            else:
                widget.draw([])
            widget.setVisible(index < len(plots))

    def allow(
        self,
        *,
        step: CalibrationStep[Any],
        state: StepState,
        missing: tuple[str, str],
        connected: bool,
        connecting: bool,
        busy: bool,
        following: bool,
        candidate: bool,
        past: bool,
        scripted: bool,
        present: bool,
    ) -> None:
        """Enable the actions that are possible; the others have the reason as tooltip.

        Parameters
        ----------
        step : CalibrationStep
            The displayed step.
        state : StepState
            Of the step.
        missing : tuple of str
            Steps that must come first, live and from a file; empty if none.
        connected, connecting, busy, following : bool
            A rig is connected, or being connected; something is measured; the slit offset is being followed.
        candidate, past, scripted, present : bool
            A result is not accepted yet; a step can be undone; a step was measured here; the calibration has a section.
        """
        self.connect_button.setText("Disconnect" if connected else "Connect")
        self.connect_button.setToolTip("Park the galvo, and close the rig" if connected else "Open camera and galvo")
        self.connect_button.setEnabled(not busy and not connecting)
        for choice in (self.rig, self.preset):
            choice.setEnabled(not (busy or connecting or connected))
        self.measure.setText("Measure" if state is StepState.MISSING else "Measure again")
        measured = "something is being measured" if busy else ""
        why = "connect to a rig first" if not connected else measured or missing[0]
        _allow(self.measure, why, f"Measure the {step.title} live")
        self.follow_button.setText("Stop" if following else "Follow live")
        _allow(
            self.follow_button,
            "" if following else why if step.key == OFFSET.key else "only the slit offset is followed",
            "Measure in frame after frame while you turn the tilt mirror; press again to stop",
        )
        live_only = "it can only be measured live" if not step.option else ""
        _allow(self.from_file, measured or live_only or missing[1], f"Measure the {step.title} from a recording")
        _allow(self.from_layer, measured or live_only or missing[1], "Measure it from the frames of the selected layer")
        nothing = "nothing new was measured" if not candidate else "stop following first" if following else ""
        _allow(self.accept, nothing, "Accept the result into the calibration, and activate it")
        _allow(self.discard, nothing, "Discard the result; the calibration stays as it was")
        _allow(self.undo, "" if past else "nothing was accepted yet", "Go back to before the last step was accepted")
        unmeasured = "" if present else "no step is there yet: measure one, or load a calibration"
        _allow(self.save, unmeasured, "Write the calibration, for recordings that have none of their own")
        reports = "Save a PDF with every number, fit, residual and picture, and the date"
        _allow(self.report, unmeasured or measured, reports)
        unplotted = "" if self.plots[0].curves else "nothing is plotted yet"
        _allow(self.save_plots, unplotted, "Save what is plotted as pictures (.png) or tables (.csv)")
        _allow(self.script, "" if scripted else "no step was measured here", "Copy Python that makes this calibration")
        for plain, shown in ((self.target, step.key == OFFSET.key), (self.voltages, step.capture is Capture.SWEEP)):
            plain.setVisible(shown)
            label = self._options.labelForField(plain)
            if label is not None:
                label.setVisible(shown)

    def _step_button(self, number: int, step: CalibrationStep[Any]) -> QPushButton:
        button = QPushButton(f"{number} {step.title}")
        button.setCheckable(True)
        button.setStyleSheet("QPushButton:checked {font-weight: 600}")  # seen without colour, too
        return button

    def _lay_out(self, panel: QWidget, work: QWidget) -> None:
        layout = panel_layout(panel)
        layout.addLayout(button_row(self.rig, self.connect_button))
        layout.addWidget(self.preset)
        layout.addLayout(_grid(*self.steps.values()))
        optics = {
            "bundle Ø (µm)": self.bundle_um,
            "line period (µs)": self.line_period_us,
            "periods / frame": self.periods_per_frame,
        }
        for text, field in optics.items():
            field.setAccessibleName(text)
        layout.addLayout(_grid(*map(QLabel, optics), *optics.values()))
        layout.addLayout(button_row(self.measure, self.follow_button, self.from_file, self.from_layer))
        layout.addLayout(button_row(self.accept, self.discard, self.undo, self.next_step))
        layout.addWidget(self.explanation)
        self._options = QFormLayout()
        self._options.addRow("target offset (µm)", self.target)
        self._options.addRow("voltages", self.voltages)
        layout.addLayout(self._options)
        layout.addWidget(work)
        layout.addWidget(self.headline)
        for plot in self.plots:
            layout.addWidget(plot, PLOT_STRETCH)
        layout.addStretch(1)
        layout.addWidget(self.numbers)
        pin_below(panel, _grid(self.load, self.save, self.report, self.history, self.save_plots, self.script))


def _html(text: str) -> str:
    return text.replace("\n", "<br>")


def _allow(button: QPushButton, why_not: str, tooltip: str) -> None:
    button.setEnabled(not why_not)
    button.setToolTip(why_not or tooltip)


def _number(decimals: int, largest: float, tooltip: str) -> QDoubleSpinBox:
    """Return a field of a positive number, displayed as unknown at 0."""
    field = QDoubleSpinBox()
    field.setDecimals(decimals)
    field.setRange(0, largest)
    field.setSpecialValueText("unknown")
    field.setKeyboardTracking(False)
    field.setToolTip(f"{tooltip}; unknown at 0")
    return field


def _grid(*widgets: QWidget) -> QGridLayout:
    """Return a layout of three columns of one width."""
    grid = QGridLayout()
    for index, widget in enumerate(widgets):
        grid.addWidget(widget, *divmod(index, COLUMNS))
        grid.setColumnStretch(index % COLUMNS, 1)
    return grid
