"""The Live panel: display of live LS, residual, ELS+ and ELSA images, and recording."""

from __future__ import annotations

import time
from collections import deque
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from napari.utils.notifications import show_info

from napari_elsplus._problems import notify_errors, problems
from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
from napari_elsplus.instrument.scanning import lag_advice
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.viewing.live_script import live_script
from napari_elsplus.widgets.live.form import CONTINUOUS, FIXED, LiveForm
from napari_elsplus.widgets.live.layers import LiveLayers, import_ahead
from napari_elsplus.widgets.live.status import status_text
from napari_elsplus.widgets.shared.engine_panel import EnginePanel
from napari_elsplus.widgets.shared.panel import copy_as_script, next_hint, timer
from napari_elsplus.widgets.shared.rig_choice import remembered_rig, remembered_settings
from napari_elsplus.widgets.shared.window.canvas_monitor import CanvasMonitor
from napari_elsplus.widgets.shared.window.layer_list import LayerListModels

if TYPE_CHECKING:
    from collections.abc import Callable

    import napari.viewer

    from napari_elsplus.acquisition.engine.live_images import LiveView
    from napari_elsplus.acquisition.engine.status import Status
    from napari_elsplus.acquisition.link.client import EngineClient
    from napari_elsplus.instrument.calibration import Calibration

TICK_MS: Final = 16
"""Interval at which a new image is tested for, milliseconds: 60 Hz, the rate of most screens."""
STATUS_S: Final = 0.25
"""Interval of the status text, seconds; chosen, faster than it can be read."""
WHOLE_S: Final = 1.0
"""Interval of full refreshes (thumbnails, continuous contrast), seconds; chosen, one costs more than the images."""
RATE_TICKS: Final = 61
"""Images over which the display rate is averaged: one second at 60 Hz."""


class LivePanel(EnginePanel):
    """Stream, display and record.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer. Live layers are reused from stream to stream, with the user's colormap and contrast.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer)
        import_ahead()
        self.layers = LiveLayers(viewer)
        self.canvas, self.layer_list = CanvasMonitor(self), LayerListModels(self)
        self._view: LiveView | None = None
        self._faults_shown: set[str] = set()
        self._stream_ended = False
        self._arranged: tuple[object, ...] | None = None
        self._arranged_by: Calibration | None = None
        self._shown_at_s: deque[float] = deque(maxlen=RATE_TICKS)
        self._whole_at_s = self._status_at_s = 0.0
        self.form = LiveForm(self)
        self.form.connect({"live": self.toggle, "record": self.toggle_recording, "snap": self.snap}, self.change_view)
        self.form.contrast.changed.connect(self._contrast_chosen)
        self.form.opening.clicked.connect(self.open_or_return)
        self.form.lag.clicked.connect(self.measure_lag)
        self.form.script.clicked.connect(self.copy_script)
        self._timer = timer(self, TICK_MS, self.tick, starts=True)
        self.refresh()

    @property
    def live(self) -> bool:
        """True while frames are streaming."""
        client = self.connection.client
        return client is not None and client.status.live and client.status.progress is None

    def toggle(self) -> None:
        """Start the stream, connecting and calibrating first if needed; or stop it."""
        client = self.connection.client
        if client is not None and client.status.progress is not None:
            self.requests.follow(client.cancel())
        elif client is not None and client.status.live:
            self.requests.follow(client.stop())
        else:
            self.form.choose_some()
            self.layers.begin()
            self.prepare_rig(self._start)
        self.refresh()

    def toggle_recording(self) -> None:
        """Start a recording, or stop it."""
        client = self.connection.client
        if client is None:
            return
        recording = client.status.recording
        if recording is not None and recording.running:
            self.requests.follow(client.stop_recording(), lambda _: show_info(f"recorded {recording.path}"))
            return
        with notify_errors(self):
            self.requests.follow(client.record(self.form.plan))
            self.form.remember()

    def snap(self) -> None:
        """Save the newest raw frame."""
        client = self.connection.client
        if client is None:
            return
        with notify_errors(self):
            path = self.form.next_path("snap")
            self.requests.follow(client.record(RecordingPlan(path, frames=1)), lambda _: show_info(f"saved {path}"))

    def open_or_return(self) -> None:
        """Open the newest recording; where the stream's images are hidden, display these again instead."""
        if self._hidden:
            self.layers.begin()
            self._arranged = None
        else:
            self.open_recorded()
        self.refresh()

    def open_recorded(self) -> None:
        """Open the newest recording as layers."""
        client = self.connection.client
        recorded = None if client is None else client.status.recording
        if recorded is not None and not recorded.running:
            self.open_dropped(Path(recorded.path))

    def change_view(self) -> None:
        """Apply the form's processing to live images."""
        client = self.connection.client
        if client is None:
            self.form.remember()
        else:
            self._apply_view(client)

    def copy_script(self) -> None:
        """Copy a script that streams and records with the form's settings to the clipboard."""
        with notify_errors(self):
            file = self.connection.calibration_file
            connection = self.connection
            rig, settings = connection.rig or remembered_rig(), connection.settings or remembered_settings()
            copy_as_script(live_script(rig, settings, self.form.view, self.form.plan, file))

    def tick(self) -> None:
        """Display the newest frame, if there is a new one."""
        client = self.connection.client
        now_s = time.perf_counter()
        if client is None or not client.status.live:
            self._arranged = None  # the next stream, whichever panel starts it, displays its images again
            self.layers.begin()
            self._stream_ended = True
            self._shown_at_s.clear()
        elif self.live and not self.canvas.pending:
            self._show_newest(client, now_s)
        if now_s - self._status_at_s > STATUS_S:
            self._status_at_s = now_s
            self.refresh()

    def refresh(self) -> None:
        """Update status text and buttons."""
        client = self.connection.client
        status = client.status if client is not None else None
        live, busy = self.live, self.waiting
        calibrating = status is not None and status.progress is not None
        recording = status is not None and status.recording is not None and status.recording.running
        self.form.set_enabled(live=live, busy=busy, calibrating=calibrating, recording=recording)
        calibration, file = self.connection.calibration, self.connection.calibration_file
        self.form.lag.visible = status is not None and not calibrating and bool(lag_advice(calibration))
        recorded = status is not None and status.recording is not None and not recording
        self.form.show_opening(recorded=recorded, hidden=self._hidden)
        self.form.lag.enabled = not busy and not recording
        self.form.bar.show_state(status, busy=busy)
        text = status_text(status, calibration, self._display_hz, busy=busy, calibration_file=file)
        none = "" if self.form.chosen or not live else next_hint("tick an image to display.") + "<br>"
        self.form.status.setText(none + text)
        self._show_new_faults(status)

    def rescale_contrast(self) -> None:
        """Set the contrast limits of visible layers from the present images."""
        for kind, layer in self.layers.images.items():
            if layer.visible:
                self.layers.rescale_contrast(kind)

    def cleanup(self) -> None:
        """Release the engine and disconnect from the viewer; the layers remain."""
        self._timer.stop()
        super().cleanup()

    def _start(self, client: EngineClient) -> None:
        self._apply_view(client, lambda: self.start_stream(client))

    def _apply_view(self, client: EngineClient, then: Callable[[], None] = lambda: None) -> None:
        """Apply the form's processing, then go on; where it is refused, the form returns to the last.

        Parameters
        ----------
        client : EngineClient
            Of the connected rig.
        then : callable
            Called once it is accepted.
        """
        view = self.form.view

        def accepted(_: None) -> None:
            self._view = view
            self.form.remember()
            then()

        self.requests.follow(client.show(view), accepted, failed=self._show_accepted)

    def _show_accepted(self) -> None:
        self.form.view = self._view or replace(self.form.view, flat_field=False, cores=CoreFilter.NONE)
        self.form.remember()

    def _show_newest(self, client: EngineClient, now_s: float) -> None:
        ring = client.display()
        if ring is None:
            return
        if self._arranged is not None:
            for kind in self.layers.removed(self.form.chosen):
                self.form.kinds[kind].value = False
        kinds, apart, calibration = self.form.chosen, self.form.side_by_side.value, client.calibration
        arranged = (ring.layout, ring.name, tuple(kinds), apart)
        if arranged != self._arranged or calibration is not self._arranged_by:
            if self.layers.hidden:
                self.layers.begin()
            file, rig = self.connection.calibration_file, self.connection.rig
            complete = self.layers.arrange(kinds, ring, calibration, side_by_side=apart, calibration_file=file, rig=rig)
            self._arranged, self._arranged_by = arranged if complete else None, calibration
        whole = now_s - self._whole_at_s > WHOLE_S
        with nullcontext() if whole else self.layer_list.signals_blocked():
            shown = self.layers.update(ring, whole=whole)
        if shown is None:
            return
        self.canvas.expect_paint()
        self._shown_at_s.append(now_s)
        if whole:
            self._whole_at_s = now_s
            if self.form.contrast.value == CONTINUOUS:
                self.rescale_contrast()

    def _contrast_chosen(self, chosen: str) -> None:
        if chosen == FIXED:
            self.layers.keep_contrast()
        else:
            self.rescale_contrast()

    @property
    def _hidden(self) -> bool:
        """True while frames are streaming whose chosen images are hidden."""
        return self.live and bool(self.form.chosen) and self.layers.hidden

    @property
    def _display_hz(self) -> float:
        shown = self._shown_at_s
        return (len(shown) - 1) / (shown[-1] - shown[0]) if len(shown) > 1 and shown[-1] > shown[0] else 0.0

    def _show_new_faults(self, status: Status | None) -> None:
        died = self.connection.died
        messages = [str(died)] if died is not None else []
        if status is not None and status.live and self._stream_ended:
            self._faults_shown.clear()  # of the stream before
            self._stream_ended = False
        if status is not None:
            messages += [str(fault) for fault in status.faults]
            messages += [status.disagreement] if status.disagreement else []
        for message in messages:
            if message not in self._faults_shown:
                self._faults_shown.add(message)
                problems.report(message, self)
