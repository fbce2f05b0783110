"""The Calibration panel: leads through the steps, live on a rig or from files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from time import perf_counter, sleep
from typing import TYPE_CHECKING, Final, NamedTuple

from napari.utils.notifications import show_error, show_info
from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QFileDialog

from napari_elsplus.acquisition.guided import GuidedCalibration
from napari_elsplus.acquisition.status import Settings
from napari_elsplus.errors import ElsPlusError, InputError, MeasurementError
from napari_elsplus.hardware.rigs import SIMULATED
from napari_elsplus.io import open_recording, read_calibration, read_volts, write_calibration
from napari_elsplus.processing.calibration.draft import Draft, Found, LitPair, Setup, State, Step, step_of
from napari_elsplus.processing.calibration.stepwise import measure_step, setup_of
from napari_elsplus.settings import put_in_force, recall, remember
from napari_elsplus.viewing.calibration_script import Source, calibration_script
from napari_elsplus.viewing.outlines import outline_layer, summary
from napari_elsplus.widgets.calibration.explained import EXPLAINED, PREPARE
from napari_elsplus.widgets.calibration.explained import SIMULATED as SIMULATED_TARGETS
from napari_elsplus.widgets.calibration.form import Form
from napari_elsplus.widgets.calibration.pictures import Picture, picture
from napari_elsplus.widgets.connection import join
from napari_elsplus.widgets.panel import Panel, copy_as_script, told
from napari_elsplus.widgets.window_end import WindowEnd
from napari_elsplus.widgets.work import Work

if TYPE_CHECKING:
    from concurrent.futures import Future

    import napari.viewer

    from napari_elsplus.calibration import Calibration

POLL_MS: Final = 50
NUMBERS_EVERY: Final = 8
"""Readings from one renewal of the numbers to the next: nobody reads them with both hands on the mirror."""
LOOK_S: Final = 0.04
"""The engine measures the offset in every frame; nobody reads more than so often."""
SECTION: Final = "calibration"
IMAGE, OUTLINES = "calibration: bundle", "calibration: outlines"


class Shown(NamedTuple):
    """What a step found, what it was measured with, how it is shown, and where its frames came from."""

    found: Found
    setup: Setup
    picture: Picture
    source: Source


class CalibrationPanel(Panel):
    """Calibrate step by step: measure, look, accept or discard, undo; save and load.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer; the bundle's image and its outlines are shown in it while the bundle pair is looked at.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer)
        self.draft = Draft()
        self.step = Step.OFFSET
        self.candidate: Shown | None = None
        self._accepted: dict[Step, Shown] = {}
        self._past: list[tuple[Draft, dict[Step, Shown]]] = []
        self._setup: Setup | None = None
        self._watched: Shown | str | None = None
        self._watching = self._left = False
        self._window_end = WindowEnd(self, self.cleanup)
        self._refused: BaseException | None = None
        self._stale: dict[str, str] = {}
        self._readings = 0
        self._changed = False
        self._shared: Calibration | None = None
        self._asked: Future[None] | None = None
        self.connection = join()
        self.work = Work(self._work_ended, self._cancel)
        self.form = Form(self, self.work, viewer.theme)
        self._wire()
        self._poll = QTimer(self)
        self._poll.setInterval(POLL_MS)
        self._poll.timeout.connect(self._look)
        self._poll.start()
        self._refresh()

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
            self.candidate = None
        self.step = step
        self._refresh()

    def measure(self) -> None:
        """Measure the step live, in a thread of its own."""
        with told():
            guided = GuidedCalibration(self.connection.require(), self.form.voltages.value())
            step, draft, target_um, source = self.step, self.draft, self.form.target.value(), self._live_source()

            def work() -> Shown:
                setup = guided.setup()
                try:
                    found = guided.measure(step, draft)
                except ElsPlusError as error:
                    self._excuse(error)
                    raise
                return Shown(found, setup, picture(found, draft, setup, target_um), source)

            self.work.begin(0, work, self._found)
        self._refresh()

    def watch(self) -> None:
        """Measure the slit offset again and again until pressed once more; the last one may then be accepted."""
        if self._watching:
            self._watching = False
            return
        with told():
            guided, draft, source = GuidedCalibration(self.connection.require()), self.draft, self._live_source()
            self._watching, self._watched, self._readings = True, None, 0

            def work() -> None:
                setup, begun = guided.setup(), perf_counter()
                try:
                    for count, found in guided.watch_offset(draft, lambda: self._watching):
                        if count == 1:
                            begun = perf_counter()
                        if isinstance(found, MeasurementError):
                            self._watched = str(found)
                        else:
                            shown = picture(found, draft, setup, self.form.target_um)
                            rate = f"{(count - 1) / max(perf_counter() - begun, 1e-3):.0f} measurements a second"
                            self._watched = Shown(found, setup, replace(shown, lines=[*shown.lines, rate]), source)
                        sleep(LOOK_S)
                except ElsPlusError as error:
                    self._excuse(error)
                    raise

            self.work.begin(0, work, lambda _: None)
        self._refresh()

    def measure_file(self, path: str | Path, volts: str | Path | None = None) -> None:
        """Measure the step from a recording, in a thread of its own."""
        step, draft, target_um = self.step, self.draft, self.form.target.value()

        def work() -> Shown:
            with open_recording(path) as frames:
                if len(frames) == 0:
                    raise InputError(f"{Path(path).name} holds 0 frames", "choose another file")
                given = None if volts is None else read_volts(volts)
                setup = setup_of(frames)
                found = measure_step(step, frames, draft, given, self.work.watch)
            source = Source(step, Path(path), None if volts is None else Path(volts))
            return Shown(found, setup, picture(found, draft, setup, target_um), source)

        self.work.begin(0, work, self._found)
        self._refresh()

    def accept(self) -> None:
        """Take what was found into the calibration, and the calibration into force."""
        if self.candidate is None:
            return
        with told():
            draft = self.draft.take(self.candidate.found, self.candidate.setup)
            self._past.append((self.draft, dict(self._accepted)))
            self._accepted.pop(self.step, None)  # the order in which steps were accepted is the script's
            self._accepted[self.step] = self.candidate
            self.candidate = None
            self._take(draft)
        self._refresh()

    def discard(self) -> None:
        """Forget what was found; the calibration stays as it was."""
        self.candidate = None
        self._refresh()

    def undo(self) -> None:
        """Go back to the calibration before the last step was accepted."""
        if self._past:
            self.candidate = None
            draft, self._accepted = self._past.pop()
            self._take(draft)
        self._refresh()

    def load(self, path: str | Path) -> None:
        """Read a calibration and take it into force."""
        with told():
            calibration = read_calibration(path)
            self._past.append((self.draft, dict(self._accepted)))
            self.candidate, self._accepted = None, {}
            self._take(Draft(calibration, bundle_um=self.draft.bundle_um), Path(path))
            put_in_force(path)
            show_info(f"{Path(path).name}: {summary(calibration)}")
        self._refresh()

    def save(self, path: str | Path) -> None:
        """Write the calibration, and show recordings that have none of their own with it from now on."""
        with told():
            written = write_calibration(path, self.draft.calibration, force=True)
            put_in_force(written)
            self._take(self.draft, written)
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
            sources = [shown.source for shown in self._accepted.values()]
            copy_as_script(calibration_script(sources, self.draft.bundle_um))

    def cleanup(self) -> None:
        """Stop measuring, take the layers away, let go of the engine and the viewer."""
        if self._left:
            return
        self._left = True
        self._poll.stop()
        self.work.cancel()
        self._show_bundle(None)
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

    def _live_source(self) -> Source:
        form = self.form
        return Source(
            self.step,
            rig=self.connection.rig or "",
            preset=form.preset.currentText(),
            voltages=form.voltages.value(),
        )

    def _step_clicked(self) -> None:
        self.choose(next(step for step, button in self.form.steps.items() if button is self.sender()))

    def _excuse(self, error: ElsPlusError) -> None:
        """In the thread: say nothing of an error that the user has asked for, by Cancel or by closing the panel."""
        if isinstance(error, InputError) or self._left:
            self.work.stop_if_cancelled()

    def _work_ended(self) -> None:
        if self._left:  # the dock is gone, and only the work still held the panel
            self.deleteLater()
        else:
            self._refresh()

    def _connected(self, setup: Setup) -> None:
        self._setup = setup
        self._take(self.draft)

    def _set_up_anew(self, done: Future[Setup]) -> None:
        """Not in the window's thread: note that another panel has changed how frames are taken."""
        if done.exception() is None:
            self._setup, self._changed = done.result(), True

    def _found(self, shown: Shown) -> None:
        self.choose(step_of(shown.found))
        self.candidate = shown

    def _take(self, draft: Draft, path: Path | None = None) -> None:
        """Keep a draft, and let the other panels and the engine work by it."""
        self.draft = draft
        if draft.calibration.bundle is not None:
            self._asked = self.connection.take(draft.calibration, path)
            self._asked.add_done_callback(lambda done: setattr(self, "_refused", done.exception()))

    def _follow(self) -> None:
        """Take over a calibration that another panel has loaded or measured."""
        shared = self.connection.calibration
        if shared is self._shared or self.work.busy or not (self._asked is None or self._asked.done()):
            return
        self._shared = shared
        if shared is None or shared is self.draft.calibration:
            return
        self._past.append((self.draft, dict(self._accepted)))
        self.candidate, self._accepted = None, {}
        self.draft = Draft(shared, bundle_um=self.draft.bundle_um)
        self._refresh()

    def _cancel(self) -> None:
        self._watching = False
        client = self.connection.client
        if client is not None and self.work.busy:
            client.cancel()

    def _look(self) -> None:
        """Ask how far it is, and what the line does; twenty times a second."""
        self._follow()
        if self._refused is not None:
            error, self._refused = self._refused, None
            show_error(str(error))
        client = self.connection.client
        progress = None if client is None else client.status.progress
        if self._watching:
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
        watched, self._watched = self._watched, None
        if isinstance(watched, str):
            self.form.say(watched)
        elif watched is not None and self.step is Step.OFFSET:
            self.candidate = watched
            self._readings += 1
            self.form.show_picture(watched.picture, numbers=self._readings % NUMBERS_EVERY == 1)

    def _refresh(self) -> None:
        """Show the step, its state, and what may be done now."""
        form, busy = self.form, self.work.busy
        if not busy:
            self._watching = False
        connected = self.connection.client is not None
        form.show_states({step: self.draft.state(step, self._setup) for step in Step}, self.step)
        prepare = PREPARE[self.step]
        if connected and self.connection.rig == SIMULATED:
            prepare += f" {SIMULATED_TARGETS}"
        form.explain(EXPLAINED[self.step], prepare)
        shown = self.candidate or self._accepted.get(self.step)
        form.show_picture(None if shown is None else shown.picture)
        form.allow(
            step=self.step,
            connected=connected,
            busy=busy,
            watching=self._watching,
            needs=self.draft.needs(self.step),
            candidate=self.candidate is not None,
            past=bool(self._past),
            scripted=bool(self._accepted),
            state=self.draft.state(self.step, self._setup)[0],
        )
        if shown is None and self.draft.state(self.step)[0] is not State.MISSING:
            form.say("known from a file; measure it to see more")
        self._show_bundle(shown)

    def _show_bundle(self, shown: Shown | None) -> None:
        """Show the bundle's image with both discs outlined while the bundle pair is looked at."""
        lit = shown.found if shown is not None and isinstance(shown.found, LitPair) else None
        for name in (IMAGE, OUTLINES):
            if name in self.viewer.layers:
                self.viewer.layers.remove(name)
        if lit is None or shown is None:
            return
        accepted = self.draft if self.draft.found.get(Step.PAIR) is lit else self.draft.take(lit, shown.setup)
        data, attributes, _ = outline_layer(accepted.calibration, OUTLINES)
        placed = {key: attributes[key] for key in ("scale", "units") if key in attributes}
        self.viewer.add_image(lit.image, name=IMAGE, **placed)
        self.viewer.add_shapes(data, **attributes)

    def _theme_changed(self) -> None:
        self.form.follow(self.viewer.theme)
        self._refresh()

    def _ask_for_recording(self) -> None:
        kinds = "Recordings (*.tif *.tiff *.avi *.npy);;All files (*)"
        path, _ = QFileDialog.getOpenFileName(self, f"Frames for the {self.step}", "", kinds)
        if not path:
            return
        volts = None
        if self.step is Step.GALVO:
            volts, _ = QFileDialog.getOpenFileName(self, "Voltages, one per frame", "", "Table (*.csv)")
        self.measure_file(path, volts or None)

    def _ask_what_to_load(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Load a calibration", "", "Calibration (*.json)")
        if path:
            self.load(path)

    def _ask_where_to_save(self) -> None:
        path, _ = QFileDialog.getSaveFileName(self, "Save the calibration", "calibration.json", "Calibration (*.json)")
        if path:
            self.save(path)

    def _ask_where_to_save_plots(self) -> None:
        path, _ = QFileDialog.getSaveFileName(
            self, "Save the plots", f"{self.step}.png", "Picture (*.png);;Table (*.csv)"
        )
        if path:
            self.save_plots(path)
