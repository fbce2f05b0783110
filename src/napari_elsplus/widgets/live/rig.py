"""The Rig panel: connection, settings and state of a rig."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from magicgui.widgets import ComboBox, FloatSpinBox, SpinBox
from napari.utils.notifications import show_info

from napari_elsplus._problems import notify_errors
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.errors import InputError
from napari_elsplus.hardware.rig_files import is_simulated
from napari_elsplus.hardware.rigs import rig_names
from napari_elsplus.instrument.optics import PRESETS, preset
from napari_elsplus.instrument.scanning import lag_advice
from napari_elsplus.io import read_calibration, write_calibration
from napari_elsplus.io.formats.registry import CALIBRATION, dialog_filter
from napari_elsplus.io.settings import active_calibration, set_active_calibration
from napari_elsplus.widgets.live.rehearsal import Rehearsal
from napari_elsplus.widgets.live.status import stale_lines
from napari_elsplus.widgets.shared.calibration_state import calibration_lines, lag_button
from napari_elsplus.widgets.shared.engine_panel import EnginePanel
from napari_elsplus.widgets.shared.files import choose_file_to_read, choose_file_to_write
from napari_elsplus.widgets.shared.panel import (
    button_row,
    form_layout,
    next_hint,
    panel_layout,
    push_button,
    set_enabled,
    text_label,
    timer,
)
from napari_elsplus.widgets.shared.requests import RequestBar
from napari_elsplus.widgets.shared.rig_choice import preset_label, remember_rig, remembered_rig, remembered_settings
from napari_elsplus.widgets.shared.window.keys import bind_keys, key_name

if TYPE_CHECKING:
    from pathlib import Path

    import napari.viewer

    from napari_elsplus.acquisition.link.client import EngineClient

STATUS_MS: Final = 200
"""Interval of the status text, milliseconds; chosen, faster than it can be read."""
MAX_TYPED: Final = 9999
"""Largest slit width, rate and gain that can be typed; chosen, beyond any camera's, which states its limit."""


class RigPanel(EnginePanel):
    """Connect to a rig and configure it.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer)
        self._disconnecting = False
        self._shown: Settings | None = None
        self._build()
        self._timer = timer(self, STATUS_MS, self.refresh, starts=True)
        self.refresh()

    @property
    def settings(self) -> Settings:
        """Settings in the form."""
        rate = self.rate_hz.value
        return Settings(self.preset.value, self.slit_rows.value, rate if rate > 0 else None, self.gain_db.value)

    def toggle(self) -> None:
        """Connect to the selected rig, or disconnect."""
        self._disconnecting = self.connection.client is not None
        if self._disconnecting:
            self.requests.run(self.connection.disconnect)
            return
        rig, settings = self.rig.value, self.settings
        remember_rig(rig, settings)
        self.requests.run(lambda: self.connection.connect(rig, settings), self.activate_calibration)

    def apply(self) -> None:
        """Apply the form's settings to the rig; a running stream restarts with a matching ramp.

        Settings that the rig refuses leave the form, which displays those that hold.
        """
        rig, settings = self.rig.value, self.settings
        if self.connection.client is None:
            remember_rig(rig, settings)
        else:
            configured = self.connection.configure(settings)
            self.requests.follow(configured, lambda _: remember_rig(rig, settings), failed=self._show_accepted)
        self.refresh()

    def park(self) -> None:
        """Move the laser line off the bundle; what is about to start is not started."""
        parked = self.connection.park()
        if parked is not None:
            self.requests.follow(parked)

    def calibrate(self) -> None:
        """Calibrate the simulated rig, or cancel its calibration."""
        client = self.connection.client
        if client is None:
            return
        if client.status.progress is not None:
            self.requests.follow(client.cancel())
        else:
            self.requests.follow(client.calibrate_simulated())

    def load(self, path: Path) -> None:
        """Read a calibration from a path and make it the active calibration."""
        with notify_errors(self):
            calibration = read_calibration(path)
            self.connection.require()
            self.requests.follow(self.connection.apply(calibration, path), lambda _: set_active_calibration(path))

    def save(self, path: Path) -> None:
        """Write the active calibration to a path; recordings without a calibration are displayed with it."""
        calibration = self.connection.calibration
        with notify_errors(self):
            if calibration is None:
                raise InputError("there is no calibration to save", "calibrate first")
            written = write_calibration(path, calibration, force=True)
            set_active_calibration(written)
            self.requests.follow(
                self.connection.apply(calibration, written), lambda _: show_info(f"saved {written.name}")
            )

    def forget(self) -> None:
        """Leave no calibration active: raw frames are displayed, and the galvo parks where the rig parks it."""
        self.requests.follow(self.connection.apply(None), lambda _: set_active_calibration(None))

    def refresh(self) -> None:
        """Update status text, buttons, and settings that another panel has applied."""
        client, busy = self.connection.client, self.waiting
        if not busy and self.connection.settings is not self._shown:
            self._show_accepted()
        connected = client is not None
        simulated = is_simulated(self.connection.rig)
        progress = client.status.progress if client is not None else None
        self.connect.text = "Disconnect" if connected else "Connect"
        self.connect.enabled = not busy or progress is not None
        self.connect.tooltip = "Park the galvo, and close camera and galvo" if connected else "Open camera and galvo"
        self.rig.enabled = not connected and not busy
        for field in (self.preset, self.slit_rows, self.rate_hz, self.gain_db):
            field.enabled = connected or not busy  # what is typed while it connects would be lost
        calibrated, none = self.connection.calibration is not None, "calibrate, or load a calibration"
        parks = f"Move the laser line off the bundle ({key_name('park')})"
        set_enabled(self.parking, connected or busy, parks, "connect")
        set_enabled(self.open_file, connected, "Make a calibration file the active calibration", "connect")
        saves = "Write the active calibration; recordings without a calibration are displayed with it"
        set_enabled(self.save_file, calibrated, saves, none)
        forgets = "Leave no calibration active: live images are raw, recordings without their own are displayed raw"
        set_enabled(self.forgetting, calibrated or active_calibration() is not None, forgets, none)
        measures = "Measure offset, galvo, view alignment, scan lag and background; runs unattended"
        real = "connect to the simulated rig; the Calibration panel calibrates others"
        set_enabled(self.calibrate_simulated, connected and simulated, measures, real)
        self.calibrate_simulated.text = "Cancel calibration" if progress is not None else "Calibrate simulated rig"
        self.lag.visible = connected and bool(lag_advice(self.connection.calibration))
        self.lag.enabled = not busy
        self.rehearsal.allow(not connected and not busy)
        self.optics.setText(self._optics())
        self.bar.show_state(None if client is None else client.status, busy=busy)
        self.status.setText(self._status_text(client, busy))

    def cleanup(self) -> None:
        """Release the engine and disconnect from the viewer."""
        self._timer.stop()
        self.rehearsal.cleanup()
        super().cleanup()

    def _build(self) -> None:
        last = remembered_settings()
        self.rig = ComboBox(
            choices=rig_names(),
            value=remembered_rig(),
            label="rig",
            tooltip="Rig files, and the simulated rig; `napari-elsplus doctor` lists the devices found",
        )
        self.preset = ComboBox(
            choices=[(preset_label(name), name) for name in PRESETS],
            value=last.preset,
            label="preset",
            tooltip="Camera region and objective",
        )
        self.slit_rows = SpinBox(
            value=last.slit_rows, min=1, max=MAX_TYPED, label="slit (rows)",
            tooltip="Slit width, the exposure in line periods: 1 row or more",
        )  # fmt: skip
        self.rate_hz = FloatSpinBox(
            value=last.frame_rate_hz or 0, min=0, max=MAX_TYPED, step=10, label="rate (Hz)",
            tooltip="Frame rate; 0 is the highest of the preset",
        )  # fmt: skip
        self.rate_hz.native.setSpecialValueText("highest")
        self.gain_db = FloatSpinBox(
            value=last.gain_db, min=0, max=MAX_TYPED, step=1, label="gain (dB)", tooltip="Camera gain"
        )
        self.connect, self.parking = push_button("Connect", self.toggle), push_button("Park", self.park)
        self.calibrate_simulated = push_button("Calibrate simulated rig", self.calibrate)
        self.open_file = push_button("Load calibration...", self._ask_for_file)
        self.save_file = push_button("Save calibration...", self._ask_where_to_save)
        self.forgetting = push_button("Forget calibration", self.forget)
        self.lag, self.bar = lag_button(), RequestBar()
        self.optics, self.status = text_label(), text_label()
        layout = panel_layout(self)
        self.rehearsal = Rehearsal()
        layout.addLayout(form_layout(self.rig, self.preset, self.slit_rows, self.rate_hz, self.gain_db))
        layout.addWidget(self.optics)
        layout.addLayout(button_row(self.connect, self.parking))
        layout.addLayout(button_row(self.open_file, self.save_file))
        layout.addLayout(button_row(self.forgetting, self.calibrate_simulated))
        for part in (self.bar, self.status, self.lag.native, self.rehearsal):
            layout.addWidget(part)
        layout.addStretch(1)
        bind_keys(self, {"park": self.park})
        self.lag.clicked.connect(self.measure_lag)
        for number in (self.slit_rows, self.rate_hz, self.gain_db):
            number.native.setKeyboardTracking(False)  # 120 Hz is not first 1, then 12 Hz
        for choice in (self.preset, self.slit_rows, self.rate_hz, self.gain_db):
            choice.changed.connect(self.apply)

    def _show_accepted(self) -> None:
        """Display the connected rig and the settings that it accepted last; without a rig the form remains."""
        accepted = self._shown = self.connection.settings
        if accepted is None:
            return
        values = (
            (self.preset, accepted.preset), (self.slit_rows, accepted.slit_rows),
            (self.rate_hz, accepted.frame_rate_hz or 0), (self.gain_db, accepted.gain_db),
        )  # fmt: skip
        for field, value in values:
            if field.value != value:  # what is being typed remains
                with field.changed.blocked():
                    field.value = value
        if self.connection.rig in self.rig.choices:
            self.rig.value = self.connection.rig

    def _optics(self) -> str:
        optics, rows = preset(self.preset.value).optics, self.slit_rows.value
        calibration = self.connection.calibration
        text = (
            f"slit {optics.um(rows):.1f} \N{MICRO SIGN}m, exposure {1e6 * optics.exposure_s(rows):.1f} \N{MICRO SIGN}s"
        )
        if calibration is not None and calibration.offset is not None:
            offset, um_per_px = calibration.offset.rows, calibration.um_per_px
            text += f"; offset {offset:.1f} rows"
            text += f", {offset * um_per_px:.1f} \N{MICRO SIGN}m" if um_per_px is not None else ""
        return text

    def _status_text(self, client: EngineClient | None, busy: bool) -> str:
        if client is None:
            doing = "Disconnecting..." if self._disconnecting else "Connecting..."
            return doing if busy else f"Not connected. {next_hint('press Connect.')}"
        status = client.status
        if status.progress is not None:
            return f"Calibrating: {status.progress}"
        lines = [f"<b>{self.connection.rig}</b> is connected, {'live' if status.live else 'idle'}."]
        lines += calibration_lines(self.connection.calibration, self.connection.calibration_file)
        lines += stale_lines(status)
        lines += [status.notice] if status.notice else []
        lines += [str(fault) for fault in status.faults]
        if busy:
            lines.append("Applying settings...")
        elif not status.live:
            lines.append(next_hint(self._next_action()))
        return "<br>".join(lines)

    def _next_action(self) -> str:
        """Return what to do with a connected rig that is idle."""
        if self.connection.calibration is not None:
            return "press Start in the Live tab."
        if is_simulated(self.connection.rig):
            return "press Calibrate simulated rig, or Start in the Live tab."
        return "calibrate in the Calibration tab, or press Load calibration..."

    def _ask_for_file(self) -> None:
        choose_file_to_read(self, "Calibration", dialog_filter(CALIBRATION), self.load)

    def _ask_where_to_save(self) -> None:
        kinds = dialog_filter(CALIBRATION)
        choose_file_to_write(self, "Save the calibration", "calibration.json", kinds, self.save)
