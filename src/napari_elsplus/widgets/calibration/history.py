"""Window with the history of calibrations: one number at a time over days, and what drifts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from qtpy.QtCore import Qt
from qtpy.QtWidgets import QComboBox, QDialog, QPushButton, QVBoxLayout

from napari_elsplus._problems import notify_errors
from napari_elsplus.io.formats.registry import PICTURE, TABLE, dialog_filter
from napari_elsplus.widgets.shared.calibration_state import amber
from napari_elsplus.widgets.shared.files import choose_file_to_write, choose_folder
from napari_elsplus.widgets.shared.panel import button_row, text_label
from napari_elsplus.widgets.shared.plots import ThemedPlot
from napari_elsplus.workflows.calibration_report.history import CalibrationHistory, calibration_history

if TYPE_CHECKING:
    from pathlib import Path

    from qtpy.QtWidgets import QWidget


class HistoryDialog(QDialog):
    """Plots the numbers of the calibrations in a folder; deleted when it is closed.

    Parameters
    ----------
    panel : QWidget
        The Calibration panel.
    theme : str
        Name of napari's theme.
    file : pathlib.Path or None
        A calibration in the folder; None if the user is to choose a folder.
    """

    def __init__(self, panel: QWidget, theme: str, file: Path | None) -> None:
        super().__init__(panel)
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.setWindowTitle("History of calibrations")
        self._panel = panel
        self.history = CalibrationHistory([], [])
        self.quantity, self.plot, self.notes = QComboBox(), ThemedPlot("", "", theme), text_label()
        self.choose, self.save = QPushButton("Folder..."), QPushButton("Save plot...")
        self.choose.setToolTip("Choose the folder of the calibrations; those of another rig or objective are left out")
        self.save.setToolTip("Save what is plotted as a picture (.png) or a table (.csv)")
        layout = QVBoxLayout(self)
        for widget in (self.quantity, self.plot, self.notes):
            layout.addWidget(widget)
        layout.addLayout(button_row(self.choose, self.save))
        self.quantity.currentIndexChanged.connect(self._draw)
        self.choose.clicked.connect(self._choose_folder)
        self.save.clicked.connect(self._save)
        self._draw()
        if file is not None:
            self.show_folder(file.parent)

    def show_folder(self, folder: Path) -> None:
        """Display the history of the calibrations in a folder."""
        with notify_errors(self._panel):
            self.history = calibration_history(folder)
            self.quantity.clear()
            self.quantity.addItems([trend.label for trend in self.history.trends])
            self._draw()

    def _draw(self) -> None:
        index = self.quantity.currentIndex()
        self.save.setEnabled(index >= 0)
        if index < 0:
            self.plot.draw([])
            self.notes.setText("Choose the folder in which the calibrations of this rig are saved.")
            return
        plot = self.history.trends[index].plot
        self.plot.draw(plot.curves, bottom=plot.bottom, left=plot.left)
        files = self.history.files
        plural = "s" if len(files) > 1 else ""
        counted = f"{len(files)} calibration{plural} in {files[-1].parent.name}"
        self.notes.setText("<br>".join([counted, *map(amber, self.history.warnings)]))

    def _choose_folder(self) -> None:
        choose_folder(self, "Folder of calibrations", self.show_folder)

    def _save(self) -> None:
        def save(path: Path) -> None:
            with notify_errors(self._panel):
                self.plot.save(path)

        choose_file_to_write(self, "Save the plot", "history.png", dialog_filter(PICTURE, TABLE), save)
