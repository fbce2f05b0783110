"""File dialogs of the Calibration panel; an empty name is returned where none was chosen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from napari_elsplus.io import volts_beside
from napari_elsplus.io.formats.registry import CALIBRATION, PICTURE, TABLE, dialog_filter, recordings_filter
from napari_elsplus.processing.calibration.step import Capture
from napari_elsplus.widgets.shared.files import file_to_open, file_to_save

if TYPE_CHECKING:
    from collections.abc import Callable

    from qtpy.QtWidgets import QWidget

    from napari_elsplus.processing.calibration.step import CalibrationStep


def measure_chosen(panel: QWidget, step: CalibrationStep[Any], measure: Callable[[str, str | None], None]) -> None:
    """Measure a step of the panel from a chosen recording, and a table of voltages where none lies beside it."""
    frames = file_to_open(panel, f"Frames for the {step.title}", recordings_filter())
    if not frames:
        return
    volts = ""
    if step.capture is Capture.SWEEP and volts_beside(frames) is None:
        volts = file_to_open(panel, "Voltages, one per frame", dialog_filter(TABLE))
    measure(frames, volts or None)


def calibration_to_load(panel: QWidget) -> str:
    """Return the chosen calibration for a panel."""
    return file_to_open(panel, "Load a calibration", dialog_filter(CALIBRATION))


def where_to_save(panel: QWidget) -> str:
    """Return the chosen file for the calibration of a panel."""
    return file_to_save(panel, "Save the calibration", "calibration.json", dialog_filter(CALIBRATION))


def where_to_save_plots(panel: QWidget, key: str) -> str:
    """Return the chosen file for the plots of a panel's step, by its key."""
    return file_to_save(panel, "Save the plots", f"{key}.png", dialog_filter(PICTURE, TABLE))


def where_to_save_report(panel: QWidget) -> str:
    """Return the chosen file for the report of a panel's calibration."""
    return file_to_save(panel, "Save the report", "calibration.pdf", "Reports (*.pdf)")


def act_on(path: str, act: Callable[[str], None]) -> None:
    """Act on a path that was chosen in a dialog, if one was."""
    if path:
        act(path)
