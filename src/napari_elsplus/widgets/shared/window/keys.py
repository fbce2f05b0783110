"""Keys of the panels: one table, free of napari's own keys, bound to the main window so that they act from any tab."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakMethod

from qtpy.QtGui import QKeySequence, QShortcut  # type: ignore[attr-defined] # where Qt 6 has it

from napari_elsplus.widgets.shared.window.main_window import when_docked

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from magicgui.widgets import PushButton
    from qtpy.QtWidgets import QMainWindow, QWidget

    from napari_elsplus.widgets.shared.engine_panel import EnginePanel

KEYS: Final = {
    "live": "Ctrl+Return",
    "record": "Ctrl+Shift+R",
    "snap": "Ctrl+Shift+F",
    "park": "Ctrl+Shift+X",
    "next step": "Ctrl+Shift+N",
    "mosaic": "Ctrl+Shift+M",
    "live mosaic": "Ctrl+Shift+L",
    "clear mosaic": "Ctrl+Shift+K",
    "undo segment": "Ctrl+Shift+U",
    "save mosaic": "Ctrl+Shift+E",
}
"""By action; none is a key of napari 0.9 (its command palette has Ctrl+Shift+P)."""


def key_name(action: str) -> str:
    """Return the name of an action's key as this platform writes it, for a tooltip."""
    return str(QKeySequence(KEYS[action]).toString(QKeySequence.SequenceFormat.NativeText))


def bind_keys(panel: QWidget, slots: Mapping[str, Callable[[], Any]]) -> None:
    """Bind the keys of actions for as long as a panel exists, in its whole window, also while its tab is hidden.

    Parameters
    ----------
    panel : QWidget
        The panel; may be docked later. Until then the keys act in the panel alone.
    slots : mapping of str to callable
        By action, a name in `KEYS`.
    """
    shortcuts = []
    for action, slot in slots.items():
        shortcut = QShortcut(QKeySequence(KEYS[action]), panel)
        shortcut.activated.connect(slot)
        panel.destroyed.connect(shortcut.deleteLater)
        shortcuts.append(shortcut)

    def widen(window: QMainWindow) -> None:
        for shortcut in shortcuts:
            shortcut.setParent(window)

    when_docked(panel, widen)


def bind_buttons(panel: EnginePanel, buttons: Mapping[str, PushButton]) -> None:
    """Bind keys that press buttons: nothing is done while a button is disabled, as by the mouse.

    Parameters
    ----------
    panel : EnginePanel
        As of :func:`bind_keys`; refreshed before, which enables and disables the buttons. It is not kept alive.
    buttons : mapping of str to magicgui.widgets.PushButton
        By action, a name in `KEYS`.
    """
    refresh = WeakMethod(panel.refresh)

    def press(button: PushButton) -> None:
        if (enable := refresh()) is not None:
            enable()
        button.native.click()

    bind_keys(panel, {action: partial(press, button) for action, button in buttons.items()})
