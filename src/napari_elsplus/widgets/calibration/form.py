"""The Calibration panel's fields, buttons and plots; what they do is the panel's."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from qtpy.QtCore import Qt
from qtpy.QtWidgets import (
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QSpinBox,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from napari_elsplus.acquisition.calibrating.whole import SWEEP_VOLTAGES
from napari_elsplus.hardware.rigs import rig_names
from napari_elsplus.instrument.optics import PRESETS
from napari_elsplus.processing.calibration.draft import Step, StepState
from napari_elsplus.widgets.shared.plots import ThemedPlot

if TYPE_CHECKING:
    from collections.abc import Mapping

    from napari_elsplus.widgets.calibration.picture import Picture

MARKS: Final = {
    StepState.DONE: "\N{CHECK MARK}",
    StepState.STALE: "\N{WARNING SIGN}",
    StepState.MISSING: "\N{WHITE CIRCLE}",
}
"""Told apart without colour."""
PLOTS: Final = 2
HEADLINE_PT: Final = 17
FAR_PT: Final = 40
"""To be read from across the bench, with both hands on the tilt mirror."""
NEAR_PT: Final = 11
PLOT_STRETCH: Final = 1000
"""A plot takes all the room there is; without one, nothing else grows."""


class Form:
    """Fields, buttons and plots, laid out in a panel.

    Parameters
    ----------
    panel : QWidget
        What it fills.
    work : QWidget
        The progress bar.
    theme : str
        Name of napari's theme.
    """

    def __init__(self, panel: QWidget, work: QWidget, theme: str) -> None:
        self.rig, self.preset = QComboBox(), QComboBox()
        self.rig.addItems(rig_names())
        self.rig.setToolTip("Rigs that are known; the simulated one is always there")
        self.preset.addItems(list(PRESETS))
        self.preset.setToolTip("Region of the camera and objective")
        self.connect_button = QPushButton()
        self.steps = {step: self._step_button(number, step) for number, step in enumerate(Step, 1)}
        self.explanation, self.headline, self.numbers = (_text() for _ in range(3))
        self.headline.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.target, self.voltages = QDoubleSpinBox(), QSpinBox()
        self.target.setRange(3, 100)
        self.target.setValue(29)
        self.target.setSuffix(" \N{MICRO SIGN}m")
        self.target.setToolTip("Slit offset that is wanted, either sign, 3 to 100 \N{MICRO SIGN}m; green within 1")
        self.voltages.setRange(20, 4000)
        self.voltages.setValue(SWEEP_VOLTAGES)
        self.voltages.setToolTip("Steps of the sweep, 20 to 4000; the paper takes at least 400")
        self.measure, self.watch, self.from_file = QPushButton(), QPushButton(), QPushButton("From file...")
        self.accept, self.discard, self.undo = QPushButton("Accept"), QPushButton("Discard"), QPushButton("Undo")
        self.load, self.save = QPushButton("Load..."), QPushButton("Save...")
        self.load.setToolTip("Read a calibration and take it into force")
        self.save_plots, self.script = QPushButton("Save plots..."), QPushButton("Copy as script")
        self.plots = [ThemedPlot("", "", theme) for _ in range(PLOTS)]
        self._lay_out(panel, work)
        self.follow(theme)

    @property
    def target_um(self) -> float:
        """The offset that is wanted."""
        return float(self.target.value())

    def remembered(self, rig: str, preset: str) -> None:
        """Choose what was chosen last time, where it still exists."""
        self.rig.setCurrentText(rig)
        self.preset.setCurrentText(preset)

    def follow(self, theme: str) -> None:
        """Take the colours of one of napari's themes."""
        for plot in self.plots:
            plot.follow(theme)
        ink = self.plots[0].ink("blue")
        style = f"QToolButton {{padding: 3px}} QToolButton:checked {{border: 1px solid {ink}; font-weight: 600}}"
        for button in self.steps.values():
            button.setStyleSheet(style)

    def show_states(self, states: Mapping[Step, tuple[StepState, str]], now: Step) -> None:
        """Mark each step as done, stale or missing."""
        for number, (step, button) in enumerate(self.steps.items(), 1):
            state, why = states[step]
            button.setText(f"{MARKS[state]} {number} {step}")
            button.setToolTip(f"{state}{': ' + why if why else ''}")
            button.setChecked(step is now)

    def explain(self, what: str, prepare: str) -> None:
        """Say what the step measures, and what it needs."""
        self.explanation.setText(f"{what}<br><i>{prepare}</i>")

    def say(self, text: str) -> None:
        """Say a line in place of the headline."""
        self.headline.setText(text)

    def show_picture(self, picture: Picture | None, *, numbers: bool = True) -> None:
        """Show what was found, or nothing; without its numbers where headline and plots have to keep up."""
        if picture is None:
            self.headline.setText("not measured yet")
            self.numbers.setText("")
            plots: list[Any] = []
        else:
            ink = {None: "", True: f"color:{self.plots[0].ink('green')}", False: f"color:{self.plots[0].ink('orange')}"}
            style = f"font-size:{HEADLINE_PT}pt; font-weight:600; {ink[picture.good]}"
            far = f"<span style='{style}; font-size:{FAR_PT}pt'>{picture.far}</span><br>" if picture.far else ""
            smaller = f"font-size:{NEAR_PT}pt" if far else ""
            self.headline.setText(f"{far}<span style='{style}; {smaller}'>{picture.headline}</span>")
            warn = self.plots[0].ink("vermilion")
            said = [f"<span style='color:{warn}'>{MARKS[StepState.STALE]} {line}</span>" for line in picture.warnings]
            if numbers:
                self.numbers.setText("<br>".join([*picture.lines, *said]))
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
        step: Step,
        connected: bool,
        busy: bool,
        watching: bool,
        needs: str,
        candidate: bool,
        past: bool,
        scripted: bool,
        state: StepState,
    ) -> None:
        """Enable what may be done now; what may not says why."""
        self.connect_button.setText("Disconnect" if connected else "Connect")
        self.connect_button.setEnabled(not busy)
        self.rig.setEnabled(not busy and not connected)
        self.preset.setEnabled(not busy and not connected)
        self.measure.setText("Measure" if state is StepState.MISSING else "Measure again")
        why = "connect to a rig first" if not connected else "something is being measured" if busy else needs
        _allow(self.measure, why, f"Measure the {step} live")
        self.watch.setVisible(step is Step.OFFSET)
        self.watch.setText("Stop" if watching else "Watch live")
        _allow(
            self.watch, "" if watching else why, "Measure on and on while you turn the tilt mirror; press again to stop"
        )
        file_why = "something is being measured" if busy else "a file cannot show it" if step is Step.LAG else ""
        if step is Step.FLAT:
            file_why = file_why or needs
        _allow(self.from_file, file_why, f"Measure the {step} from a recording")
        nothing = "nothing new was measured" if not candidate else "stop watching first" if watching else ""
        _allow(self.accept, nothing, "Take it into the calibration")
        _allow(self.discard, nothing, "Forget it; the calibration stays as it was")
        _allow(self.undo, "" if past else "nothing was accepted yet", "Go back to before the last step was accepted")
        _allow(self.save, "", "Write the calibration, for recordings that have none of their own")
        unseen = "" if self.plots[0].curves else "nothing is plotted yet"
        _allow(self.save_plots, unseen, "Save what is plotted as pictures (.png) or tables (.csv)")
        _allow(self.script, "" if scripted else "no step was measured here", "Copy Python that makes this calibration")
        for plain, shown in ((self.target, Step.OFFSET), (self.voltages, Step.GALVO)):
            plain.setVisible(step is shown)
            label = self._options.labelForField(plain)
            if label is not None:
                label.setVisible(step is shown)

    def _step_button(self, number: int, step: Step) -> QToolButton:
        button = QToolButton()
        button.setCheckable(True)
        button.setSizePolicy(button.sizePolicy().Policy.Expanding, button.sizePolicy().Policy.Fixed)
        button.setText(f"{number} {step}")
        return button

    def _lay_out(self, panel: QWidget, work: QWidget) -> None:
        layout = QVBoxLayout(panel)
        layout.setContentsMargins(6, 6, 6, 6)
        layout.addLayout(_row(self.rig, self.preset, self.connect_button))
        grid = QGridLayout()
        for index, button in enumerate(self.steps.values()):
            grid.addWidget(button, index // 2, index % 2)
        layout.addLayout(grid)
        layout.addWidget(self.explanation)
        self._options = QFormLayout()
        self._options.addRow("target", self.target)
        self._options.addRow("voltages", self.voltages)
        layout.addLayout(self._options)
        layout.addLayout(_row(self.measure, self.watch, self.from_file))
        layout.addWidget(work)
        layout.addWidget(self.headline)
        for plot in self.plots:
            plot.setMinimumHeight(120)
            layout.addWidget(plot, PLOT_STRETCH)
        layout.addStretch(1)
        layout.addWidget(self.numbers)
        layout.addLayout(_row(self.accept, self.discard, self.undo))
        layout.addLayout(_row(self.load, self.save))
        layout.addLayout(_row(self.save_plots, self.script))


def _allow(button: QPushButton, why_not: str, tooltip: str) -> None:
    button.setEnabled(not why_not)
    button.setToolTip(why_not or tooltip)


def _text() -> QLabel:
    label = QLabel()
    label.setWordWrap(True)
    return label


def _row(*widgets: QWidget) -> QHBoxLayout:
    row = QHBoxLayout()
    for widget in widgets:
        row.addWidget(widget)
    return row
