"""The Live panel's fields and buttons; what they do is the panel's."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from magicgui.types import FileDialogMode
from magicgui.widgets import CheckBox, ComboBox, Container, FileEdit, FloatSpinBox, PushButton, SpinBox
from qtpy.QtGui import QKeySequence, QShortcut  # type: ignore[attr-defined] # where Qt 6 has it
from qtpy.QtWidgets import QLabel, QVBoxLayout, QWidget

from napari_elsplus.acquisition.engine.live_images import RAW, LiveView
from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
from napari_elsplus.io.settings import recall, remember
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.widgets.live.layers import KINDS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

SECTION: Final = "live"
ONCE, CONTINUOUS, FIXED = "once", "continuous", "fixed"
KEYS: Final = {"start": "Ctrl+Return", "record": "Ctrl+Shift+R", "snap": "Ctrl+Shift+P"}


class LiveForm:
    """Fields and buttons, laid out in a panel; what was chosen last time is chosen.

    Parameters
    ----------
    panel : QWidget
        What it fills.
    """

    def __init__(self, panel: QWidget) -> None:
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
        self._panel = panel
        self._lay_out()

    @property
    def chosen(self) -> list[str]:
        """The kinds of images that are to be shown."""
        return [kind for kind, box in self.kinds.items() if box.value]

    @property
    def plan(self) -> RecordingPlan:
        """How to record, from now on."""
        return RecordingPlan(
            self.next_path("recording"),
            frames=int(self.frames.value) or None,
            seconds=self.seconds.value or None,
            earlier_s=self.earlier_s.value,
        )

    @property
    def view(self) -> LiveView:
        """How images are to be made."""
        return LiveView(self.background.value, self.flat_field.value, CoreFilter(self.cores.value), self.average.value)

    def next_path(self, kind: str) -> Path:
        """Where a recording or a snap of this moment goes."""
        stamp = datetime.now().astimezone().strftime("%Y%m%d-%H%M%S-%f")[:-3]
        return Path(str(self.folder.value)) / f"{kind}-{stamp}.ome.tif"

    def remember(self) -> None:
        """Choose the same next time."""
        remember(
            SECTION, folder=str(self.folder.value), cores=self.cores.value, background=self.background.value,
            flat_field=self.flat_field.value, average=self.average.value, kinds=self.chosen,
            side_by_side=self.side_by_side.value,
        )  # fmt: skip

    def connect(self, slots: Mapping[str, Callable[[], Any]], view: Callable[[], Any]) -> None:
        """Say what the buttons do.

        Parameters
        ----------
        slots : mapping of str to callable
            One for each of the shortcuts' names.
        view : callable
            Called when images are to be made in another way.
        """
        for (name, slot), button in zip(slots.items(), (self.start, self.record, self.snapping), strict=True):
            button.clicked.connect(slot)
            QShortcut(QKeySequence(KEYS[name]), self._panel).activated.connect(slot)
        for choice in (self.background, self.flat_field, self.cores, self.average):
            choice.changed.connect(view)
        for box in (*self.kinds.values(), self.side_by_side):
            box.changed.connect(self.remember)

    def allow(self, *, live: bool, busy: bool, calibrating: bool, recording: bool) -> None:
        """Enable what can be done; what cannot says why.

        Parameters
        ----------
        live : bool
            Whether frames stream.
        busy : bool
            Whether the engine has yet to answer.
        calibrating, recording : bool
            What the engine does.
        """
        self.start.text = "Stop" if live else "Cancel calibration" if calibrating else "Start"
        self.start.enabled = live or calibrating or not busy
        self.record.text = "Finish recording" if recording else "Record"
        self.record.enabled = self.snapping.enabled = live
        why = "" if live else "; start the stream first"
        self.record.tooltip = f"Record raw frames and the calibration ({KEYS['record']}){why}"
        self.snapping.tooltip = f"Record the newest frame ({KEYS['snap']}){why}"

    def _lay_out(self) -> None:
        layout = QVBoxLayout(self._panel)
        rows: list[list[Any]] = [
            [self.start, self.record, self.snapping],
            list(self.kinds.values()),
            [self.side_by_side, self.background, self.flat_field],
        ]
        for row in rows:
            layout.addWidget(Container(widgets=row, layout="horizontal", labels=False).native)
        form = [
            self.contrast, self.cores, self.average, self.folder, self.seconds, self.frames, self.earlier_s
        ]  # fmt: skip
        layout.addWidget(Container(widgets=form, labels=True).native)
        layout.addWidget(self.script.native)
        layout.addWidget(self.status)
        layout.addStretch(1)


_TIPS: Final = {
    RAW: "The camera's frame with both views",
    Mode.LS.value: "Confocal view: line-scan confocal",
    Mode.RESIDUAL.value: "Residual view, aligned onto the confocal one",
    Mode.ELS.value: "Confocal minus residual of one frame: ELS+",
    Mode.ELSA.value: "Confocal of one frame minus residual of the next, for comparison",
}
