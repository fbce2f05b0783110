"""The Mosaic panel: a stack, or the live stream, to mosaics that grow on screen, with the probe's track over them."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from napari.utils.notifications import show_info, show_warning
from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QFileDialog

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.rig import SIMULATED
from napari_elsplus.io import read_calibration
from napari_elsplus.io.formats.registry import dialog_filter, recordings_filter
from napari_elsplus.io.formats.tiff import TIFF
from napari_elsplus.viewing.mosaic.files import mosaic_script, save_mosaics
from napari_elsplus.viewing.mosaic.live import LiveMosaicView
from napari_elsplus.viewing.mosaic.recorded import StackMosaics
from napari_elsplus.viewing.mosaic.track import speed_of
from napari_elsplus.widgets.live.rig import remembered_rig, remembered_settings
from napari_elsplus.widgets.live.status import advice_on
from napari_elsplus.widgets.mosaic.form import MosaicForm
from napari_elsplus.widgets.mosaic.layers import MosaicLayers
from napari_elsplus.widgets.mosaic.sources import MosaicSource, source_of
from napari_elsplus.widgets.shared.choosing import chosen_image, renew_choices
from napari_elsplus.widgets.shared.engine_panel import EnginePanel
from napari_elsplus.widgets.shared.layer_list import LayerList
from napari_elsplus.widgets.shared.panel import copy_as_script, told
from napari_elsplus.widgets.shared.work import Work

if TYPE_CHECKING:
    from collections.abc import Callable

    import napari.viewer
    from napari.layers import Image

    from napari_elsplus.acquisition.link.client import EngineClient

TICK_MS: Final = 40
WHOLE_TICKS: Final = 25
"""The track, the maps and what else costs more is drawn every so many ticks."""


class MosaicPanel(EnginePanel):
    """Lay the frames of a moving probe into mosaics.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer. Layers of mosaics are used again, with the user's colours; they stay when the panel goes.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer)
        self.layers = MosaicLayers(viewer, LayerList(self).undisturbed)
        self.work = Work(self._ended)
        self._stack: StackMosaics | None = None
        self._shown: StackMosaics | LiveMosaicView | None = None
        self._source: MosaicSource | None = None
        self._hidden: list[Any] = []
        self._ticks = 0
        self._stale = False
        self._goes_live, self._cleared = True, ""
        self.form = MosaicForm(self, self.work, viewer)
        self.form.connect(
            {
                "start": self.toggle,
                "live": self.toggle_live,
                "clear": self.clear,
                "undo": self.undo,
                "save": self._ask_where_to_save,
            },
            {"open": self._ask_for_file, "script": self.copy_script},
        )
        self._timer = QTimer(self)
        self._timer.setInterval(TICK_MS)
        self._timer.timeout.connect(self.tick)
        self._timer.start()
        self.listen(viewer.layers.events.inserted, self._layers_changed)
        self.listen(viewer.layers.events.removed, self._layers_changed)
        self.listen(viewer.events.theme, self._theme_changed)
        self._layers_changed()

    def toggle(self) -> None:
        """Make mosaics of the chosen stack; or stop that."""
        if self.work.busy:
            self.work.cancel()
        else:
            self.begin()
        self.refresh()

    def begin(self) -> None:
        """Make mosaics of the chosen stack, in a thread."""
        with told():
            plan, chosen = self.form.plan, self._chosen()
            _ = plan.tracked
            calibration = self.form.calibration.value
            path = calibration if isinstance(calibration, Path) and calibration.is_file() else None
            source = source_of(chosen, None if path is None else read_calibration(path), path)
            plan = source.plan(plan)
            self.form.remember()

            def made() -> StackMosaics:
                mosaics = StackMosaics(source.frames, source.calibration, plan, source.times_s)
                mosaics.rehearse()
                self._stack = mosaics  # from now on it is looked at
                mosaics.run(self.work.watch, self.work.stop_if_cancelled)
                return mosaics

            self._leave_live()
            self._goes_live = False
            self._stack, self._source = None, source
            self._hide_others()
            self._shown = None
            self.work.begin(source.steps(plan), made, self._made)

    @property
    def live(self) -> bool:
        """Whether the engine lays its frames into a mosaic."""
        client = self.connection.client
        track = None if client is None else client.status.track
        return track is not None and track.running

    def toggle_live(self) -> None:
        """Lay the live stream into a mosaic, connecting and starting first where that is needed; or stop that."""
        self._goes_live = True
        client = self.connection.client
        if client is not None and client.status.progress is not None:
            self.asking.ask(client.cancel())
        elif client is not None and self.live:
            self.asking.ask(client.track(None))
        elif client is not None:
            self._start_live(client)
        else:
            rig, settings = remembered_rig(), remembered_settings()
            self.asking.do(lambda: self.connection.connect(rig, settings), self._start_live)
        self.refresh()

    def tick(self) -> None:
        """Show what came since the last time."""
        self._ticks += 1
        self._follow_live()
        if self._stack is not None and self._stack is not self._shown:
            self._shown = self._stack
            assert self._source is not None
            self.layers.show(self._shown, self._shown.plan.tracked, self._source.titles)
        shown = self._shown
        self._stale |= shown.update() if isinstance(shown, LiveMosaicView) else self.work.busy
        self._stale |= self.layers.behind
        whole = self._ticks % WHOLE_TICKS == 0
        if shown is not None and self._stale:
            self.layers.update(whole=whole)
            self._stale = not whole
        if self._ticks % WHOLE_TICKS == WHOLE_TICKS // 2:
            self.refresh()  # at another tick: either holds the window's thread for a while

    def clear(self) -> None:
        """Take the mosaics away, and show again what was hidden."""
        if self.work.busy:
            self.work.cancel()
        client = self.connection.client
        if client is not None and client.status.track is not None:
            self._cleared = client.status.track.board
            self.asking.ask(client.clear_mosaic())
        self._leave_live()
        self._stack = self._shown = None
        self.layers.forget()
        for layer in self._hidden:
            if layer in self.viewer.layers:
                layer.visible = True
        self._hidden = []
        self.form.speed.show_speed(None)
        self.refresh()

    def undo(self) -> None:
        """Take the last segment away."""
        shown = self._shown
        if shown is None or self.work.busy:
            return
        client = self.connection.client
        if isinstance(shown, LiveMosaicView) and shown.follows and client is not None:
            self.asking.ask(client.undo_segment(), _tell_if_none)
            return
        _tell_if_none(shown.undo())
        self.layers.update(whole=True)
        self.refresh()

    def save(self, path: Path) -> None:
        """Save mosaics, pictures and track; files that belong to one that exists are replaced with it."""
        with told():
            if self._shown is None:
                raise InputError("there is no mosaic to save", "make one first")
            shown = self._shown
            if self.work.busy:
                raise InputError("the mosaic still grows", "wait for its end, or cancel it")
            if isinstance(shown, LiveMosaicView):
                self._stale |= shown.update(all_rows=True)
            self.work.begin(
                0,
                lambda: save_mosaics(shown, path, shown.plan, shown.calibration, force=path.exists()),
                lambda paths: show_info("saved " + ", ".join(one.name for one in paths)),
            )
            self.refresh()

    def copy_script(self) -> None:
        """Copy Python that makes and saves these mosaics to the clipboard."""
        with told():
            path = self.form.calibration.value
            given = path if isinstance(path, Path) and path.is_file() else None
            facts = self._chosen().metadata.get("elsplus", {})
            if facts.get("kind") != "raw":
                raise InputError("these images are no raw recording", "a script can be had for raw recordings")
            copy_as_script(mosaic_script(facts["stack"], given or facts.get("calibration_path"), self.form.plan))

    def refresh(self) -> None:
        """Say how it goes, and what can be done."""
        busy, there = self.work.busy, self._shown is not None
        client = self.connection.client
        calibrating = client is not None and client.status.progress is not None
        self.form.allow(busy=busy, asking=self.asking.busy, there=there, live=self.live, calibrating=calibrating)
        self.form.status.setText(self._said())
        if self._shown is not None:
            scale = self._shown.scale
            self.form.speed.show_speed(speed_of(self._shown.rows, scale.fastest_px, scale.camera_um_per_px))

    def cleanup(self) -> None:
        """Let go of the viewer; the layers stay."""
        self._timer.stop()
        if self.work.busy:
            self.work.cancel()
        self._leave_live()
        super().cleanup()

    # inside

    def _start_live(self, client: EngineClient) -> None:
        if client.calibration is None and self.connection.rig == SIMULATED:
            self.asking.ask(client.calibrate_simulated(), lambda _: self._start_live(client))
        elif not client.status.live:
            self._track(client, lambda _: self.asking.ask(client.start()))  # compiled before the first frame comes
        else:
            self._track(client)

    def _track(self, client: EngineClient, then: Callable[[None], None] = lambda _: None) -> None:
        with told():
            plan = self.form.plan
            self.form.remember()
            self.asking.ask(client.track(plan), then)

    def _follow_live(self) -> None:
        """Look at the engine's mosaic where there is a new one; at none where the engine is gone."""
        client = self.connection.client
        track = None if client is None else client.status.track
        shown = self._shown if isinstance(self._shown, LiveMosaicView) else None
        if client is None or track is None:
            if shown is not None and shown.follows:
                shown.update(all_rows=True)
                shown.close()
            return
        known = track.board == self._cleared or (shown is not None and shown.board == track.board)
        if known or not track.running or not self._goes_live:
            return
        try:
            live = LiveMosaicView(track, client.calibration)
        except FileNotFoundError:  # replaced a moment ago; the next status says by what
            return
        self._leave_live()
        self._stack, self._shown = None, live
        self.layers.show(live, live.plan.tracked)

    def _leave_live(self) -> None:
        if isinstance(self._shown, LiveMosaicView):
            self._shown.close()

    def _made(self, mosaics: StackMosaics) -> None:
        for note in mosaics.notes:
            show_warning(note)

    def _ended(self) -> None:
        if self._shown is not None or self._stack is not None:
            self.tick()
            self.layers.update(whole=True)
        self.refresh()

    def _said(self) -> str:
        drawing = self.layers.drawing
        client = self.connection.client
        if client is not None and client.status.progress is not None:
            step = client.status.progress
            return f"Calibrating: {step.step}, {step.done} of {step.total}"
        if self._shown is None or drawing is None:
            waits = self.work.busy or self.asking.busy
            return "Starting..." if waits else "Choose a stack and press Mosaic, or go live."
        counts = self._shown.rows.counts
        total = sum(counts.values())
        words = f"<b>{counts['tracked']}</b> of {total} frames tracked"
        words += f" in {drawing.segments} segments" if drawing.segments > 1 else ""
        words += "".join(f", {counts[state]} {state}" for state in ("predicted", "lost") if counts[state])
        um = self._shown.scale.um_per_px
        area_mm2 = self.layers.covered_px * (um or float("nan")) ** 2 * 1e-6
        words += f"; {area_mm2:.2g} mm\N{SUPERSCRIPT TWO}." if isfinite(area_mm2) else "."
        track = None if client is None or not isinstance(self._shown, LiveMosaicView) else client.status.track
        if track is not None and track.loop_closures:
            words += f" Places recognised {track.loop_closures} times."
        if track is not None and not track.rerenders:
            words += " There is no memory left to lay it anew: where loops close it stays as it is."
        if track is not None and track.running and (advice := advice_on(self.connection.calibration)):
            words += f" {advice}"
        return words

    def _chosen(self) -> Image:
        return chosen_image(self.viewer, self.form.recording, "stack")

    def _hide_others(self) -> None:
        ours = set(self.layers.own.present.values())
        for layer in self.viewer.layers:
            if layer.visible and layer not in ours:
                layer.visible = False
                self._hidden.append(layer)

    def _layers_changed(self) -> None:
        renew_choices(self.form.recording)
        self.refresh()

    def _theme_changed(self) -> None:
        self.form.speed.follow(self.viewer.theme)
        self.refresh()

    def _ask_for_file(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Recording", "", recordings_filter())
        if path:
            self.viewer.open(path, plugin="napari-elsplus")

    def _ask_where_to_save(self) -> None:
        if not self.form.saving.enabled:
            return
        path, _ = QFileDialog.getSaveFileName(self, "Save mosaics", "mosaic.ome.tif", dialog_filter(TIFF, writing=True))
        if path:
            self.save(Path(path))


def _tell_if_none(undone: bool) -> None:
    if not undone:
        show_info("there is no segment left")
