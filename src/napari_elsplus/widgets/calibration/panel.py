"""The Calibration panel: leads through the steps, live on a rig or from files."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

from napari.utils.notifications import show_error, show_info
from qtpy.QtCore import QTimer

from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.link.guided_calibration import GuidedCalibration
from napari_elsplus.errors import ElsPlusError, InputError
from napari_elsplus.hardware.rig import SIMULATED
from napari_elsplus.io import read_calibration, write_calibration
from napari_elsplus.io.settings import recall, remember, set_active_calibration
from napari_elsplus.processing.calibration.draft import Draft, Setup, Step, StepState, step_of
from napari_elsplus.viewing.calibration_script import MeasurementSource, calibration_script
from napari_elsplus.viewing.outlines import summary
from napari_elsplus.widgets.calibration import dialogs
from napari_elsplus.widgets.calibration.bundle_layers import show_bundle
from napari_elsplus.widgets.calibration.explained import EXPLAINED, PREPARE
from napari_elsplus.widgets.calibration.explained import SIMULATED as SIMULATED_TARGETS
from napari_elsplus.widgets.calibration.form import Form
from napari_elsplus.widgets.calibration.measuring import Watching, measure_live, measure_recorded
from napari_elsplus.widgets.calibration.session import Session, ShownResult
from napari_elsplus.widgets.calibration.sharing import Sharing
from napari_elsplus.widgets.shared.connection import join
from napari_elsplus.widgets.shared.panel import Panel, copy_as_script, told
from napari_elsplus.widgets.shared.window_end import WindowEnd
from napari_elsplus.widgets.shared.work import Work

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

    import napari.viewer

    T = TypeVar("T")

POLL_MS: Final = 50
NUMBERS_EVERY: Final = 8
"""Readings from one renewal of the numbers to the next: nobody reads them with both hands on the mirror."""
SECTION: Final = "calibration"


class CalibrationPanel(Panel):
    """Calibrate step by step: measure, look, accept or discard, undo; save and load.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer; the bundle's image and its outlines are shown in it while the bundle pair is looked at.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer)
        self.session = Session()
        self.step = Step.OFFSET
        self._setup: Setup | None = None
        self._watching: Watching | None = None
        self._left = False
        self._window_end = WindowEnd(self, self.cleanup)
        self._stale: dict[str, str] = {}
        self._changed = False
        self.connection = join()
        self.sharing = Sharing(self.connection)
        self.work = Work(self._work_ended, self._cancel)
        self.form = Form(self, self.work, viewer.theme)
        self._wire()
        self._poll = QTimer(self)
        self._poll.setInterval(POLL_MS)
        self._poll.timeout.connect(self._look)
        self._poll.start()
        self._refresh()

    @property
    def draft(self) -> Draft:
        """The calibration as far as it was accepted."""
        return self.session.draft

    @property
    def candidate(self) -> ShownResult | None:
        """What was found last, neither accepted nor discarded yet."""
        return self.session.candidate

    # what the buttons do

    def connect_rig(self) -> None:
        """Connect to the chosen rig; disconnect if one is connected."""
        if self.connection.client is not None:
            self._setup = None
            self.work.begin(0, self.connection.disconnect, lambda _: None)
        else:
            rig, settings = self.form.rig.currentText(), Settings(self.form.preset.currentText())

            def connect() -> Setup:
                return GuidedCalibration(self.connection.connect(rig, settings)).setup()

            self.work.begin(0, connect, self._connected)
            remember(SECTION, rig=rig, preset=settings.preset)
        self._refresh()

    def choose(self, step: Step) -> None:
        """Turn to a step."""
        if step is not self.step:
            self.session.candidate = None
        self.step = step
        self._refresh()

    def measure(self) -> None:
        """Measure the step live, in a thread of its own."""
        with told():
            guided = GuidedCalibration(self.connection.require(), self.form.voltages.value())
            measured = partial(measure_live, guided, self.step, self.draft, self.form.target_um, self._live_source())
            self.work.begin(0, self._excusing(measured), self._found)
        self._refresh()

    def watch(self) -> None:
        """Measure the slit offset again and again until pressed once more; the last one may then be accepted."""
        if self._watching is not None:
            self._watching.stop()
            return
        with told():
            guided = GuidedCalibration(self.connection.require())
            self._watching = Watching(guided, self.draft, self.form.target_um, self._live_source())
            self.work.begin(0, self._excusing(self._watching.run), lambda _: None)
        self._refresh()

    def measure_file(self, path: str | Path, volts: str | Path | None = None) -> None:
        """Measure the step from a recording, in a thread of its own."""
        given = None if volts is None else Path(volts)
        form, watch = self.form, self.work.watch
        measured = partial(measure_recorded, Path(path), given, self.step, self.draft, form.target_um, watch)
        self.work.begin(0, measured, self._found)
        self._refresh()

    def accept(self) -> None:
        """Take what was found into the calibration, and the calibration into force."""
        with told():
            if self.session.accept(self.step):
                self.sharing.offer(self.draft.calibration)
        self._refresh()

    def discard(self) -> None:
        """Forget what was found; the calibration stays as it was."""
        self.session.candidate = None
        self._refresh()

    def undo(self) -> None:
        """Go back to the calibration before the last step was accepted."""
        if self.session.undo():
            self.sharing.offer(self.draft.calibration)
        self._refresh()

    def load(self, path: str | Path) -> None:
        """Read a calibration and take it into force."""
        with told():
            calibration = read_calibration(path)
            self.session.begin_with(calibration)
            self.sharing.offer(self.draft.calibration, Path(path))
            set_active_calibration(path)
            show_info(f"{Path(path).name}: {summary(calibration)}")
        self._refresh()

    def save(self, path: str | Path) -> None:
        """Write the calibration, and show recordings that have none of their own with it from now on."""
        with told():
            written = write_calibration(path, self.draft.calibration, force=True)
            set_active_calibration(written)
            self.sharing.offer(self.draft.calibration, written)
            show_info(f"saved {written.name}: {summary(self.draft.calibration)}")

    def save_plots(self, path: str | Path) -> None:
        """Save what the step shows: pictures to NAME.png, numbers to NAME.csv; a second plot to NAME-2."""
        with told():
            path = Path(path)
            shown = [plot for plot in self.form.plots if plot.curves]
            if not shown:
                raise InputError(f"nothing is plotted of the {self.step}", "measure it first")
            for number, plot in enumerate(shown, 1):
                plot.save(path if number == 1 else path.with_stem(f"{path.stem}-{number}"))

    def copy_script(self) -> None:
        """Copy Python that makes this calibration again to the clipboard."""
        with told():
            copy_as_script(calibration_script(self.session.sources, self.draft.bundle_um))

    def cleanup(self) -> None:
        """Stop measuring, take the layers away, let go of the engine and the viewer."""
        if self._left:
            return
        self._left = True
        self._poll.stop()
        self.work.cancel()
        show_bundle(self.viewer, None, self.draft)
        self.connection.leave()
        super().cleanup()

    # inside

    def _wire(self) -> None:
        form = self.form
        remembered = recall(SECTION)
        form.remembered(remembered.get("rig", SIMULATED), remembered.get("preset", "240hz"))
        form.connect_button.clicked.connect(self.connect_rig)
        form.measure.clicked.connect(self.measure)
        form.watch.clicked.connect(self.watch)
        form.accept.clicked.connect(self.accept)
        form.discard.clicked.connect(self.discard)
        form.undo.clicked.connect(self.undo)
        form.from_file.clicked.connect(self._ask_for_recording)
        for button in form.steps.values():
            button.clicked.connect(self._step_clicked)
        form.load.clicked.connect(self._ask_what_to_load)
        form.save.clicked.connect(self._ask_where_to_save)
        form.save_plots.clicked.connect(self._ask_where_to_save_plots)
        form.script.clicked.connect(self.copy_script)
        self.listen(self.viewer.events.theme, self._theme_changed)

    def _live_source(self) -> MeasurementSource:
        form = self.form
        return MeasurementSource(
            self.step,
            rig=self.connection.rig or "",
            preset=form.preset.currentText(),
            voltages=form.voltages.value(),
        )

    def _step_clicked(self) -> None:
        self.choose(next(step for step, button in self.form.steps.items() if button is self.sender()))

    def _excusing(self, work: Callable[[], T]) -> Callable[[], T]:
        """Make work for the thread that says nothing of an error which the user has asked for, by Cancel or the end."""

        def excused() -> T:
            try:
                return work()
            except ElsPlusError as error:
                if isinstance(error, InputError) or self._left:
                    self.work.stop_if_cancelled()
                raise

        return excused

    def _work_ended(self) -> None:
        if self._left:  # the dock is gone, and only the work still held the panel
            self.deleteLater()
        else:
            self._refresh()

    def _connected(self, setup: Setup) -> None:
        self._setup = setup
        self.sharing.offer(self.draft.calibration)

    def _set_up_anew(self, done: Future[Setup]) -> None:
        """Not in the window's thread: note that another panel has changed how frames are taken."""
        if done.exception() is None:
            self._setup, self._changed = done.result(), True

    def _found(self, shown: ShownResult) -> None:
        self.choose(step_of(shown.found))
        self.session.candidate = shown

    def _cancel(self) -> None:
        if self._watching is not None:
            self._watching.stop()
        client = self.connection.client
        if client is not None and self.work.busy:
            client.cancel()

    def _look(self) -> None:
        """Ask how far it is, and what the line does; twenty times a second."""
        if not self.work.busy and (shared := self.sharing.news(self.draft.calibration)) is not None:
            self.session.begin_with(shared)
            self._refresh()
        if (refusal := self.sharing.refusal()) is not None:
            show_error(str(refusal))
        client = self.connection.client
        progress = None if client is None else client.status.progress
        if self._watching is not None:
            self.work.tell("watching", 0, 0)
        elif self.work.busy and progress is not None:
            self.work.tell(progress.step, progress.done, progress.total)
        stale = {} if client is None else dict(client.status.stale)
        if client is not None and stale != self._stale and not self.work.busy:
            self._stale = stale
            client.setup().add_done_callback(self._set_up_anew)
        if self._changed:
            self._changed = False
            self._refresh()
        if self._watching is not None:
            self._show_watched(self._watching)

    def _show_watched(self, watching: Watching) -> None:
        watching.target_um = self.form.target_um
        watched = watching.newest()
        if isinstance(watched, str):
            self.form.say(watched)
        elif watched is not None and self.step is Step.OFFSET:
            self.session.candidate = watched
            self.form.show_picture(watched.picture, numbers=watching.readings % NUMBERS_EVERY == 1)

    def _refresh(self) -> None:
        """Show the step, its state, and what may be done now."""
        form, busy = self.form, self.work.busy
        if not busy:
            self._watching = None
        connected = self.connection.client is not None
        form.show_states({step: self.draft.state(step, self._setup) for step in Step}, self.step)
        prepare = PREPARE[self.step]
        if connected and self.connection.rig == SIMULATED:
            prepare += f" {SIMULATED_TARGETS}"
        form.explain(EXPLAINED[self.step], prepare)
        shown = self.session.shown(self.step)
        form.show_picture(None if shown is None else shown.picture)
        form.allow(
            step=self.step,
            connected=connected,
            busy=busy,
            watching=self._watching is not None,
            needs=self.draft.needs(self.step),
            candidate=self.candidate is not None,
            past=self.session.past,
            scripted=bool(self.session.sources),
            state=self.draft.state(self.step, self._setup)[0],
        )
        if shown is None and self.draft.state(self.step)[0] is not StepState.MISSING:
            form.say("known from a file; measure it to see more")
        show_bundle(self.viewer, shown, self.draft)

    def _theme_changed(self) -> None:
        self.form.follow(self.viewer.theme)
        self._refresh()

    def _ask_for_recording(self) -> None:
        frames, volts = dialogs.recording_for(self, self.step)
        if frames:
            self.measure_file(frames, volts or None)

    def _ask_what_to_load(self) -> None:
        if path := dialogs.calibration_to_load(self):
            self.load(path)

    def _ask_where_to_save(self) -> None:
        if path := dialogs.where_to_save(self):
            self.save(path)

    def _ask_where_to_save_plots(self) -> None:
        if path := dialogs.where_to_save_plots(self, self.step):
            self.save_plots(path)
