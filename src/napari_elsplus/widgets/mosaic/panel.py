"""The Mosaic panel: mosaics of a stack or of the live stream, displayed while they grow, with the probe's track."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari.utils.notifications import show_info, show_warning

from napari_elsplus._problems import notify_errors
from napari_elsplus._view import HiddenLayers
from napari_elsplus.errors import InputError
from napari_elsplus.io import read_calibration
from napari_elsplus.io.formats.registry import dialog_filter, recordings_filter
from napari_elsplus.io.formats.tiff import TIFF
from napari_elsplus.processing.compilation import compilation_remark
from napari_elsplus.viewing.mosaic.files import finished_script, mosaic_script, save_mosaics
from napari_elsplus.viewing.mosaic.live import LiveMosaicView
from napari_elsplus.viewing.mosaic.recorded import StackMosaics
from napari_elsplus.viewing.mosaic.track import probe_speed
from napari_elsplus.viewing.provenance import provenance_of
from napari_elsplus.widgets.mosaic.form import MosaicForm
from napari_elsplus.widgets.mosaic.layers import MosaicLayers
from napari_elsplus.widgets.mosaic.sources import MosaicSource, source_of
from napari_elsplus.widgets.mosaic.status import mosaic_text, track_text
from napari_elsplus.widgets.shared.choosing import chosen_image, is_uncalibrated
from napari_elsplus.widgets.shared.engine_panel import EnginePanel
from napari_elsplus.widgets.shared.files import choose_file_to_read, choose_file_to_write, note_folder
from napari_elsplus.widgets.shared.panel import copy_as_script, next_hint, timer
from napari_elsplus.widgets.shared.window import closing
from napari_elsplus.widgets.shared.window.layer_list import LayerListModels
from napari_elsplus.widgets.shared.work import Work

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    import napari.viewer
    from napari.layers import Image

    from napari_elsplus.acquisition.link.client import EngineClient
    from napari_elsplus.widgets.shared.requests import Outstanding

TICK_MS: Final = 40
"""Interval at which mosaics are updated, milliseconds; chosen, 25 Hz."""
WHOLE_TICKS: Final = 25
"""Ticks between updates of track, maps and thumbnails, which take longer: one second."""

REMOVED: Final = "its layer was removed: press Save... and open the file, or Clear."
HINT: Final = "select a stack and press Mosaic, or press Live mosaic."


class MosaicPanel(EnginePanel):
    """Insert the frames of a moving probe into mosaics.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer. Layers of mosaics are reused, with the user's colormap; they remain when the panel is closed.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer)
        self.layers = MosaicLayers(viewer, LayerListModels(self).signals_blocked)
        self.work = Work(self._ended)
        self._arrived: tuple[StackMosaics, MosaicSource] | None = None
        self._shown: StackMosaics | LiveMosaicView | None = None
        self._saved: StackMosaics | LiveMosaicView | None = None
        self._hidden = HiddenLayers(viewer)
        self._ticks = 0
        self._stale = False
        self._following_live, self._cleared_board = True, ""
        self._preparation: Outstanding | None = None
        self.form = MosaicForm(self, self.work, viewer)
        self.form.connect(
            {
                "mosaic": self.toggle,
                "live mosaic": self.toggle_live,
                "clear mosaic": self.clear,
                "undo segment": self.undo,
                "save mosaic": self._ask_where_to_save,
            },
            {"open": self._ask_for_file, "script": self.copy_script},
        )
        self._timer = timer(self, TICK_MS, self.tick, starts=True)
        self.form.recording.changed.connect(self.refresh)
        layers = viewer.layers.events
        for signal in (layers.inserted, layers.removed, layers.renamed):
            self.connect_signal(signal, self._layers_changed)
        self.connect_signal(viewer.events.theme, self._theme_changed)
        self._layers_changed()

    def toggle(self) -> None:
        """Make mosaics of the selected stack, or stop."""
        if self.work.busy:
            self.work.cancel()
        else:
            self.begin()
        self.refresh()

    def begin(self) -> None:
        """Make mosaics of the selected stack in a thread; what is displayed remains until the first frame is inserted.

        An unsaved live mosaic is replaced only if the user agrees, since it cannot be made again.
        """
        with notify_errors(self):
            chosen, path = self._chosen(), self.form.calibration_file
            note_folder(provenance_of(chosen.metadata).get("path"))
            given = None if path is None else read_calibration(path)
            source = source_of(chosen, given, path, finished=bool(self.form.finished.value))
            plan = source.plan(self.form.plan)
            _ = plan.tracked
            if isinstance(self._shown, LiveMosaicView) and not self._may_replace("The mosaic of the selected stack"):
                return
            self.form.remember()

            def made() -> StackMosaics:
                mosaics = StackMosaics(
                    source.frames,
                    source.calibration,
                    plan,
                    source.times_s,
                    source.frame_numbers,
                    finished=source.finished,
                    checkpoint=self.work.stop_if_cancelled,
                )
                mosaics.compile_kernels()
                self.work.stop_if_cancelled()
                self._arrived = mosaics, source
                mosaics.run(self.work.progress)
                return mosaics

            self.work.begin(0, made, self._made)

    @property
    def live(self) -> bool:
        """True while the engine inserts frames into a mosaic."""
        client = self.connection.client
        track = None if client is None else client.status.track
        return track is not None and track.running

    @property
    def preparing(self) -> bool:
        """True while the engine prepares a live mosaic; the first one compiles kernels."""
        return self.requests.waits_for(self._preparation)

    def toggle_live(self) -> None:
        """Insert the live stream into a mosaic, connecting and starting first if needed; or cancel that, or stop."""
        client = self.connection.client
        if client is not None and client.status.progress is not None:
            self.requests.follow(client.cancel())
        elif client is not None and self.preparing:
            self._give_up(client)
        elif client is not None and self.live:
            self.requests.follow(client.track(None))
        elif self._may_replace("The new live mosaic"):
            self._following_live = True
            self.prepare_rig(self._start_live)
        self.refresh()

    def tick(self) -> None:
        """Display what is new."""
        self._ticks += 1
        self._follow_live()
        self._show_arrived()
        shown = self._shown
        if isinstance(shown, LiveMosaicView):
            if shown.update():
                self._stale, self._saved = True, None  # what was saved is not all of it any more
        else:
            self._stale |= self.work.busy
        self._stale |= self.layers.behind
        whole = self._ticks % WHOLE_TICKS == 0
        if shown is not None and self._stale:
            self.layers.update(whole=whole)
            self._stale = not whole
        if self._ticks % WHOLE_TICKS == WHOLE_TICKS // 2:
            self.refresh()  # at another tick, because both take long in the window's thread

    def unsaved(self) -> str:
        """Return a question if the mosaic was not saved; else an empty string."""
        lost = self._shown is not None and self._shown is not self._saved
        return "The mosaic was not saved. Discard it?" if lost else ""

    def saving(self) -> bool:
        """Return True while the mosaic is being saved."""
        return self.work.saving

    def clear(self) -> None:
        """Remove the mosaics, and restore hidden layers; an unsaved live mosaic only if the user agrees."""
        if isinstance(self._shown, LiveMosaicView) and not closing.may_discard(self, self.unsaved()):
            return
        if self.work.busy:
            self.work.cancel()
        client = self.connection.client
        if client is not None and client.status.track is not None:
            self._cleared_board = client.status.track.board
            self.requests.follow(client.clear_mosaic())
        self._leave_live()
        self._arrived = self._shown = None
        self.layers.remove()
        self._hidden.restore()
        self.form.speed.show_speed(None)
        self.refresh()

    def undo(self) -> None:
        """Remove the last segment."""
        shown = self._shown
        if shown is None or self.work.busy:
            return
        client = self.connection.client
        if isinstance(shown, LiveMosaicView) and shown.follows and client is not None:
            self.requests.follow(client.undo_segment(), _report_if_none)
            return
        _report_if_none(shown.undo())
        self.layers.update(whole=True)
        self.refresh()

    def save(self, path: Path) -> None:
        """Save mosaics, pictures and track.

        Parameters
        ----------
        path : pathlib.Path
            ``NAME.ome.tif``. If it exists, it and the files saved with it are replaced.
        """
        with notify_errors(self):
            if self._shown is None:
                raise InputError("there is no mosaic to save", "make one first")
            shown = self._shown
            if self.work.busy:
                raise InputError("the mosaic is not finished", "wait until it is, or cancel it")
            if isinstance(shown, LiveMosaicView):
                self._stale |= shown.update(all_rows=True)
            self.work.begin(
                0,
                lambda: save_mosaics(shown, path, shown.plan, shown.calibration, force=path.exists()),
                lambda paths: self._mosaic_saved(shown, paths),
                saves=True,
            )
            self.refresh()

    def copy_script(self) -> None:
        """Copy a script that makes and saves these mosaics to the clipboard."""
        with notify_errors(self):
            given = self.form.calibration_file
            facts = provenance_of(self._chosen().metadata)
            if facts.get("kind") != "raw":
                raise InputError("these images are not a raw recording", "select a raw recording for a script")
            calibration = given or facts.get("calibration_path")
            if calibration is None and self.form.finished.value and is_uncalibrated(self._chosen()):
                copy_as_script(finished_script(facts["stack"], self.form.plan))
            else:
                copy_as_script(mosaic_script(facts["stack"], calibration, self.form.plan))

    def refresh(self) -> None:
        """Update status text and buttons."""
        busy, present = self.work.busy, self._shown is not None
        client = self.connection.client
        calibrating = client is not None and client.status.progress is not None
        cancels = "Cancel calibration" if calibrating else "Cancel" if self.preparing else ""
        self.form.set_enabled(
            busy=busy, saving=self.saving(), requesting=self.waiting, present=present, live=self.live, cancels=cancels
        )
        self.form.status.setText(self._status_text())
        if self._shown is not None:
            scale = self._shown.scale
            speed = probe_speed(self._shown.rows, scale.max_px_per_frame, scale.camera_um_per_px)
            lit = client is not None and not client.status.park_state.parked
            self.form.speed.show_speed(speed, growing=busy or (self.live and lit))

    def cleanup(self) -> None:
        """Release the engine and disconnect from the viewer; the layers remain."""
        self._timer.stop()
        if self.work.busy:
            self.work.cancel()
        self._leave_live()
        super().cleanup()

    def _start_live(self, client: EngineClient) -> None:
        if not client.status.live:
            self._track(client, lambda _: self.start_stream(client))  # kernels are compiled before the first frame
        else:
            self._track(client)

    def _track(self, client: EngineClient, then: Callable[[None], None] = lambda _: None) -> None:
        with notify_errors(self):
            plan = self.form.plan
            self.form.remember()
            self._preparation = self.requests.follow(client.track(plan), then)

    def _give_up(self, client: EngineClient) -> None:
        """Wait no longer for a live mosaic; the engine ends it once it is prepared, the kernels for the next one."""
        assert self._preparation is not None
        self.requests.forget(self._preparation)
        self._following_live = False
        client.track(None)

    def _follow_live(self) -> None:
        """Display the engine's mosaic if there is a new one; keep the last one after the engine's end."""
        client = self.connection.client
        track = None if client is None else client.status.track
        shown = self._shown if isinstance(self._shown, LiveMosaicView) else None
        if client is None or track is None:
            if shown is not None and shown.follows:
                shown.update(all_rows=True)
                shown.close()
            return
        displayed = track.board == self._cleared_board or (shown is not None and shown.board == track.board)
        if displayed or not track.running or not self._following_live:
            return
        try:
            live = LiveMosaicView(track, client.calibration)
        except FileNotFoundError:  # replaced in the meantime; the next status names the new one
            return
        self._leave_live()
        self._shown = live
        self.layers.show(live, live.plan.tracked)

    def _show_arrived(self) -> None:
        """Display the mosaics of a stack, in place of what was displayed, once they contain a frame."""
        if self._arrived is None or not len(self._arrived[0].rows):
            return
        (mosaics, source), self._arrived = self._arrived, None
        self._leave_live()
        self._following_live = False
        self._hidden.hide(self.layers.own.present.values())
        self._shown = mosaics
        self.layers.show(mosaics, mosaics.plan.tracked, source.title)

    def _may_replace(self, by: str) -> bool:
        """Return True if the displayed mosaic was saved, or the user agrees to discard it."""
        return closing.may_discard(self, self.unsaved(), f"{by} replaces the one displayed.")

    def _leave_live(self) -> None:
        if isinstance(self._shown, LiveMosaicView):
            self._shown.close()

    def _mosaic_saved(self, saved: StackMosaics | LiveMosaicView, paths: Sequence[Path]) -> None:
        self._saved = saved
        show_info("saved " + ", ".join(one.name for one in paths))

    def _made(self, mosaics: StackMosaics) -> None:
        for note in mosaics.notes:
            show_warning(note)

    def _ended(self) -> None:
        if self._shown is not None or self._arrived is not None:
            self.tick()
            self.layers.update(whole=True)
        self._arrived = None  # ended before its first frame
        self.refresh()

    def _status_text(self) -> str:
        drawing, client = self.layers.drawing, self.connection.client
        status = None if client is None else client.status
        calibration = self.connection.calibration
        if status is not None and status.progress is not None:
            return f"Calibrating: {status.progress}"
        if self._shown is None or drawing is None:
            if status is not None and status.compiling:
                return compilation_remark(status.compiling).capitalize()
            return "Starting..." if self.work.busy or self.waiting else next_hint(HINT)
        text = mosaic_text(self._shown, drawing.segments, self.layers.covered_px, busy=self.work.busy)
        if status is not None and isinstance(self._shown, LiveMosaicView):
            text += track_text(status, calibration)
        return f"{text}<br>{next_hint(REMOVED)}" if self.layers.removed else text

    def _chosen(self) -> Image:
        return chosen_image(self.form.recording, "stack")

    def _layers_changed(self) -> None:
        self.form.recording.refresh(newest=not self.work.busy)
        self.refresh()

    def _theme_changed(self) -> None:
        self.form.speed.apply_theme(self.viewer.theme)
        self.refresh()

    def _ask_for_file(self) -> None:
        choose_file_to_read(self, "Recording", recordings_filter(), self.open_dropped)

    def _ask_where_to_save(self) -> None:
        kinds = dialog_filter(TIFF, writing=True)
        choose_file_to_write(self, "Save mosaics", "mosaic.ome.tif", kinds, self.save)


def _report_if_none(undone: bool) -> None:
    if not undone:
        show_info("no segment left")
