"""Button that rehearses faults on the simulated rig, its progress, and the table of results."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from qtpy.QtCore import Qt
from qtpy.QtGui import QColor
from qtpy.QtWidgets import QDialog, QLabel, QTableWidget, QTableWidgetItem, QVBoxLayout, QWidget

from napari_elsplus.widgets.shared.panel import push_button, text_label
from napari_elsplus.widgets.shared.work import Work

if TYPE_CHECKING:
    from collections.abc import Sequence

    from napari_elsplus.diagnosis.rehearsal.row import Row

HEADINGS: Final = ("fault", "held", "parked (s)", "limit (s)", "frames lost", "silently", "promise", "message")
"""Columns of the table."""
NOT_HELD: Final = "#d03030"
"""Colour of a promise that was not held."""
TOOLTIP: Final = (
    "Inject every fault into the simulated rig's devices and processes, and compare what happens with what is promised;"
    " some minutes"
)
NOTICE: Final = "For research use. Parking by software replaces no hardware interlock."


class Rehearsal(QWidget):
    """A button that runs `napari_elsplus.diagnosis.rehearsal` in a thread, and shows its table."""

    def __init__(self) -> None:
        super().__init__()
        self._allowed = True
        self.button = push_button("Rehearse faults", self.start, TOOLTIP)
        self.work = Work(self._ended)
        self.table: QTableWidget | None = None
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        for part in (self.button.native, self.work, text_label(NOTICE)):
            layout.addWidget(part)

    def allow(self, allowed: bool) -> None:
        """Enable the button if `allowed`: no rig is connected, which would share the computer with the rehearsal."""
        self._allowed = allowed
        self.button.enabled = allowed and not self.work.busy
        self.button.tooltip = TOOLTIP if allowed else "Disconnect first: a rehearsal takes all of the computer"

    def start(self) -> None:
        """Rehearse in a thread."""
        from napari_elsplus.diagnosis.rehearsal.rehearse import faults  # loads more than a panel needs

        chosen = faults()

        def play() -> list[Row]:
            return [fault.rehearse() for fault in self.work.progress(chosen)]

        self.work.begin(len(chosen), play, self.show_table)
        self.button.enabled = False

    def show_table(self, rows: Sequence[Row]) -> None:
        """Show the results in a window of their own; `rows` that were not held are red."""
        dialog = QDialog(self)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        held = sum(row.held for row in rows)
        dialog.setWindowTitle(f"Rehearsal: {held} of {len(rows)} promises were held")
        self.table = table = QTableWidget(len(rows), len(HEADINGS))
        table.setHorizontalHeaderLabels(HEADINGS)
        for index, row in enumerate(rows):
            parked = "" if row.parked_s is None else f"{row.parked_s:.3f}"
            lost, silently = str(row.frames_lost), str(row.frames_lost_silently)
            values = (row.fault, "yes" if row.held else "NO", parked, f"{row.limit_s:.1f}", lost, silently)
            for column, value in enumerate((*values, row.promise, row.message)):
                item = QTableWidgetItem(value)
                if not row.held:
                    item.setForeground(QColor(NOT_HELD))
                table.setItem(index, column, item)
        table.resizeColumnsToContents()
        layout = QVBoxLayout(dialog)
        layout.addWidget(table)
        layout.addWidget(QLabel(NOTICE))
        dialog.resize(1100, 600)
        dialog.show()

    def cleanup(self) -> None:
        """End the rehearsal after the fault that is played."""
        self.work.cancel()

    def _ended(self) -> None:
        self.allow(self._allowed)
