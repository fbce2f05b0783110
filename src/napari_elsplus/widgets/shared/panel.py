"""What every docked panel shares: it tells errors once, and lets go of the viewer when it leaves the window."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from napari.utils.notifications import show_error, show_info
from qtpy.QtCore import QEvent
from qtpy.QtWidgets import QApplication, QHBoxLayout, QWidget

from napari_elsplus.errors import ElsPlusError, error_message

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import napari.viewer
    from magicgui.widgets import PushButton, Widget


class Panel(QWidget):
    """A docked panel.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer it is docked to.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__()
        self.viewer = viewer
        self._connections: list[tuple[Any, Callable[..., None]]] = []

    def listen(self, emitter: Any, slot: Callable[..., None]) -> None:
        """Connect a signal of the viewer until the panel goes."""
        emitter.connect(slot)
        self._connections.append((emitter, slot))

    def cleanup(self) -> None:
        """Disconnect from the viewer; a panel that changed it puts it back first."""
        for emitter, slot in self._connections:
            emitter.disconnect(slot)
        self._connections.clear()

    def event(self, event: QEvent | None) -> bool:
        """Clean up when the dock lets go of the panel: napari takes its parent away."""
        if event is not None and event.type() == QEvent.Type.ParentChange and self.parent() is None:
            self.cleanup()
        return bool(super().event(event))


@contextmanager
def told() -> Iterator[None]:
    """Show an error that the user can mend as one notification, its remedy in it."""
    try:
        yield
    except (ElsPlusError, OSError) as error:
        show_error(error_message(error))


def copy_as_script(text: str) -> None:
    """Put a script on the clipboard, and say so."""
    clipboard = QApplication.clipboard()
    if clipboard is not None:
        clipboard.setText(text)
        show_info("the script is on the clipboard")


def allow(button: PushButton, able: bool, does: str, first: str) -> None:
    """Enable a button or not; its tooltip says what it does and, where it cannot be pressed, what comes first."""
    button.enabled = able
    button.tooltip = does if able else f"{does}; first {first}"


def button_row(*buttons: Widget) -> QHBoxLayout:
    """Put buttons next to each other."""
    row = QHBoxLayout()
    for button in buttons:
        row.addWidget(button.native)
    return row
