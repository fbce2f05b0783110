"""The Mosaic panel: a stack, or the live stream, to mosaics that grow on screen, with the probe's track over them."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from magicgui.types import FileDialogMode
from magicgui.widgets import CheckBox, ComboBox, Container, FileEdit, PushButton
from napari.utils.notifications import show_info, show_warning
from qtpy.QtCore import QTimer
from qtpy.QtGui import QKeySequence, QShortcut  # type: ignore[attr-defined] # where Qt 6 has it
from qtpy.QtWidgets import QFileDialog, QLabel, QVBoxLayout

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.rigs import SIMULATED
from napari_elsplus.io import read_calibration
from napari_elsplus.mosaic_plan import MosaicPlan
from napari_elsplus.processing.mosaicing.mosaic import Insertion
from napari_elsplus.processing.sectioning import Mode
from napari_elsplus.settings import recall, remember
from napari_elsplus.tracking_pipeline import Method
from napari_elsplus.viewing.layers import TITLES
from napari_elsplus.viewing.live_mosaic import LiveMosaics
from napari_elsplus.viewing.mosaic_files import mosaic_script, save_mosaics
from napari_elsplus.viewing.mosaicking import StackMosaics
from napari_elsplus.viewing.track import speed_of
from napari_elsplus.widgets.choosing import chosen_image, renew_choices
from napari_elsplus.widgets.engine_panel import EnginePanel
from napari_elsplus.widgets.layer_list import LayerList
from napari_elsplus.widgets.mosaic_layers import MosaicLayers
from napari_elsplus.widgets.mosaic_sources import Source, source_names, source_of
from napari_elsplus.widgets.panel import copy_as_script, told
from napari_elsplus.widgets.rig import remembered_rig, remembered_settings
from napari_elsplus.widgets.speed_bar import SpeedBar
from napari_elsplus.widgets.work import Work

if TYPE_CHECKING:
    from collections.abc import Callable

    import napari.viewer
    from napari.layers import Image

    from napari_elsplus.acquisition.client import EngineClient

SECTION: Final = "mosaic"
TICK_MS: Final = 40
WHOLE_TICKS: Final = 25
"""The track, the maps and what else costs more is drawn every so many ticks."""
KEYS: Final = {
    "start": "Ctrl+Shift+M",
    "live": "Ctrl+Shift+L",
    "clear": "Ctrl+Shift+K",
    "undo": "Ctrl+Shift+U",
    "save": "Ctrl+Shift+E",
}
MODES: Final = (Mode.LS, Mode.ELSA, Mode.ELS)


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
        self._shown: StackMosaics | LiveMosaics | None = None
        self._source: Source | None = None
        self._hidden: list[Any] = []
        self._ticks = 0
        self._stale = False
        self._goes_live, self._cleared = True, ""
        self._build()
        self._timer = QTimer(self)
        self._timer.setInterval(TICK_MS)
        self._timer.timeout.connect(self.tick)
        self._timer.start()
        self.listen(viewer.layers.events.inserted, self._layers_changed)
        self.listen(viewer.layers.events.removed, self._layers_changed)
        self.listen(viewer.events.theme, self._theme_changed)
        self._layers_changed()

    @property
    def plan(self) -> MosaicPlan:
        """What the form asks for."""
        modes = tuple(mode for mode, box in self.modes.items() if box.value)
        return MosaicPlan(modes, Method(self.method.value), Insertion(self.insertion.value))

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
            plan, chosen = self.plan, self._chosen()
            _ = plan.tracked
            calibration = self.calibration.value
            path = calibration if isinstance(calibration, Path) and calibration.is_file() else None
            source = source_of(chosen, None if path is None else read_calibration(path), path)
            plan = source.plan(plan)
            self._remember()

            def made() -> StackMosaics:
                self._stack = mosaics = StackMosaics(source.frames, source.calibration, plan, source.times_s)
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
        """Lay the live stream into a mosaic, connecting and starting first where that is needed; or let it rest."""
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
        self._stale |= shown.update() if isinstance(shown, LiveMosaics) else self.work.busy
        whole = self._ticks % WHOLE_TICKS == 0
        if shown is not None and self._stale:
            self.layers.update(whole=whole)
            self._stale = not whole
        if whole:
            self.refresh()

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
        self.speed.show_speed(None)
        self.refresh()

    def undo(self) -> None:
        """Take the last segment away."""
        shown = self._shown
        if shown is None or self.work.busy:
            return
        client = self.connection.client
        if isinstance(shown, LiveMosaics) and shown.follows and client is not None:
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
            self.work.begin(
                0,
                lambda: save_mosaics(shown, path, shown.plan, shown.calibration, force=path.exists()),
                lambda paths: show_info("saved " + ", ".join(one.name for one in paths)),
            )
            self.refresh()

    def copy_script(self) -> None:
        """Copy Python that makes and saves these mosaics to the clipboard."""
        with told():
            path = self.calibration.value
            given = path if isinstance(path, Path) and path.is_file() else None
            facts = self._chosen().metadata.get("elsplus", {})
            if facts.get("kind") != "raw":
                raise InputError("these images are no raw recording", "a script can be had for raw recordings")
            copy_as_script(mosaic_script(facts["stack"], given or facts.get("calibration_path"), self.plan))

    def refresh(self) -> None:
        """Say how it goes, and what can be done."""
        busy, there = self.work.busy, self._shown is not None
        client = self.connection.client
        calibrating = client is not None and client.status.progress is not None
        self.going_live.text = "Cancel calibration" if calibrating else "Rest" if self.live else "Live mosaic"
        self.going_live.enabled = calibrating or not (busy or self.asking.busy)
        self.start.text = "Stop" if busy else "Mosaic"
        self.start.enabled = busy or bool(self.recording.choices)
        self.start.tooltip = (
            f"Make mosaics of the chosen stack, or stop that ({KEYS['start']})"
            if self.recording.choices
            else "First open a recording, or a sample: File > Open Sample > ELS+ endomicroscopy"
        )
        why = "" if there else "; make a mosaic first"
        self.clearing.enabled, self.clearing.tooltip = there, f"Take the mosaics away ({KEYS['clear']}){why}"
        self.undoing.enabled = self.saving.enabled = there and not busy
        why = "; wait for the end, or stop" if busy else why
        self.undoing.tooltip = f"Take the last segment away ({KEYS['undo']}){why}"
        self.saving.tooltip = f"Save OME-TIFF, PNG with scale bar, and track ({KEYS['save']}){why}"
        self.status.setText(self._said())
        if self._shown is not None:
            scale = self._shown.scale
            self.speed.show_speed(speed_of(self._shown.rows, scale.fastest_px, scale.camera_um_per_px))

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
            plan = self.plan
            self._remember()
            self.asking.ask(client.track(plan), then)

    def _follow_live(self) -> None:
        """Look at the engine's mosaic where there is a new one; at none where the engine is gone."""
        client = self.connection.client
        track = None if client is None else client.status.track
        shown = self._shown if isinstance(self._shown, LiveMosaics) else None
        if client is None or track is None:
            if shown is not None and shown.follows:
                shown.update()
                shown.close()
            return
        known = track.board == self._cleared or (shown is not None and shown.board == track.board)
        if known or not track.running or not self._goes_live:
            return
        try:
            live = LiveMosaics(track, client.calibration)
        except FileNotFoundError:  # replaced a moment ago; the next status says by what
            return
        self._leave_live()
        self._stack, self._shown = None, live
        self.layers.show(live, live.plan.tracked)

    def _leave_live(self) -> None:
        if isinstance(self._shown, LiveMosaics):
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
        counts = drawing.counts
        total = sum(counts.values())
        words = f"<b>{counts['tracked']}</b> of {total} frames tracked"
        words += f" in {drawing.segments} segments" if drawing.segments > 1 else ""
        words += "".join(f", {counts[state]} {state}" for state in ("predicted", "lost") if counts[state])
        um = self._shown.scale.um_per_px
        area_mm2 = self.layers.covered_px * (um or float("nan")) ** 2 * 1e-6
        return words + (f"; {area_mm2:.2g} mm\N{SUPERSCRIPT TWO}." if isfinite(area_mm2) else ".")

    def _chosen(self) -> Image:
        return chosen_image(self.viewer, self.recording, "stack")

    def _hide_others(self) -> None:
        ours = set(self.layers.ours.values())
        for layer in self.viewer.layers:
            if layer.visible and layer not in ours:
                layer.visible = False
                self._hidden.append(layer)

    def _layers_changed(self) -> None:
        renew_choices(self.recording)
        self.refresh()

    def _theme_changed(self) -> None:
        self.speed.follow(self.viewer.theme)
        self.refresh()

    def _ask_for_file(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Recording", "", "Recordings (*.tif *.tiff *.btf *.avi *.npy)")
        if path:
            self.viewer.open(path, plugin="napari-elsplus")

    def _ask_where_to_save(self) -> None:
        if not self.saving.enabled:
            return
        path, _ = QFileDialog.getSaveFileName(self, "Save mosaics", "mosaic.ome.tif", "OME-TIFF (*.ome.tif)")
        if path:
            self.save(Path(path))

    def _remember(self) -> None:
        remember(
            SECTION, method=self.method.value, insertion=self.insertion.value,
            modes=[mode.value for mode, box in self.modes.items() if box.value],
        )  # fmt: skip

    def _build(self) -> None:
        known = recall(SECTION)
        wanted = known.get("modes", [Mode.ELS.value])
        self.recording = ComboBox(
            label="stack",
            choices=lambda _: source_names(self.viewer),
            tooltip="A raw recording, or any stack of images of a moving probe",
        )
        self.opening = PushButton(text="Open file...", tooltip="Open a recording as layers")
        self.calibration = FileEdit(
            label="calibration", mode=FileDialogMode.EXISTING_FILE, filter="*.json", nullable=True,
            tooltip="A calibration file; empty: the recording's own",
        )  # fmt: skip
        self.modes = {
            mode: CheckBox(value=mode.value in wanted, text=TITLES[mode], tooltip=_TIPS[mode]) for mode in MODES
        }
        methods, insertions = [m.value for m in Method], [i.value for i in Insertion]
        self.method = ComboBox(
            choices=methods, value=_known(known.get("method"), methods), label="method",
            tooltip="elsplus: sub-pixel, rolling shutter undone, gated; paper: the paper's template matching",
        )  # fmt: skip
        self.insertion = ComboBox(
            choices=insertions, value=_known(known.get("insertion"), insertions), label="insertion",
            tooltip="dead-leaf: the newest frame on top; feathered: the mean of all",
        )  # fmt: skip
        self.start = PushButton(text="Mosaic")
        self.going_live = PushButton(text="Live mosaic")
        self.going_live.tooltip = (
            f"Lay the frames of the connected rig into a mosaic, one image only; or let it rest ({KEYS['live']})"
        )
        self.clearing, self.undoing = PushButton(text="Clear"), PushButton(text="Undo segment")
        self.saving = PushButton(text="Save...")
        self.script = PushButton(text="Copy as script", tooltip="Copy Python that makes and saves these mosaics")
        self.speed = SpeedBar(self.viewer.theme)
        self.status = QLabel()
        self.status.setWordWrap(True)
        layout = QVBoxLayout(self)
        form = Container(widgets=[self.recording, self.calibration], labels=True)
        choices = Container(widgets=[self.method, self.insertion], labels=True)
        boxes = Container(widgets=list(self.modes.values()), layout="horizontal", labels=False)
        for part in (form, boxes, choices):
            layout.addWidget(part.native)
        for buttons in (
            [self.start, self.going_live],
            [self.clearing, self.undoing],
            [self.saving, self.script],
            [self.opening],
        ):
            layout.addWidget(Container(widgets=list(buttons), layout="horizontal", labels=False).native)
        for widget in (self.work, self.speed, self.status):
            layout.addWidget(widget)
        layout.addStretch(1)
        pressed = {
            "start": (self.start, self.toggle),
            "live": (self.going_live, self.toggle_live),
            "clear": (self.clearing, self.clear),
            "undo": (self.undoing, self.undo),
            "save": (self.saving, self._ask_where_to_save),
        }
        for name, (button, slot) in pressed.items():
            button.clicked.connect(slot)
            QShortcut(QKeySequence(KEYS[name]), self).activated.connect(slot)
        self.opening.clicked.connect(self._ask_for_file)
        self.script.clicked.connect(self.copy_script)


def _tell_if_none(undone: bool) -> None:
    if not undone:
        show_info("there is no segment left")


def _known(value: Any, choices: list[str]) -> str:
    return value if value in choices else choices[0]


_TIPS: Final = {
    Mode.LS: "Confocal view: line-scan confocal",
    Mode.ELSA: "Confocal of one frame minus residual of the next, for comparison",
    Mode.ELS: "Confocal minus residual of one frame: ELS+; tracked where it is ticked",
}
