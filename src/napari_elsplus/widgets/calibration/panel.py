"""The Calibration panel: the calibration's steps one by one, live on a rig or from files."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from napari.utils.notifications import show_info

from napari_elsplus._problems import notify_errors
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.errors import ElsPlusError, InputError
from napari_elsplus.hardware.rig_files import is_simulated
from napari_elsplus.instrument.optics import BUNDLE_UM
from napari_elsplus.io import read_calibration, volts_beside, write_calibration
from napari_elsplus.io.formats.registry import CALIBRATION, PICTURE, TABLE, dialog_filter, recordings_filter
from napari_elsplus.io.settings import set_active_calibration
from napari_elsplus.processing.calibration.step import Capture, StepState
from napari_elsplus.processing.calibration.steps import OFFSET, calibration_steps, find_step
from napari_elsplus.viewing.calibration_script import MeasurementSource, calibration_script
from napari_elsplus.viewing.outlines import summary
from napari_elsplus.widgets.calibration import measuring
from napari_elsplus.widgets.calibration.bundle_layers import BundleLayers
from napari_elsplus.widgets.calibration.form import Form
from napari_elsplus.widgets.calibration.hints import explanation, next_action
from napari_elsplus.widgets.calibration.history import HistoryDialog
from napari_elsplus.widgets.calibration.session import CalibrationSession, ShownResult
from napari_elsplus.widgets.calibration.sharing import Sharing
from napari_elsplus.widgets.shared.choosing import frames_of
from napari_elsplus.widgets.shared.engine_panel import EnginePanel
from napari_elsplus.widgets.shared.files import choose_file_to_read, choose_file_to_write
from napari_elsplus.widgets.shared.panel import copy_as_script, timer
from napari_elsplus.widgets.shared.rig_choice import remember_rig, remembered_rig, remembered_settings
from napari_elsplus.widgets.shared.window.keys import bind_keys
from napari_elsplus.widgets.shared.work import Work
from napari_elsplus.workflows.calibration_report.history import history_beside
from napari_elsplus.workflows.calibration_report.report import calibration_numbers, save_calibration_report

if TYPE_CHECKING:
    from collections.abc import Callable

    import napari.viewer

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.draft import Draft, Setup
    from napari_elsplus.processing.calibration.step import CalibrationStep

    T = TypeVar("T")

POLL_MS: Final = 50
"""Chosen: twenty updates a second look continuous."""
NUMBERS_INTERVAL: Final = 8
"""Displayed offsets from one update of the lines below the plots to the next; chosen: drawing text takes long."""
CALIBRATIONS, PLOTS = dialog_filter(CALIBRATION), dialog_filter(PICTURE, TABLE)
"""Filters of file dialogs."""


class CalibrationPanel(EnginePanel):
    """Calibrate step by step: measure, accept or discard, undo; save and load.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer, in which the bundle's image and its outlines are displayed during that step.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer)
        self.session = CalibrationSession()
        self.key = OFFSET.key
        self._setup: Setup | None = None
        self._following: measuring.OffsetFollowing | None = None
        self._saved: Calibration | None = None
        self._known: tuple[Settings | None, str | None, dict[str, str]] = (None, None, {})
        self.sharing, self._bundle = Sharing(self.connection), BundleLayers(viewer)
        self.work = Work(self.refresh, self._cancel)
        self.form = Form(self, self.work, viewer.theme)
        self._wire()
        self._poll = timer(self, POLL_MS, self._update, starts=True)
        self.refresh()

    @property
    def draft(self) -> Draft:
        """The results that were accepted."""
        return self.session.draft

    @property
    def step(self) -> CalibrationStep[Any]:
        """The displayed step."""
        return find_step(self.key)

    @property
    def candidate(self) -> ShownResult | None:
        """The newest result, neither accepted nor discarded yet."""
        return self.session.candidate

    def connect_rig(self) -> None:
        """Connect to the chosen rig; disconnect if one is connected."""
        if self.connection.client is not None:
            self._setup = None
            self.work.begin(0, self.connection.disconnect, lambda _: None)
        else:
            rig, settings = self.form.rig.currentText(), Settings(self.form.preset.currentData())

            def connect() -> Setup:
                return self.connection.connect(rig, settings).setup().result()

            self.work.begin(0, connect, self._connected)
            remember_rig(rig, replace(remembered_settings(), preset=settings.preset))
        self.refresh()

    def choose(self, key: str) -> None:
        """Display the step with a key."""
        if key != self.key:
            self.session.candidate = None
        self.key = key
        self.refresh()

    def next_step(self) -> None:
        """Display the step after this one; the first one after the last."""
        keys = [step.key for step in calibration_steps()]
        self.choose(keys[(keys.index(self.key) + 1) % len(keys)])

    def measure(self) -> None:
        """Measure the step live, in a thread of its own."""
        with notify_errors(self):
            client, target_um = self.connection.require(), self.form.target_um
            measured = partial(measuring.measure_live, client, self.draft, target_um, self._live_source())
            self.work.begin(0, self._suppressing_cancellation(measured), self._found)
        self.refresh()

    def follow_offset(self) -> None:
        """Measure the slit offset repeatedly until called once more; the last one may then be accepted."""
        if self._following is not None:
            self._following.stop()
            return
        with notify_errors(self):
            client, target_um = self.connection.require(), self.form.target_um
            self._following = measuring.OffsetFollowing(client, self.draft, target_um, self._live_source())
            self.work.begin(0, self._suppressing_cancellation(self._following.run), lambda _: None)
        self.refresh()

    def measure_file(self, path: str | Path, volts: str | Path | None = None) -> None:
        """Measure the step from a recording, in a thread of its own.

        Parameters
        ----------
        path : path-like
            The recording.
        volts : path-like, optional
            Table of a sweep's voltages; by default the one beside the recording.
        """
        with notify_errors(self):
            source = measuring.recorded_source(self.step, Path(path), None if volts is None else Path(volts))
            measured = partial(measuring.measure_recorded, source, self.draft, self.form.target_um, self.work.progress)
            self.work.begin(0, measured, self._found)
        self.refresh()

    def measure_layer(self) -> None:
        """Measure the step from the raw frames of the selected layer, in a thread of its own."""
        with notify_errors(self):
            stack, volts = frames_of(self.viewer.layers.selection.active)
            taken = measuring.stack_source(self.step, stack), stack.planes, volts, self.draft, self.form.target_um
            measured = partial(measuring.measure_frames, *taken, self.work.progress)
            self.work.begin(0, measured, self._found)
        self.refresh()

    def open_dropped(self, path: Path) -> None:
        """Load the calibration at a dropped `path`, or measure the displayed step from a recording."""
        if path.suffix.lower() in CALIBRATION.suffixes:
            self.load(path)
        else:
            self.measure_file(path)

    def accept(self) -> None:
        """Accept the result into the calibration, activate the calibration, and display the next step to be done."""
        with notify_errors(self):
            if self.session.accept():
                self._activate(self.draft.calibration)
                self.key = self.session.next_undone(self.key, live=self.connection.client is not None)
        self.refresh()

    def discard(self) -> None:
        """Discard the result; the calibration stays as it was."""
        self.session.candidate = None
        self.refresh()

    def undo(self) -> None:
        """Restore the calibration before the last step was accepted."""
        if self.session.undo():
            self._activate(self.draft.calibration)
        self.refresh()

    def load(self, path: str | Path) -> None:
        """Read and activate the calibration at a path."""
        with notify_errors(self):
            calibration = read_calibration(path)
            self.session.begin_with(calibration)
            self._activate(self.draft.calibration, Path(path))
            set_active_calibration(path)
            show_info(f"{Path(path).name}: {summary(calibration)}")
        self.refresh()

    def save(self, path: str | Path) -> None:
        """Write the calibration to a path, and open recordings that have none of their own with it from now on."""
        with notify_errors(self):
            written = write_calibration(path, self.draft.calibration, force=True)
            set_active_calibration(written)
            self._saved = self.draft.calibration
            self._activate(self.draft.calibration, written)
            show_info(f"saved {written.name}: {summary(self.draft.calibration)}")

    def save_plots(self, path: str | Path) -> None:
        """Save the step's plots to a path: pictures to NAME.png, numbers to NAME.csv; a second plot to NAME-2."""
        with notify_errors(self):
            self.form.save_plots_to(Path(path), self.step.title)

    def save_report(self, path: str | Path) -> None:
        """Save a PDF of the calibration to a path, with every number, fit, residual and picture."""
        with notify_errors(self):
            history = history_beside(self.sharing.file)
            saved = partial(save_calibration_report, self.draft, Path(path), history=history, force=True)
            self.work.begin(0, saved, lambda pages: show_info(f"saved {Path(path).name}: {pages} pages"), saves=True)

    def copy_script(self) -> None:
        """Copy Python that makes this calibration again to the clipboard."""
        with notify_errors(self):
            copy_as_script(
                calibration_script(self.session.sources, self.draft.bundle_um, self.draft.calibration.optics)
            )

    def unsaved(self) -> str:
        """Return a question if accepted results were not saved; else an empty string."""
        lost = self.session.sources and self.draft.calibration is not self._saved
        return "The calibration was not saved. Discard it?" if lost else ""

    def cleanup(self) -> None:
        """Stop measuring, remove the layers, release the engine and the viewer."""
        if not self._closed:
            self._poll.stop()
            self.work.cancel()
            self._bundle.show(None, self.draft)
        super().cleanup()

    def _wire(self) -> None:
        form, viewer = self.form, self.viewer
        read, write = partial(choose_file_to_read, self), partial(choose_file_to_write, self)
        form.restore(remembered_rig(), remembered_settings().preset)
        form.connect(
            {
                form.connect_button: self.connect_rig,
                form.measure: self.measure,
                form.follow_button: self.follow_offset,
                form.from_file: self._measure_chosen_file,
                form.from_layer: self.measure_layer,
                form.accept: self.accept,
                form.discard: self.discard,
                form.undo: self.undo,
                form.next_step: self.next_step,
                form.load: lambda: read("Load a calibration", CALIBRATIONS, self.load),
                form.save: lambda: write("Save the calibration", "calibration.json", CALIBRATIONS, self.save),
                form.save_plots: lambda: write("Save the plots", f"{self.key}.png", PLOTS, self.save_plots),
                form.report: lambda: write("Save the report", "calibration.pdf", "Reports (*.pdf)", self.save_report),
                form.history: lambda: HistoryDialog(self, viewer.theme, self.sharing.file).show(),
                form.script: self.copy_script,
            },
            step=self.choose,
            bundle=lambda um: self._change(lambda: self.draft.with_bundle_um(um)),
            timing=lambda **given: self._change(lambda: self.draft.with_timing(**given)),
        )
        bind_keys(self, {"next step": self.next_step})
        self.connect_signal(self.viewer.events.theme, self._theme_changed)

    def _change(self, change: Callable[[], Draft]) -> None:
        with notify_errors(self):
            self.session.change(change())
            self._activate(self.draft.calibration)
        self.refresh()

    def _activate(self, calibration: Calibration, path: Path | None = None) -> None:
        activation = self.sharing.activate(calibration, path)
        if activation is not None:
            self.requests.follow(activation)

    def _measure_chosen_file(self) -> None:
        """Measure the step from a chosen recording, a sweep with a table of voltages where none lies beside it."""
        step = self.step

        def measure(frames: Path) -> None:
            if step.capture is Capture.SWEEP and volts_beside(frames) is None:
                volts = partial(self.measure_file, frames)
                choose_file_to_read(self, "Voltages, one per frame", dialog_filter(TABLE), volts)
            else:
                self.measure_file(frames)

        choose_file_to_read(self, f"Frames for the {step.title}", recordings_filter(), measure)

    def _live_source(self) -> MeasurementSource:
        return self.form.live_source(self.key, self.connection.rig or "")

    def _suppressing_cancellation(self, work: Callable[[], T]) -> Callable[[], T]:
        """Return work for the thread whose error is not displayed if the user has cancelled it or closed the panel."""

        def suppressed() -> T:
            try:
                return work()
            except ElsPlusError as error:
                if isinstance(error, InputError) or self._closed:
                    self.work.stop_if_cancelled()
                raise

        return suppressed

    def _connected(self, setup: Setup) -> None:
        self._setup = setup
        if is_simulated(self.connection.rig) and self.draft.bundle_um is None and self.draft.calibration.bundle is None:
            self.session.change(self.draft.with_bundle_um(BUNDLE_UM))  # of the simulated bundle; the field shows it
        self._activate(self.draft.calibration)

    def _setup_changed(self, setup: Setup) -> None:
        self._setup = setup

    def _found(self, shown: ShownResult) -> None:
        self.choose(shown.source.step)
        self.session.candidate = shown

    def _cancel(self) -> None:
        if self._following is not None:
            self._following.stop()
        if (client := self.connection.client) is not None and self.work.busy:
            client.cancel()

    def _update(self) -> None:
        """Display progress, the followed offset, and what other panels have changed; called by the timer."""
        shared = None if self.work.busy else self.sharing.activated_elsewhere(self.draft.calibration)
        if shared is not None:
            self.session.begin_with(shared)
            self.refresh()
        client = self.connection.client
        progress = None if client is None else client.status.progress
        if self.work.busy and progress is not None:
            self.work.show_step(progress.step, progress.done, progress.total)
        stale = {} if client is None else dict(client.status.stale)
        known = self.connection.settings, self.connection.connecting, stale
        if known != self._known and not self.work.busy:
            self._known, self._setup = known, None
            self.refresh()
            if client is not None:
                self.requests.follow(client.setup(), self._setup_changed)
        if self._following is not None:
            self._show_followed(self._following)

    def _show_followed(self, following: measuring.OffsetFollowing) -> None:
        following.target_um = self.form.target_um
        newest = following.newest()
        if isinstance(newest, str):
            self.form.show_headline(newest)
        elif newest is not None and self.key == OFFSET.key:
            self.session.candidate = newest
            self.form.show_picture(newest.picture, numbers=following.readings % NUMBERS_INTERVAL == 1)

    def refresh(self) -> None:
        """Display the step, its state, and the possible actions."""
        form, busy, step, draft = self.form, self.work.busy, self.step, self.draft
        if not busy:
            self._following = None
        connected, settings = self.connection.client is not None, self.connection.settings
        if settings is not None:
            form.restore(self.connection.rig or "", settings.preset)
        form.show_optics(draft.bundle_um, draft.calibration.optics)
        form.show_states({step.key: step.state(draft, self._setup) for step in calibration_steps()}, self.key)
        simulated = connected and is_simulated(self.connection.rig)
        candidate = self.candidate is not None
        action = next_action(step.key, draft, connected=connected, candidate=candidate, saved=not self.unsaved())
        form.explanation.setText(explanation(step, simulated=simulated, action="" if busy else action))
        shown = self.session.shown(self.key)
        form.show_picture(None if shown is None else shown.picture)
        form.allow(
            step=step,
            state=step.state(draft, self._setup)[0],
            missing=(step.missing(draft), step.missing(draft, live=False)),
            connected=connected,
            connecting=self.connection.connecting is not None,
            busy=busy,
            following=self._following is not None,
            candidate=candidate,
            past=self.session.past,
            scripted=bool(self.session.sources),
            present=any(step.state(draft)[0] is not StepState.MISSING for step in calibration_steps()),
        )
        if shown is None and step.state(draft)[0] is not StepState.MISSING:
            form.show_numbers([one for one in calibration_numbers(draft.calibration) if one.step == self.key])
        self._bundle.show(shown, draft)

    def _theme_changed(self) -> None:
        self.form.apply_theme(self.viewer.theme)
        self.refresh()
