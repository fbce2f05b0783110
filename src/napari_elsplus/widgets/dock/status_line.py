"""The status line of the ELS+ dock: rig, stream, active calibration, and the error that is not resolved yet."""

from __future__ import annotations

from html import escape
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Final

from qtpy.QtCore import Qt
from qtpy.QtWidgets import QGridLayout, QLabel, QToolButton, QWidget

from napari_elsplus._problems import problems
from napari_elsplus.hardware.parking import LASER_OFF, ParkStage
from napari_elsplus.io.settings import active_calibration
from napari_elsplus.processing.compilation import compilation_remark
from napari_elsplus.widgets.shared.calibration_state import amber, calibration_lines
from napari_elsplus.widgets.shared.panel import text_label

if TYPE_CHECKING:
    from napari_elsplus.acquisition.engine.status import Status
    from napari_elsplus.widgets.shared.connection import Connection

WARNING: Final = "\N{WARNING SIGN}"


class StatusLine(QWidget):
    """State of the instrument, common to all panels; an error stays until it is resolved or dismissed."""

    def __init__(self) -> None:
        super().__init__()
        self.state, self.problem = text_label(), text_label()
        for label in (self.state, self.problem):
            label.setTextFormat(Qt.TextFormat.RichText)
        self.problem.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.dismiss = QToolButton()
        self.dismiss.setText("\N{MULTIPLICATION SIGN}")
        self.dismiss.setToolTip("Dismiss this message")
        self.dismiss.clicked.connect(self._dismiss)
        layout = QGridLayout(self)
        layout.setContentsMargins(6, 2, 6, 4)
        layout.setColumnStretch(0, 1)
        layout.addWidget(self.state, 0, 0, 1, 2)
        layout.addWidget(self.problem, 1, 0)
        layout.addWidget(self.dismiss, 1, 1, Qt.AlignmentFlag.AlignTop)
        self._messages: list[str] = []
        self._fault = self._dismissed = ""
        self._show_problem()

    def update_from(self, connection: Connection) -> None:
        """Display the present state.

        Parameters
        ----------
        connection : Connection
            Shared by the panels.
        """
        client = connection.client
        status = None if client is None else client.status
        connecting = connection.connecting
        rig = connection.rig if client is not None else None
        lines = [rig_line(rig, status) if connecting is None else f"<b>connecting to {connecting}</b>..."]
        calibration, file = connection.calibration, connection.calibration_file
        first, *lacking = calibration_lines(calibration, active_calibration() if calibration is None else file)
        lines.append("; ".join([first, *lacking]))
        _set_text(self.state, "<br>".join(lines))
        self._fault = str(connection.died or "") or newest_fault(status)
        if self._fault != self._dismissed:
            self._dismissed = ""
        found = "" if self._dismissed else self._fault, problems.newest
        messages = [text for text in dict.fromkeys(found) if text]
        if messages != self._messages:
            self._messages = messages
            self._show_problem()

    def _dismiss(self) -> None:
        self._dismissed, self._messages = self._fault, []
        problems.dismiss()
        self._show_problem()

    def _show_problem(self) -> None:
        self.problem.setText("<br>".join(f"{amber(WARNING)} {escape(text)}" for text in self._messages))
        self.problem.setVisible(bool(self._messages))
        self.dismiss.setVisible(bool(self._messages))


def rig_line(rig: str | None, status: Status | None) -> str:
    """Return rig and stream in one line of rich text.

    Parameters
    ----------
    rig : str or None
        Name of the connected rig.
    status : Status or None
        Of its engine; None without a rig.
    """
    if rig is None or status is None:
        return "<b>no rig connected</b>"
    if status.progress is not None:
        doing = f"calibrating: {status.progress}"
    elif status.live:
        doing = f"live, camera {status.camera_hz:.0f} Hz" if isfinite(status.camera_hz) else "live"
    else:
        doing = "connected, not streaming"
    parking = status.park_state
    if parking.stage is ParkStage.NOT_PARKED:
        doing += f"; <b>{amber(escape(parking.message))}</b>"
    elif parking.parked:
        doing += "; galvo parked"
    recording = status.recording
    if recording is not None and recording.running:
        doing += f"; recording {Path(recording.path).name}"
    if status.track is not None and status.track.running:
        doing += "; live mosaic"
    if status.waiting:
        doing += f"; {amber(escape(status.waiting))}"
    if status.compiling:
        doing += f"; {compilation_remark(status.compiling)}"
    return f"<b>{rig}</b>: {doing}"


def newest_fault(status: Status | None) -> str:
    """Return the newest fault of a `status`, empty without one; not that the galvo did not park, once it has."""
    faults = () if status is None else status.faults
    if status is not None and status.park_state.parked:
        faults = tuple(fault for fault in faults if not fault.problem.startswith(LASER_OFF))
    return str(faults[-1]) if faults else ""


def _set_text(label: QLabel, text: str) -> None:
    if label.text() != text:
        label.setText(text)
