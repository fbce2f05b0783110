"""Which files the Calibration panel reads and writes, as the user says; empty where none was chosen."""

from __future__ import annotations

from typing import TYPE_CHECKING

from qtpy.QtWidgets import QFileDialog

from napari_elsplus.io.formats.registry import CALIBRATION, PICTURE, TABLE, dialog_filter, recordings_filter
from napari_elsplus.processing.calibration.draft import Step

if TYPE_CHECKING:
    from qtpy.QtWidgets import QWidget


def recording_for(panel: QWidget, step: Step) -> tuple[str, str]:
    """Ask for the frames of a step, and for the voltages where it needs them."""
    frames, _ = QFileDialog.getOpenFileName(panel, f"Frames for the {step}", "", recordings_filter())
    if not frames or step is not Step.GALVO:
        return frames, ""
    volts, _ = QFileDialog.getOpenFileName(panel, "Voltages, one per frame", "", dialog_filter(TABLE))
    return frames, volts


def calibration_to_load(panel: QWidget) -> str:
    """Ask for a calibration."""
    return QFileDialog.getOpenFileName(panel, "Load a calibration", "", dialog_filter(CALIBRATION))[0]


def where_to_save(panel: QWidget) -> str:
    """Ask where the calibration goes."""
    return QFileDialog.getSaveFileName(panel, "Save the calibration", "calibration.json", dialog_filter(CALIBRATION))[0]


def where_to_save_plots(panel: QWidget, step: Step) -> str:
    """Ask where the plots of a step go."""
    return QFileDialog.getSaveFileName(panel, "Save the plots", f"{step}.png", dialog_filter(PICTURE, TABLE))[0]
