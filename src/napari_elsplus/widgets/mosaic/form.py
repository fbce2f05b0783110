"""Fields and buttons of the Mosaic panel."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from magicgui.types import FileDialogMode
from magicgui.widgets import CheckBox, ComboBox, FileEdit, PushButton

from napari_elsplus.io.settings import remember
from napari_elsplus.processing.images.modes import COMPARED_MODES, Mode
from napari_elsplus.processing.mosaicing.mosaic import Insertion
from napari_elsplus.processing.tracking.registry import tracking_methods
from napari_elsplus.widgets.mosaic.sources import are_finished_images, source_names
from napari_elsplus.widgets.mosaic.speed_bar import SpeedBar
from napari_elsplus.widgets.shared.choosing import SAMPLE, LayerChoice, is_uncalibrated
from napari_elsplus.widgets.shared.panel import (
    button_row,
    form_layout,
    panel_layout,
    restore_boxes,
    restore_fields,
    set_enabled,
    text_label,
)
from napari_elsplus.widgets.shared.window.keys import bind_buttons, key_name
from napari_elsplus.workflows.mosaic_plan import MosaicPlan

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import napari.viewer
    from qtpy.QtWidgets import QWidget

    from napari_elsplus.widgets.shared.engine_panel import EnginePanel

SECTION: Final = "mosaic"
INSERTION_LABELS: Final = {
    Insertion.DEAD_LEAF.value: "newest on top",
    Insertion.FEATHERED.value: "feathered mean",
    Insertion.CORES.value: "core by core (finer)",
}
SAVED: Final = "wait until it is saved"
METHOD_LABELS: Final = {"elsplus": "this software", "paper": "Thrapp 2021"}


class MosaicForm:
    """Fields and buttons in a panel, with the values of the last session.

    Parameters
    ----------
    panel : EnginePanel
        The panel that contains them.
    work : QWidget
        The progress bar.
    viewer : napari.Viewer
        The viewer whose layers are offered.
    """

    def __init__(self, panel: EnginePanel, work: QWidget, viewer: napari.viewer.Viewer) -> None:
        tip = "A raw recording, or any stack of images of a moving probe"
        self.recording = LayerChoice(viewer, source_names, "stack", tip)
        self.calibration = FileEdit(
            label="calibration", mode=FileDialogMode.EXISTING_FILE, filter="*.json", nullable=True,
            tooltip="A calibration file; empty: the recording's own",
        )  # fmt: skip
        self.finished = CheckBox(
            value=False, text="finished images", visible=False,
            tooltip="The stack contains images of another microscope, as they are: one view, without a calibration",
        )  # fmt: skip
        self.modes = {
            mode: CheckBox(value=mode is Mode.ELS, text=mode.label, tooltip=_TIPS[mode]) for mode in COMPARED_MODES
        }
        self.modes_note = text_label()
        self.modes_note.setText(MODES_ARE_LIVE)
        methods, insertions = tracking_methods(), [i.value for i in Insertion]
        self.method = ComboBox(
            choices=[(METHOD_LABELS.get(name, name), name) for name in methods],
            label="method",
            tooltip="; ".join(
                f"{METHOD_LABELS.get(name, name)}: {method.description}" for name, method in methods.items()
            ),
        )  # fmt: skip
        self.insertion = ComboBox(
            choices=[(INSERTION_LABELS.get(name, name), name) for name in insertions],
            label="insertion",
            tooltip="How overlapping frames are combined",
        )  # fmt: skip
        self.start, self.going_live = PushButton(text="Mosaic"), PushButton(text="Live mosaic")
        self.clearing, self.undoing = PushButton(text="Clear"), PushButton(text="Undo segment")
        self.saving = PushButton(text="Save...")
        self.script = PushButton(
            text="Copy as script", tooltip="Copy a Python script that makes and saves these mosaics"
        )
        self.opening = PushButton(text="Open file...", tooltip="Open a recording as layers")
        self.speed = SpeedBar(viewer.theme)
        self.status = text_label()
        restore_fields(SECTION, {"method": self.method, "insertion": self.insertion})
        restore_boxes(SECTION, "modes", {mode.value: box for mode, box in self.modes.items()})
        self._panel = panel
        self._build_layout(work)

    @property
    def plan(self) -> MosaicPlan:
        """Modes, method and insertion as set in the form."""
        modes = tuple(mode for mode, box in self.modes.items() if box.value)
        return MosaicPlan(modes, str(self.method.value), Insertion(self.insertion.value))

    @property
    def calibration_file(self) -> Path | None:
        """The calibration file, if one is selected; it may have been moved since."""
        path = self.calibration.value
        return path if isinstance(path, Path) else None

    def remember(self) -> None:
        """Save the values for the next session."""
        plan = self.plan
        remember(SECTION, method=plan.method, insertion=plan.insertion.value, modes=[mode.value for mode in plan.modes])

    def connect(self, slots: Mapping[str, Callable[[], Any]], plain: Mapping[str, Callable[[], Any]]) -> None:
        """Connect buttons and shortcuts.

        Parameters
        ----------
        slots : mapping of str to callable
            By action, a name in the table of keys.
        plain : mapping of str to callable
            ``open`` and ``script``, which have no shortcut.
        """
        buttons = {
            "mosaic": self.start, "live mosaic": self.going_live, "clear mosaic": self.clearing,
            "undo segment": self.undoing, "save mosaic": self.saving,
        }  # fmt: skip
        for name, slot in slots.items():
            buttons[name].clicked.connect(slot)
        bind_buttons(self._panel, buttons)
        self.opening.clicked.connect(plain["open"])
        self.script.clicked.connect(plain["script"])

    def set_enabled(
        self, *, busy: bool, saving: bool, requesting: bool, present: bool, live: bool, cancels: str
    ) -> None:
        """Enable the buttons that can be used; the tooltips of the others state the reason.

        Parameters
        ----------
        busy : bool
            Mosaics of a stack are being made, or saved.
        saving : bool
            They are being saved, which cannot be stopped.
        requesting : bool
            A request to the engine is outstanding.
        present : bool
            There is a mosaic.
        live : bool
            The engine is making a mosaic.
        cancels : str
            Text of the button while it cancels what the engine does instead; else empty.
        """
        layer = self.recording.layer
        self.finished.visible = is_uncalibrated(layer)
        ticked, given = bool(self.finished.value), self.calibration_file is not None
        self.modes_note.setVisible(layer is not None and are_finished_images(layer, ticked=ticked, calibrated=given))
        self.going_live.text = cancels or ("Stop live" if live else "Live mosaic")
        self.going_live.enabled = bool(cancels) or not (busy or requesting)
        self.going_live.tooltip = (
            f"Stop inserting frames, after the last loop closures; the mosaic remains ({key_name('live mosaic')})"
            if live
            else f"Insert frames of the connected rig into mosaics of the selected modes ({key_name('live mosaic')})"
        )
        self.start.text = "Stop" if busy and not saving else "Mosaic"
        makes = f"Make mosaics of the selected stack, or stop ({key_name('mosaic')})"
        first = SAVED if saving else f"open a recording, or {SAMPLE}"
        set_enabled(self.start, not saving and (busy or bool(self.recording.choices)), makes, first)
        first = SAVED if saving else "wait until it is finished, or stop" if busy else "make a mosaic"
        set_enabled(self.clearing, present and not saving, f"Remove the mosaics ({key_name('clear mosaic')})", first)
        undoes = f"Remove the last segment of the track ({key_name('undo segment')})"
        set_enabled(self.undoing, present and not busy, undoes, first)
        saves = f"Save OME-TIFF, PNG with scale bar, and track ({key_name('save mosaic')})"
        set_enabled(self.saving, present and not busy, saves, first)

    def _build_layout(self, work: QWidget) -> None:
        layout = panel_layout(self._panel)
        layout.addLayout(form_layout(self.recording, self.calibration, self.method, self.insertion))
        layout.addWidget(self.finished.native)
        for row in (
            list(self.modes.values()),
            [self.start, self.going_live],
            [self.clearing, self.undoing],
            [self.saving, self.script],
            [self.opening],
        ):
            layout.addLayout(button_row(*row))
            if row[0] in self.modes.values():
                layout.addWidget(self.modes_note)
        for widget in (work, self.speed, self.status):
            layout.addWidget(widget)
        layout.addStretch(1)


MODES_ARE_LIVE: Final = "LS, ELSA and ELS+ are of the live mosaic; finished images are inserted as they are."
_TIPS: Final = {
    Mode.LS: "Confocal view: line-scan confocal",
    Mode.ELSA: "Confocal of one frame minus residual of the next, for comparison; live only with LS or ELS+",
    Mode.ELS: "Confocal minus residual of one frame: ELS+; used for tracking if selected",
}
