"""The Live panel: LS, residual, ELS+ and ELSA while they happen, and their recording."""

from __future__ import annotations

import time
from collections import deque
from contextlib import nullcontext
from typing import TYPE_CHECKING, Final

from napari.utils.notifications import show_error, show_info
from qtpy.QtCore import QTimer

from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
from napari_elsplus.hardware.rig import SIMULATED
from napari_elsplus.viewing.live_script import live_script
from napari_elsplus.widgets.live.form import CONTINUOUS, FIXED, LiveForm
from napari_elsplus.widgets.live.layers import LiveLayers
from napari_elsplus.widgets.live.rig import remembered_rig, remembered_settings
from napari_elsplus.widgets.live.status import said_of
from napari_elsplus.widgets.shared.drawing import Drawing
from napari_elsplus.widgets.shared.engine_panel import EnginePanel
from napari_elsplus.widgets.shared.layer_list import LayerList
from napari_elsplus.widgets.shared.panel import copy_as_script, told

if TYPE_CHECKING:
    import napari.viewer

    from napari_elsplus.acquisition.engine.status import Status
    from napari_elsplus.acquisition.link.client import EngineClient
    from napari_elsplus.instrument.calibration import Calibration

TICK_MS: Final = 16
STATUS_S: Final = 0.25
WHOLE_S: Final = 1.0
"""Thumbnails and the continuous contrast follow so often: napari's list of layers costs more than the images."""
RATE_TICKS: Final = 61
"""Images from which the display's rate is told."""


class LivePanel(EnginePanel):
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
        self._arranged: tuple[object, ...] | None = None
        self._arranged_by: Calibration | None = None
        self._shown_at_s: deque[float] = deque(maxlen=RATE_TICKS)
        self._whole_at_s = self._status_at_s = 0.0
        self.form = LiveForm(self)
        self.form.connect({"start": self.toggle, "record": self.toggle_recording, "snap": self.snap}, self.change_view)
        self.form.contrast.changed.connect(self._contrast_chosen)
        self.form.script.clicked.connect(self.copy_script)
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
            self.asking.ask(client.record(self.form.plan))
            self.form.remember()

    def snap(self) -> None:
        """Record the newest frame alone."""
        client = self.connection.client
        if client is None:
            return
        with told():
            path = self.form.next_path("snap")
            self.asking.ask(client.record(RecordingPlan(path, frames=1)), lambda _: show_info(f"snapped {path}"))

    def change_view(self) -> None:
        """Make the images as the form says."""
        self.form.remember()
        client = self.connection.client
        if client is not None:
            self.asking.ask(client.show(self.form.view))

    def copy_script(self) -> None:
        """Copy Python that streams and records as the form says."""
        with told():
            file = self.connection.calibration_file
            rig, settings = self.connection.rig or remembered_rig(), remembered_settings()
            copy_as_script(live_script(rig, settings, self.form.view, self.form.plan, file))

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
        self.form.allow(live=live, busy=busy, calibrating=calibrating, recording=recording)
        self.form.status.setText(said_of(status, self.connection.calibration, self._display_hz, busy=busy))
        self._tell_once(status)

    def stretch(self) -> None:
        """Set the contrast by what is shown now."""
        for kind, layer in self.layers.images.items():
            if layer.visible:
                self.layers.stretch(kind)

    def cleanup(self) -> None:
        """Let go of the engine and the viewer; the layers stay."""
        self._timer.stop()
        super().cleanup()

    # inside

    def _start(self, client: EngineClient) -> None:
        self._faults_told.clear()
        self._arranged = None
        self.activate_calibration(client, lambda: self._calibrate_and_start(client))

    def _calibrate_and_start(self, client: EngineClient) -> None:
        if client.calibration is None and self.connection.rig == SIMULATED:
            self.asking.ask(client.calibrate_simulated(), lambda _: self._calibrate_and_start(client))
            return
        self.asking.ask(client.show(self.form.view), lambda _: self.asking.ask(client.start()))

    def _look(self, client: EngineClient, now_s: float) -> None:
        ring = client.display()
        if ring is None:
            return
        kinds, apart, calibration = self.form.chosen, self.form.side_by_side.value, client.calibration
        wanted = (ring.layout, ring.name, tuple(kinds), apart)
        if wanted != self._arranged or calibration is not self._arranged_by:
            file = self.connection.calibration_file
            self.layers.arrange(kinds, ring, calibration, side_by_side=apart, calibration_file=file)
            self._arranged, self._arranged_by = wanted, calibration
        whole = now_s - self._whole_at_s > WHOLE_S
        with nullcontext() if whole else self.layer_list.undisturbed():
            shown = self.layers.update(ring, whole=whole)
        if shown is None:
            return
        self.drawing.ask()
        self._shown_at_s.append(now_s)
        if whole:
            self._whole_at_s = now_s
            if self.form.contrast.value == CONTINUOUS:
                self.stretch()

    def _contrast_chosen(self, chosen: str) -> None:
        if chosen != FIXED:
            self.stretch()

    @property
    def _display_hz(self) -> float:
        shown = self._shown_at_s
        return (len(shown) - 1) / (shown[-1] - shown[0]) if len(shown) > 1 and shown[-1] > shown[0] else 0.0

    def _tell_once(self, status: Status | None) -> None:
        died = self.connection.died
        said = [str(died)] if died is not None else []
        if status is not None:
            said += [str(fault) for fault in status.faults]
        for words in said:
            if words not in self._faults_told:
                self._faults_told.add(words)
                show_error(words)
