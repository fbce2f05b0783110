"""Base class of docked panels, and the helpers that they share: errors as notifications, buttons, scripts."""

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
    """A docked panel that disconnects from the viewer when it is removed from the window.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer it is docked to.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__()
        self.viewer = viewer
        self._connections: list[tuple[Any, Callable[..., None]]] = []

    def connect_signal(self, emitter: Any, slot: Callable[..., None]) -> None:
        """Connect a signal of the viewer until the panel is removed.

        Parameters
        ----------
        emitter : psygnal or napari event emitter
            Has ``connect`` and ``disconnect``.
        slot : callable
            Called with the event.
        """
        emitter.connect(slot)
        self._connections.append((emitter, slot))

    def cleanup(self) -> None:
        """Disconnect from the viewer; a panel that changed the viewer overrides this to restore it first."""
        for emitter, slot in self._connections:
            emitter.disconnect(slot)
        self._connections.clear()

    def event(self, event: QEvent | None) -> bool:
        """Call :meth:`cleanup` when the dock releases the panel: napari removes its parent then."""
        if event is not None and event.type() == QEvent.Type.ParentChange and self.parent() is None:
            self.cleanup()
        return bool(super().event(event))


@contextmanager
def notify_errors() -> Iterator[None]:
    """Return a context that shows an expected error as one notification, with its remedy."""
    try:
        yield
    except (ElsPlusError, OSError) as error:
        show_error(error_message(error))


def copy_as_script(text: str) -> None:
    """Copy text to the clipboard and confirm it in a notification."""
    clipboard = QApplication.clipboard()
    if clipboard is not None:
        clipboard.setText(text)
        show_info("script copied to the clipboard")


def set_enabled(button: PushButton, enabled: bool, does: str, first: str) -> None:
    """Enable or disable a button, with the reason in its tooltip.

    Parameters
    ----------
    button : magicgui.widgets.PushButton
        The button.
    enabled : bool
        True if it can be pressed.
    does : str
        What it does.
    first : str
        What the user has to do first where it is disabled.
    """
    button.enabled = enabled
    button.tooltip = does if enabled else f"{does}; first {first}"


def button_row(*buttons: Widget) -> QHBoxLayout:
    """Return a horizontal layout of buttons."""
    row = QHBoxLayout()
    for button in buttons:
        row.addWidget(button.native)
    return row
