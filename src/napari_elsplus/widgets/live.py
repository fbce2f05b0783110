"""The Live panel: LS, residual, ELS+ and ELSA while they happen, and their recording."""

from __future__ import annotations

import shutil
import time
from contextlib import nullcontext
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from magicgui.types import FileDialogMode
from magicgui.widgets import CheckBox, ComboBox, Container, FileEdit, FloatSpinBox, PushButton, SpinBox
from napari.utils.notifications import show_error, show_info
from qtpy.QtCore import QTimer
from qtpy.QtGui import QKeySequence, QShortcut  # type: ignore[attr-defined] # where Qt 6 has it
from qtpy.QtWidgets import QLabel, QVBoxLayout

from napari_elsplus.acquisition.live_images import RAW, View
from napari_elsplus.acquisition.recorder import RecordingPlan
from napari_elsplus.hardware.rigs import SIMULATED
from napari_elsplus.processing.cores import CoreFilter
from napari_elsplus.processing.sectioning import Mode
from napari_elsplus.settings import recall, remember
from napari_elsplus.viewing.live_script import live_script
from napari_elsplus.widgets.drawing import Drawing
from napari_elsplus.widgets.engine_panel import EnginePanel
from napari_elsplus.widgets.layer_list import LayerList
from napari_elsplus.widgets.live_layers import KINDS, LiveLayers
from napari_elsplus.widgets.panel import copy_as_script, told
from napari_elsplus.widgets.rig import remembered_rig, remembered_settings

if TYPE_CHECKING:
    import napari.viewer

    from napari_elsplus.acquisition.client import EngineClient
    from napari_elsplus.acquisition.status import Status

SECTION: Final = "live"
TICK_MS: Final = 16
STATUS_S: Final = 0.25
WHOLE_S: Final = 1.0
ONCE, CONTINUOUS, FIXED = "once", "continuous", "fixed"
KEYS: Final = {"start": "Ctrl+Return", "record": "Ctrl+Shift+R", "snap": "Ctrl+Shift+P"}
SATURATED: Final = 0.001


class Live(EnginePanel):
    """Stream, look and record.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer. Its layers are reused from stream to stream, with the user's colours and contrast.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer)
        self.layers = LiveLayers(viewer)
        self.drawing, self.layer_list = Drawing(self), LayerList(self)
        self._faults_told: set[str] = set()
        self._arranged: object = None
        self._shown_at_s: list[float] = []
        self._whole_at_s = self._status_at_s = 0.0
        self._build()
        self._timer = QTimer(self)
        self._timer.setInterval(TICK_MS)
        self._timer.timeout.connect(self.tick)
        self._timer.start()
        self.refresh()

    @property
    def live(self) -> bool:
        """Whether frames stream."""
        client = self.connection.client
        return client is not None and client.status.live and client.status.progress is None

    def toggle(self) -> None:
        """Start, connecting and calibrating first where that is needed; or stop."""
        client = self.connection.client
        if client is None:
            rig, settings = remembered_rig(), remembered_settings()
            self.asking.do(lambda: self.connection.connect(rig, settings), self._start)
        elif client.status.progress is not None:
            self.asking.ask(client.cancel())
        elif client.status.live:
            self.asking.ask(client.stop())
        else:
            self._start(client)
        self.refresh()

    def toggle_recording(self) -> None:
        """Record, or finish the recording."""
        client = self.connection.client
        if client is None:
            return
        recording = client.status.recording
        if recording is not None and recording.running:
            self.asking.ask(client.stop_recording(), lambda _: show_info(f"recorded {recording.path}"))
            return
        with told():
            self.asking.ask(client.record(self.plan))
            self._remember()

    def snap(self) -> None:
        """Record the newest frame alone."""
        client = self.connection.client
        if client is None:
            return
        with told():
            path = self._next_path("snap")
            self.asking.ask(client.record(RecordingPlan(path, frames=1)), lambda _: show_info(f"snapped {path}"))

    def change_view(self) -> None:
        """Make the images as the form says."""
        self._remember()
        client = self.connection.client
        if client is not None:
            self.asking.ask(client.show(self.view))

    def copy_script(self) -> None:
        """Copy Python that streams and records as the form says."""
        with told():
            file = self.connection.calibration_file
            rig, settings = self.connection.rig or remembered_rig(), remembered_settings()
            copy_as_script(live_script(rig, settings, self.view, self.plan, file))

    @property
    def plan(self) -> RecordingPlan:
        """How the form wants to record, from now on."""
        return RecordingPlan(
            self._next_path(),
            frames=int(self.frames.value) or None,
            seconds=self.seconds.value or None,
            earlier_s=self.earlier_s.value,
        )

    @property
    def view(self) -> View:
        """How the form wants images to be made."""
        return View(self.background.value, self.flat_field.value, CoreFilter(self.cores.value), self.average.value)

    def tick(self) -> None:
        """Show the newest frame, if there is a new one."""
        client = self.connection.client
        now_s = time.perf_counter()
        if client is not None and self.live and not self.drawing.pending:
            self._look(client, now_s)
        if now_s - self._status_at_s > STATUS_S:
            self._status_at_s = now_s
            self.refresh()

    def refresh(self) -> None:
        """Say how it goes, and what can be done."""
        client = self.connection.client
        status = client.status if client is not None else None
        live, busy = self.live, self.asking.busy
        calibrating = status is not None and status.progress is not None
        recording = status is not None and status.recording is not None and status.recording.running
        self.start.text = "Stop" if live else "Cancel calibration" if calibrating else "Start"
        self.start.enabled = live or calibrating or not busy
        self.record.text = "Finish recording" if recording else "Record"
        self.record.enabled = self.snapping.enabled = live
        why = "" if live else "; start the stream first"
        self.record.tooltip = f"Record raw frames and the calibration ({KEYS['record']}){why}"
        self.snapping.tooltip = f"Record the newest frame ({KEYS['snap']}){why}"
        self.status.setText(self._said(status, busy))
        self._tell_once(status)

    def cleanup(self) -> None:
        """Let go of the engine and the viewer; the layers stay."""
        self._timer.stop()
        super().cleanup()

    # inside

    def _start(self, client: EngineClient) -> None:
        self._faults_told.clear()
        self._arranged = None
        self.put_in_force(client, lambda: self._calibrate_and_start(client))

    def _calibrate_and_start(self, client: EngineClient) -> None:
        if client.calibration is None and self.connection.rig == SIMULATED:
            self.asking.ask(client.calibrate_simulated(), lambda _: self._calibrate_and_start(client))
            return
        self.asking.ask(client.show(self.view), lambda _: self.asking.ask(client.start()))

    def _look(self, client: EngineClient, now_s: float) -> None:
        ring = client.display()
        if ring is None:
            return
        kinds = [kind for kind, box in self.kinds.items() if box.value]
        wanted = (ring.layout, ring.name, tuple(kinds), self.side_by_side.value, client.calibration)
        if self._arranged is None or wanted[:4] != self._arranged[:4] or wanted[4] is not self._arranged[4]:  # type: ignore[index]
            self.layers.arrange(
                kinds,
                ring,
                client.calibration,
                side_by_side=self.side_by_side.value,
                calibration_file=self.connection.calibration_file,
            )
            self._arranged = wanted
        whole = now_s - self._whole_at_s > WHOLE_S
        with nullcontext() if whole else self.layer_list.undisturbed():
            shown = self.layers.update(ring, whole=whole)
        if shown is None:
            return
        self.drawing.ask()
        self._shown_at_s = [*self._shown_at_s[-60:], now_s]
        if whole:
            self._whole_at_s = now_s
            if self.contrast.value == CONTINUOUS:
                self.stretch()

    def stretch(self) -> None:
        """Set the contrast by what is shown now."""
        for kind, layer in self.layers.images.items():
            if layer.visible:
                self.layers.stretch(kind)

    def _contrast_chosen(self, chosen: str) -> None:
        if chosen != FIXED:
            self.stretch()

    def _next_path(self, kind: str = "recording") -> Path:
        stamp = datetime.now().astimezone().strftime("%Y%m%d-%H%M%S-%f")[:-3]
        return Path(str(self.folder.value)) / f"{kind}-{stamp}.ome.tif"

    def _said(self, status: Status | None, busy: bool) -> str:
        if status is None:
            return "Connecting..." if busy else "Not connected: Start connects to the rig."
        if status.progress is not None:
            return f"Calibrating: {status.progress.step}, {status.progress.done} of {status.progress.total}"
        if not status.live:
            return "Starting..." if busy else "Stopped."
        shown = self._shown_at_s
        display_hz = (len(shown) - 1) / (shown[-1] - shown[0]) if len(shown) > 1 and shown[-1] > shown[0] else 0.0
        lost = ", ".join(f"{count} {cause}" for cause, count in status.dropped.items()) or "none"
        lines = [
            f"camera {status.camera_hz:.0f} Hz, display {display_hz:.0f} Hz, latency {status.latency_ms.p50:.1f} ms",
            f"lost: {lost}",
        ]
        if status.recording is not None and status.recording.running:
            left = shutil.disk_usage(Path(status.recording.path).parent).free / status.disk_bytes_per_s / 60
            lines.append(f"<b>recording</b> {status.recording.frames} frames; the disk lasts {left:.0f} minutes")
        measures = status.measures
        lines.append(f"saturated {100 * measures.saturated:.2f} %, focus {measures.focus:.3g}")
        if measures.saturated > SATURATED:
            lines.append("<b>Saturated</b>: lower the light or the gain.")
        lines += [f"stale: {section} ({reason})" for section, reason in status.stale.items()]
        return "<br>".join(lines)

    def _tell_once(self, status: Status | None) -> None:
        died = self.connection.died
        said = [str(died)] if died is not None else []
        if status is not None:
            said += [str(fault) for fault in status.faults]
        for words in said:
            if words not in self._faults_told:
                self._faults_told.add(words)
                show_error(words)

    def _remember(self) -> None:
        remember(
            SECTION, folder=str(self.folder.value), cores=self.cores.value, background=self.background.value,
            flat_field=self.flat_field.value, average=self.average.value,
            kinds=[kind for kind, box in self.kinds.items() if box.value], side_by_side=self.side_by_side.value,
        )  # fmt: skip

    def _build(self) -> None:
        known = recall(SECTION)
        shown = known.get("kinds", [Mode.LS.value, Mode.ELS.value])
        self.start, self.record, self.snapping = (PushButton(text=word) for word in ("Start", "Record", "Snap"))
        self.start.tooltip = f"Start or stop the stream ({KEYS['start']})"
        self.script = PushButton(text="Copy as script", tooltip="Copy Python that streams and records like this")
        self.kinds = {
            kind: CheckBox(value=kind in shown, text=title, tooltip=_TIPS[kind]) for kind, title in KINDS.items()
        }
        self.side_by_side = CheckBox(
            value=known.get("side_by_side", True),
            text="side by side",
            tooltip="Next to each other, or in one place",
        )
        self.contrast = ComboBox(
            choices=[ONCE, CONTINUOUS, FIXED], label="contrast",
            tooltip="Set by the first frame, every second, or by you alone",
        )  # fmt: skip
        self.background = CheckBox(
            value=known.get("background", True), text="background", tooltip="Subtract the background of the calibration"
        )
        self.flat_field = CheckBox(
            value=known.get("flat_field", False), text="flat field", tooltip="Divide by the calibration's flat field"
        )
        self.cores = ComboBox(
            choices=[kind.value for kind in CoreFilter], value=known.get("cores", CoreFilter.NONE.value), label="cores",
            tooltip="How the honeycomb of cores is suppressed",
        )  # fmt: skip
        self.average = SpinBox(
            value=known.get("average", 1), min=1, max=64, label="average (frames)",
            tooltip="Each frame counts one in so many, 1 to 64",
        )  # fmt: skip
        self.folder = FileEdit(
            value=known.get("folder", str(Path.home())),
            mode=FileDialogMode.EXISTING_DIRECTORY,
            label="folder",
            tooltip="Where recordings go",
        )
        self.seconds = FloatSpinBox(
            value=0, min=0, max=36000, label="seconds", tooltip="End after so long; 0: by frames, or when you end it"
        )
        self.frames = FloatSpinBox(  # of whole numbers: napari's spin box of integers shows no special text
            value=0,
            min=0,
            max=10_000_000,
            step=1,
            label="frames",
            tooltip="End after so many; 0: by seconds, or when you end it",
        )
        self.frames.native.setDecimals(0)
        for limit in (self.seconds, self.frames):
            limit.native.setSpecialValueText("no limit")
        self.earlier_s = FloatSpinBox(
            value=0, min=0, max=1.9, step=0.5, label="earlier (s)", tooltip="Begin so long before you press, 0 to 1.9 s"
        )
        self.status = QLabel()
        self.status.setWordWrap(True)
        rows: list[list[Any]] = [
            [self.start, self.record, self.snapping],
            list(self.kinds.values()),
            [self.side_by_side, self.background, self.flat_field],
        ]
        layout = QVBoxLayout(self)
        for row in rows:
            layout.addWidget(Container(widgets=row, layout="horizontal", labels=False).native)
        form = [
            self.contrast, self.cores, self.average, self.folder, self.seconds, self.frames, self.earlier_s
        ]  # fmt: skip
        layout.addWidget(Container(widgets=form, labels=True).native)
        layout.addWidget(self.script.native)
        layout.addWidget(self.status)
        layout.addStretch(1)
        pressed = {"start": self.toggle, "record": self.toggle_recording, "snap": self.snap}
        for (name, slot), button in zip(pressed.items(), (self.start, self.record, self.snapping), strict=True):
            button.clicked.connect(slot)
            QShortcut(QKeySequence(KEYS[name]), self).activated.connect(slot)
        for choice in (self.background, self.flat_field, self.cores, self.average):
            choice.changed.connect(self.change_view)
        for box in (*self.kinds.values(), self.side_by_side):
            box.changed.connect(self._remember)
        self.contrast.changed.connect(self._contrast_chosen)
        self.script.clicked.connect(self.copy_script)


_TIPS: Final = {
    RAW: "The camera's frame with both views",
    Mode.LS.value: "Confocal view: line-scan confocal",
    Mode.RESIDUAL.value: "Residual view, aligned onto the confocal one",
    Mode.ELS.value: "Confocal minus residual of one frame: ELS+",
    Mode.ELSA.value: "Confocal of one frame minus residual of the next, for comparison",
}
