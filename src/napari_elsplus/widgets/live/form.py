"""Fields and buttons of the Live panel."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from magicgui.types import FileDialogMode
from magicgui.widgets import CheckBox, ComboBox, FileEdit, FloatSpinBox, PushButton, SpinBox

from napari_elsplus.acquisition.engine.live_images import RAW, LiveView
from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
from napari_elsplus.io.settings import remember
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.widgets.live.layers import KINDS
from napari_elsplus.widgets.shared.calibration_state import lag_button
from napari_elsplus.widgets.shared.panel import (
    button_row,
    form_layout,
    panel_layout,
    restore_boxes,
    restore_fields,
    set_enabled,
    text_label,
)
from napari_elsplus.widgets.shared.requests import RequestBar
from napari_elsplus.widgets.shared.window.keys import bind_buttons, key_name

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from napari_elsplus.widgets.shared.engine_panel import EnginePanel

SECTION: Final = "live"
ONCE, CONTINUOUS, FIXED = "once", "continuous", "fixed"
DEFAULT_KINDS: Final = (Mode.LS.value, Mode.ELS.value)
DEFAULT_LIMIT_S: Final = 10.0
"""Default duration of a recording, seconds; chosen: 1.7 GB at 240 Hz, and several passes over a lesion."""


class LiveForm:
    """Fields and buttons in a panel, with the values of the last session.

    Parameters
    ----------
    panel : EnginePanel
        The panel that contains them.
    """

    def __init__(self, panel: EnginePanel) -> None:
        self.start, self.record, self.snapping = (
            PushButton(text=word) for word in ("Start", "Record", "Save one frame")
        )
        self.start.tooltip = f"Start or stop the stream ({key_name('live')})"
        self.script = PushButton(
            text="Copy as script", tooltip="Copy a Python script that streams and records with these settings"
        )
        self.kinds = {
            kind: CheckBox(value=kind in DEFAULT_KINDS, text=title, tooltip=_TIPS[kind])
            for kind, title in KINDS.items()
        }
        self.side_by_side = CheckBox(
            value=True,
            text="side by side",
            tooltip="Images side by side, or in one place",
        )
        self.contrast = ComboBox(
            choices=[ONCE, CONTINUOUS, FIXED], label="contrast",
            tooltip="Contrast limits from the first frame with light, updated every second, or set by the user only",
        )  # fmt: skip
        self.background = CheckBox(value=True, text="background", tooltip="Subtract the background of the calibration")
        self.flat_field = CheckBox(value=False, text="flat field", tooltip="Divide by the calibration's flat field")
        self.row_reference = CheckBox(
            value=True, text="row reference",
            tooltip="Subtract the camera's row noise where the dark pixels beside the bundle show it",
        )  # fmt: skip
        self.cores = ComboBox(
            choices=[kind.value for kind in CoreFilter],
            value=CoreFilter.NONE.value,
            label="core filter",
            tooltip="Suppression of the core pattern (honeycomb)",
        )  # fmt: skip
        self.average = SpinBox(
            value=1, min=1, max=64, label="running average (frames)",
            tooltip="Exponential running average: weight of a new frame is 1/N, N from 1 to 64",
        )  # fmt: skip
        self.folder = FileEdit(
            value=Path.home(),
            mode=FileDialogMode.EXISTING_DIRECTORY,
            label="recording folder",
            tooltip="Folder for recordings and single frames",
        )
        self.seconds = FloatSpinBox(
            value=DEFAULT_LIMIT_S,
            min=0,
            max=36000,
            label="duration limit (s)",
            tooltip="Duration of a recording; 0: limited by frames, or until it is stopped",
        )
        self.frames = FloatSpinBox(  # of whole numbers: napari's spin box of integers shows no special text
            value=0,
            min=0,
            max=10_000_000,
            step=1,
            label="frame limit",
            tooltip="Frames of a recording; 0: limited by duration, or until it is stopped",
        )
        self.frames.native.setDecimals(0)
        for limit in (self.seconds, self.frames):
            limit.native.setSpecialValueText("no limit")
        self.pretrigger_s = FloatSpinBox(
            value=0,
            min=0,
            max=1.9,
            step=0.5,
            label="pre-trigger (s)",
            tooltip="Include the last seconds before Record is pressed, 0 to 1.9 s",
        )
        self.lag, self.bar = lag_button(), RequestBar()
        self.opening = PushButton(text="Open it", visible=False)
        self.status = text_label()
        self._remembered = {
            "side_by_side": self.side_by_side, "background": self.background, "flat_field": self.flat_field,
            "row_reference": self.row_reference, "cores": self.cores, "average": self.average, "folder": self.folder,
            "seconds": self.seconds,
        }  # fmt: skip
        restore_fields(SECTION, self._remembered)
        restore_boxes(SECTION, "kinds", self.kinds)
        self._panel = panel
        self._build_layout()

    @property
    def chosen(self) -> list[str]:
        """Selected kinds of images."""
        return [kind for kind, box in self.kinds.items() if box.value]

    def choose_some(self) -> None:
        """Tick the images of the first session where none is ticked, as after all layers were removed."""
        if not self.chosen:
            for kind in DEFAULT_KINDS:
                self.kinds[kind].value = True

    @property
    def plan(self) -> RecordingPlan:
        """Recording as set in the form, with a new file name."""
        return RecordingPlan(
            self.next_path("recording"),
            frames=int(self.frames.value) or None,
            seconds=self.seconds.value or None,
            earlier_s=self.pretrigger_s.value,
        )

    @property
    def view(self) -> LiveView:
        """Processing of live images as set in the form."""
        return LiveView(
            self.background.value, self.flat_field.value, CoreFilter(self.cores.value), self.average.value,
            row_reference=self.row_reference.value,
        )  # fmt: skip

    @view.setter
    def view(self, view: LiveView) -> None:
        for name in ("background", "flat_field", "cores", "average", "row_reference"):
            field = getattr(self, name)
            with field.changed.blocked():
                field.value = getattr(view, name)

    def next_path(self, kind: str) -> Path:
        """Return the path of a new file in the folder, with the present time in its name.

        Parameters
        ----------
        kind : str
            First part of the name, ``recording`` or ``snap``.
        """
        stamp = datetime.now().astimezone().strftime("%Y%m%d-%H%M%S-%f")[:-3]
        return Path(str(self.folder.value)) / f"{kind}-{stamp}.ome.tif"

    def remember(self) -> None:
        """Save the values for the next session."""
        values = {key: field.value for key, field in self._remembered.items()} | {"folder": str(self.folder.value)}
        remember(SECTION, kinds=self.chosen, **values)

    def connect(self, slots: Mapping[str, Callable[[], Any]], view: Callable[[], Any]) -> None:
        """Connect buttons and shortcuts.

        Parameters
        ----------
        slots : mapping of str to callable
            By action: live, record, snap.
        view : callable
            Called when the processing of live images changes.
        """
        buttons = dict(zip(slots, (self.start, self.record, self.snapping), strict=True))
        for name, button in buttons.items():
            button.clicked.connect(slots[name])
        bind_buttons(self._panel, buttons)
        for choice in (self.background, self.flat_field, self.row_reference, self.cores, self.average):
            choice.changed.connect(view)
        for box in (*self.kinds.values(), self.side_by_side):
            box.changed.connect(self.remember)

    def set_enabled(self, *, live: bool, busy: bool, calibrating: bool, recording: bool) -> None:
        """Enable the buttons that can be used; the tooltips of the others state the reason.

        Parameters
        ----------
        live : bool
            Frames are streaming.
        busy : bool
            A request to the engine is outstanding.
        calibrating, recording : bool
            Activity of the engine.
        """
        self.start.text = "Stop" if live else "Cancel calibration" if calibrating else "Start"
        self.start.enabled = live or calibrating or not busy
        self.record.text = "Stop recording" if recording else "Record"
        records = f"Record raw frames and the calibration ({key_name('record')})"
        set_enabled(self.record, live, records, "start the stream")
        snaps = f"Save the newest raw frame and the calibration ({key_name('snap')})"
        set_enabled(self.snapping, live, snaps, "start the stream")

    def show_opening(self, *, recorded: bool, hidden: bool) -> None:
        """Show the button that opens the newest recording, or displays live images again in its place.

        Parameters
        ----------
        recorded : bool
            There is a recording that has ended.
        hidden : bool
            Frames are streaming, and their images are hidden.
        """
        self.opening.visible = recorded or hidden
        self.opening.text = "Show live images" if hidden else "Open it"
        self.opening.tooltip = (
            "Display the live images again, in place of what covers them"
            if hidden
            else "Open the newest recording as layers, in place of the live images"
        )

    def _build_layout(self) -> None:
        layout = panel_layout(self._panel)
        layout.addLayout(button_row(self.start, self.record, self.snapping))
        layout.addLayout(button_row(*self.kinds.values()))
        layout.addLayout(button_row(self.side_by_side, self.row_reference))
        layout.addLayout(button_row(self.background, self.flat_field))
        layout.addLayout(
            form_layout(
                self.contrast, self.cores, self.average, self.folder, self.seconds, self.frames, self.pretrigger_s
            )
        )
        layout.addWidget(self.script.native)
        layout.addWidget(self.bar)
        layout.addWidget(self.status)
        layout.addWidget(self.opening.native)
        layout.addWidget(self.lag.native)
        layout.addStretch(1)


_TIPS: Final = {
    RAW: "The camera's frame with both views",
    Mode.LS.value: "Confocal view: line-scan confocal",
    Mode.RESIDUAL.value: "Residual view, aligned onto the confocal one",
    Mode.ELS.value: "Confocal minus residual of one frame: ELS+",
    Mode.ELSA.value: "Confocal of one frame minus residual of the next, for comparison",
}
