"""The Rig panel: which rig, how it runs, and whether it is well."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from magicgui.widgets import ComboBox, Container, FloatSpinBox, PushButton, SpinBox
from napari.utils.notifications import show_info
from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QFileDialog, QLabel, QVBoxLayout

from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.errors import InputError
from napari_elsplus.hardware.rig import SIMULATED
from napari_elsplus.hardware.rigs import rig_names
from napari_elsplus.instrument.optics import PRESETS, preset
from napari_elsplus.io import read_calibration, write_calibration
from napari_elsplus.io.formats.registry import CALIBRATION, dialog_filter
from napari_elsplus.io.settings import recall, remember, set_active_calibration
from napari_elsplus.widgets.shared.engine_panel import EnginePanel
from napari_elsplus.widgets.shared.panel import told

if TYPE_CHECKING:
    import napari.viewer

    from napari_elsplus.acquisition.link.client import EngineClient

SECTION: Final = "rig"
STATUS_MS: Final = 200
WIDEST_SLIT_ROWS: Final = 60


def remembered_rig() -> str:
    """Return the rig that was used last, the simulated one at first."""
    name = recall(SECTION).get("name", SIMULATED)
    return name if name in rig_names() else SIMULATED


def remembered_settings() -> Settings:
    """Return the settings that were used last."""
    known = recall(SECTION)
    chosen = known.get("preset", "240hz")
    rate = known.get("frame_rate_hz")
    return Settings(
        chosen if chosen in PRESETS else "240hz", int(known.get("slit_rows", 3)), rate, float(known.get("gain_db", 0.0))
    )


class RigPanel(EnginePanel):
    """Connect to a rig and set it up.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer)
        self._closes = False
        self._build()
        self._timer = QTimer(self)
        self._timer.setInterval(STATUS_MS)
        self._timer.timeout.connect(self.refresh)
        self._timer.start()
        self.refresh()

    @property
    def settings(self) -> Settings:
        """What the form says."""
        rate = self.rate_hz.value
        return Settings(self.preset.value, self.slit_rows.value, rate if rate > 0 else None, self.gain_db.value)

    def toggle(self) -> None:
        """Connect, or disconnect."""
        self._closes = self.connection.client is not None
        if self._closes:
            self.asking.do(self.connection.disconnect)
            return
        rig, settings = self.rig.value, self.settings
        self._remember()
        self.asking.do(lambda: self.connection.connect(rig, settings), self._connected)

    def apply(self) -> None:
        """Set the rig up as the form says; a running stream starts again with a ramp that fits."""
        self._remember()
        client = self.connection.client
        if client is not None:
            self.asking.ask(client.configure(self.settings))
        self.refresh()

    def park(self) -> None:
        """Take the line off the bundle."""
        client = self.connection.client
        if client is not None:
            self.asking.ask(client.park())

    def calibrate(self) -> None:
        """Let the simulated rig calibrate itself, or give that up."""
        client = self.connection.client
        if client is None:
            return
        if client.status.progress is not None:
            self.asking.ask(client.cancel())
        else:
            self.asking.ask(client.calibrate_simulated())

    def load(self, path: Path) -> None:
        """Put a calibration file into force."""
        with told():
            calibration = read_calibration(path)
            self.connection.require()
            self.asking.ask(self.connection.take(calibration, path), lambda _: set_active_calibration(path))

    def save(self, path: Path) -> None:
        """Write the calibration that all panels work by; recordings without one of their own are shown with it."""
        calibration = self.connection.calibration
        with told():
            if calibration is None:
                raise InputError("there is no calibration to save", "calibrate first")
            written = write_calibration(path, calibration, force=True)
            set_active_calibration(written)
            self.asking.ask(self.connection.take(calibration, written), lambda _: show_info(f"saved {written.name}"))

    def refresh(self) -> None:
        """Show how the rig is, and what can be done."""
        client, busy = self.connection.client, self.asking.busy
        connected = client is not None
        simulated = self.connection.rig == SIMULATED
        progress = client.status.progress if client is not None else None
        self.connect.text = "Disconnect" if connected else "Connect"
        self.connect.enabled = not busy or progress is not None
        self.connect.tooltip = "Park, and let camera and mirror go" if connected else "Open camera and mirror"
        self.rig.enabled = not connected and not busy
        self.parking.enabled = self.open_file.enabled = connected
        self.parking.tooltip = "Take the line off the bundle" if connected else "Connect first"
        self.open_file.tooltip = "Put a calibration file into force" if connected else "Connect first"
        self.save_file.enabled = self.connection.calibration is not None
        self.save_file.tooltip = (
            "Write the calibration, and show recordings that have none of their own with it"
            if self.save_file.enabled
            else "There is none yet"
        )
        self.by_itself.enabled = connected and simulated
        self.by_itself.text = "Cancel calibration" if progress is not None else "Calibrate itself"
        self.by_itself.tooltip = (
            "Offset, sweep, bundle pair, lag and background, without a hand"
            if simulated
            else "Only the simulated rig changes its targets by itself; use the Calibration panel"
        )
        self.optics.setText(self._optics())
        self.status.setText(self._said(client, busy))

    def cleanup(self) -> None:
        """Let go of the engine and the viewer."""
        self._timer.stop()
        super().cleanup()

    def _build(self) -> None:
        known = remembered_settings()
        self.rig = ComboBox(
            choices=rig_names(), value=remembered_rig(), label="rig", tooltip="`doctor` lists what is seen"
        )
        self.preset = ComboBox(
            choices=list(PRESETS), value=known.preset, label="preset", tooltip="Camera region and objective"
        )
        self.slit_rows = SpinBox(
            value=known.slit_rows, min=1, max=WIDEST_SLIT_ROWS, label="slit (rows)",
            tooltip=f"Width of the rolling slit, the exposure in line periods: 1 to {WIDEST_SLIT_ROWS} rows",
        )  # fmt: skip
        self.rate_hz = FloatSpinBox(
            value=known.frame_rate_hz or 0, min=0, max=240, step=10, label="rate (Hz)",
            tooltip="Frames per second, up to 240; 0 is the preset's highest",
        )  # fmt: skip
        self.rate_hz.native.setSpecialValueText("highest")
        self.gain_db = FloatSpinBox(
            value=known.gain_db, min=0, max=24, step=1, label="gain (dB)", tooltip="Camera gain, 0 to 24 dB"
        )
        self.connect, self.parking = PushButton(text="Connect"), PushButton(text="Park")
        self.by_itself = PushButton(text="Calibrate itself")
        self.open_file, self.save_file = PushButton(text="Load calibration..."), PushButton(text="Save calibration...")
        self.optics, self.status = QLabel(), QLabel()
        for label in (self.optics, self.status):
            label.setWordWrap(True)
        form = Container(widgets=[self.rig, self.preset, self.slit_rows, self.rate_hz, self.gain_db], labels=True)
        buttons = Container(widgets=[self.connect, self.parking], layout="horizontal", labels=False)
        files = [self.by_itself, self.open_file, self.save_file]
        calibration = Container(widgets=files, layout="horizontal", labels=False)
        layout = QVBoxLayout(self)
        for part in (form.native, self.optics, buttons.native, calibration.native, self.status):
            layout.addWidget(part)
        layout.addStretch(1)
        self.connect.clicked.connect(self.toggle)
        self.parking.clicked.connect(self.park)
        self.by_itself.clicked.connect(self.calibrate)
        self.open_file.clicked.connect(self._ask_for_file)
        self.save_file.clicked.connect(self._ask_where_to_save)
        for choice in (self.preset, self.slit_rows, self.rate_hz, self.gain_db):
            choice.changed.connect(self.apply)

    def _connected(self, client: EngineClient) -> None:
        self.activate_calibration(client)

    def _remember(self) -> None:
        settings = self.settings
        remember(
            SECTION, name=self.rig.value, preset=settings.preset, slit_rows=settings.slit_rows,
            frame_rate_hz=settings.frame_rate_hz, gain_db=settings.gain_db,
        )  # fmt: skip

    def _optics(self) -> str:
        optics, rows = preset(self.preset.value).optics, self.slit_rows.value
        calibration = self.connection.calibration
        words = (
            f"slit {optics.um(rows):.1f} \N{MICRO SIGN}m, exposure {1e6 * optics.exposure_s(rows):.1f} \N{MICRO SIGN}s"
        )
        if calibration is not None and calibration.offset is not None:
            offset = calibration.offset.rows
            words += f"; offset {offset:.1f} rows, {optics.um(offset):.1f} \N{MICRO SIGN}m"
        return words

    def _said(self, client: EngineClient | None, busy: bool) -> str:
        if client is None:
            doing = "Closing..." if self._closes else "Connecting..."
            return doing if busy else "Not connected."
        status = client.status
        if status.progress is not None:
            return f"Calibrating: {status.progress.step}, {status.progress.done} of {status.progress.total}"
        lines = [f"<b>{self.connection.rig}</b> is connected, {'live' if status.live else 'at rest'}."]
        if client.calibration is None:
            lines.append("It has no calibration.")
        lines += [f"Stale: {section} ({reason})" for section, reason in status.stale.items()]
        lines += [str(fault) for fault in status.faults]
        return "<br>".join(lines)

    def _ask_for_file(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Calibration", "", dialog_filter(CALIBRATION))
        if path:
            self.load(Path(path))

    def _ask_where_to_save(self) -> None:
        path, _ = QFileDialog.getSaveFileName(
            self, "Save the calibration", "calibration.json", dialog_filter(CALIBRATION)
        )
        if path:
            self.save(Path(path))
