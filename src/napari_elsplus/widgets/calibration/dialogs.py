"""Which files the Calibration panel reads and writes, as the user says; empty where none was chosen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from qtpy.QtWidgets import QFileDialog

from napari_elsplus.processing.calibration.draft import Step

if TYPE_CHECKING:
    from qtpy.QtWidgets import QWidget

CALIBRATIONS: Final = "Calibration (*.json)"
RECORDINGS: Final = "Recordings (*.tif *.tiff *.avi *.npy);;All files (*)"
PLOTS: Final = "Picture (*.png);;Table (*.csv)"


def recording_for(panel: QWidget, step: Step) -> tuple[str, str]:
    """Ask for the frames of a step, and for the voltages where it needs them."""
    frames, _ = QFileDialog.getOpenFileName(panel, f"Frames for the {step}", "", RECORDINGS)
    if not frames or step is not Step.GALVO:
        return frames, ""
    volts, _ = QFileDialog.getOpenFileName(panel, "Voltages, one per frame", "", "Table (*.csv)")
    return frames, volts


def calibration_to_load(panel: QWidget) -> str:
    """Ask for a calibration."""
    return QFileDialog.getOpenFileName(panel, "Load a calibration", "", CALIBRATIONS)[0]


def where_to_save(panel: QWidget) -> str:
    """Ask where the calibration goes."""
    return QFileDialog.getSaveFileName(panel, "Save the calibration", "calibration.json", CALIBRATIONS)[0]


def where_to_save_plots(panel: QWidget, step: Step) -> str:
    """Ask where the plots of a step go."""
    return QFileDialog.getSaveFileName(panel, "Save the plots", f"{step}.png", PLOTS)[0]
