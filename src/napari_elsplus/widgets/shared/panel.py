"""Base class of docked panels, one of a class in a window, and the helpers that they share: buttons, scripts."""

from __future__ import annotations

import gc
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar
from weakref import WeakSet

from magicgui.widgets import PushButton
from napari.utils.notifications import show_info
from qtpy.QtCore import QEvent, QTimer
from qtpy.QtWidgets import (
    QApplication,
    QDockWidget,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLayout,
    QLineEdit,
    QVBoxLayout,
    QWidget,
)

from napari_elsplus._problems import notify_errors, problems
from napari_elsplus.io.formats.registry import foreign_file
from napari_elsplus.io.settings import recall
from napari_elsplus.widgets.shared.files import note_folder
from napari_elsplus.widgets.shared.window.closing import WindowCloseFilter, may_discard
from napari_elsplus.widgets.shared.window.garbage import leave_out_present_objects
from napari_elsplus.widgets.shared.window.scrolling import PanelScrollArea

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import napari.viewer
    from magicgui.widgets import CheckBox, Widget
    from qtpy.QtCore import QMimeData, QObject
    from qtpy.QtGui import QDragEnterEvent, QDropEvent

PLUGIN: Final = "napari-elsplus"
MARGIN_PX: Final = 6
"""Around the content of a panel, pixels; chosen."""
P = TypeVar("P", bound="Panel")
_present: WeakSet[Panel] = WeakSet()


class _OnePerViewer(type(QWidget)):  # type: ignore[misc]
    """Returns the panel of a class that a viewer has already, in place of a second one."""

    def __call__(cls: type[P], viewer: napari.viewer.Viewer, *rest: Any, **options: Any) -> P:
        present = find_panel(cls, viewer)
        if present is None:
            present = super().__call__(viewer, *rest, **options)  # type: ignore[misc]
            if not _present:
                leave_out_present_objects(viewer)
            _present.add(present)
        return present


class Panel(QWidget, metaclass=_OnePerViewer):
    """A docked panel that disconnects from the viewer when it is removed from the window, or the window is closed.

    A viewer has one panel of a class: to construct it again returns the same, to be docked elsewhere. So nothing is
    displayed, measured or bound to a key twice.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer it is docked to.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__()
        self.viewer = viewer
        self._connections: list[tuple[Any, Callable[..., None]]] = []
        self._dock_name = ""
        self.setAcceptDrops(True)
        self._window_end = WindowCloseFilter(self, self.cleanup, self.unsaved, self.saving)

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

    def unsaved(self) -> str:
        """Return a question if closing the window would lose a result; else an empty string."""
        return ""

    def lost_with_dock(self) -> str:
        """Return a question if closing the panel's dock would lose a result; else an empty string."""
        return self.unsaved()

    def saving(self) -> bool:
        """Return True while a result is being written, for which the window waits before it closes."""
        return False

    def open_dropped(self, path: Path) -> None:
        """Open the file or folder at a dropped `path`: as layers, unless a panel overrides this."""
        with notify_errors(self):
            try:
                self.viewer.open(str(path), plugin=PLUGIN)
            except ValueError as error:  # napari's, where no reader of ours takes it
                raise foreign_file(path) from error

    def dragEnterEvent(self, event: QDragEnterEvent | None) -> None:
        """Accept files; see :meth:`QWidget.dragEnterEvent`."""
        if event is not None and _dropped_paths(event.mimeData()):
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent | None) -> None:
        """Open dropped files; see :meth:`QWidget.dropEvent`."""
        if event is None:
            return
        event.acceptProposedAction()
        for path in _dropped_paths(event.mimeData()):
            note_folder(path)
            self.open_dropped(path)

    def cleanup(self) -> None:
        """Disconnect from the viewer; a panel that changed the viewer overrides this to restore it first."""
        _present.discard(self)
        if not _present:
            gc.unfreeze()
        problems.resolve(self)
        for emitter, slot in self._connections:
            emitter.disconnect(slot)
        self._connections.clear()

    def event(self, event: QEvent | None) -> bool:
        """Call :meth:`cleanup` when the dock is closed: napari removes the panel's parent then.

        If something would be lost by that, and the user does not agree, the panel is docked again.
        """
        kind, dock = None if event is None else event.type(), self.parentWidget()
        if kind == QEvent.Type.ParentAboutToChange and isinstance(dock, QDockWidget):
            self._dock_name = dock.objectName()
        if kind == QEvent.Type.ParentChange and dock is None and self in _present:
            if may_discard(self, self.lost_with_dock()):
                self.cleanup()
            else:
                QTimer.singleShot(0, self._dock_again)
        return bool(super().event(event))

    def _dock_again(self) -> None:
        if self.parent() is None:  # not docked by a script meanwhile
            self.viewer.window.add_dock_widget(self, name=self._dock_name, area="right")


def find_panel(kind: type[P], viewer: napari.viewer.Viewer) -> P | None:
    """Return the panel of a class that a viewer has; None if there is none.

    Parameters
    ----------
    kind : type
        The class.
    viewer : napari.Viewer
        The viewer, or a proxy of it as napari gives it to plugins.
    """
    ours = _unwrapped(viewer)
    return next((panel for panel in _present if type(panel) is kind and _unwrapped(panel.viewer) is ours), None)


def panel_of(widget: QWidget | None) -> Panel | None:
    """Return the panel that contains a widget, or the widget if it is one; None outside of panels."""
    while widget is not None and not isinstance(widget, Panel):
        widget = widget.parentWidget()
    return widget


def _dropped_paths(data: QMimeData | None) -> list[Path]:
    return [Path(url.toLocalFile()) for url in data.urls() if url.isLocalFile()] if data is not None else []


def _unwrapped(viewer: napari.viewer.Viewer) -> object:
    return getattr(viewer, "__wrapped__", viewer)


def next_hint(action: str) -> str:
    """Return rich text that names the user's next action; empty where there is none."""
    return f"<b>Next:</b> {action}" if action else ""


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


def push_button(text: str, pressed: Callable[..., Any], tooltip: str = "") -> PushButton:
    """Return a button.

    Parameters
    ----------
    text : str
        On the button.
    pressed : callable
        Called when it is pressed.
    tooltip : str
        What it does.
    """
    button = PushButton(text=text, tooltip=tooltip)
    button.clicked.connect(pressed)
    return button


def text_label(text: str = "") -> QLabel:
    """Return a label of a text that is wrapped at the panel's width."""
    label = QLabel(text)
    label.setWordWrap(True)
    return label


def timer(
    parent: QObject, interval_ms: int, slot: Callable[[], Any], *, once: bool = False, starts: bool = False
) -> QTimer:
    """Return a timer.

    Parameters
    ----------
    parent : QObject
        Its owner.
    interval_ms : int
        Interval in milliseconds.
    slot : callable
        Called at each interval.
    once : bool
        Stop after the first interval.
    starts : bool
        It runs from now on.
    """
    new = QTimer(parent)
    new.setInterval(interval_ms)
    new.setSingleShot(once)
    new.timeout.connect(slot)
    if starts:
        new.start()
    return new


def panel_layout(panel: QWidget) -> QVBoxLayout:
    """Return the layout of a panel's rows, which scroll, with the margins that all panels have."""
    content = QWidget()
    outer, layout = QVBoxLayout(panel), QVBoxLayout(content)
    outer.setContentsMargins(0, 0, 0, 0)
    outer.addWidget(PanelScrollArea(content))
    layout.setContentsMargins(*[MARGIN_PX] * 4)
    return layout


def pin_below(panel: QWidget, row: QLayout) -> None:
    """Add a `row` of buttons below the rows of a `panel` that scroll, which has the layout of :func:`panel_layout`.

    They are in view on any screen, narrower than their texts on one too narrow for them.
    """
    outer, scroll = panel.layout(), panel.findChild(PanelScrollArea)
    assert isinstance(outer, QVBoxLayout)
    assert scroll is not None
    row.setContentsMargins(*[MARGIN_PX] * 4)
    outer.addLayout(row)
    for index in range(row.count()):
        item = row.itemAt(index)
        if item is not None and (button := item.widget()) is not None:
            button.setMinimumWidth(1)
    scroll.below = row


def button_row(*buttons: Widget | QWidget) -> QHBoxLayout:
    """Return a horizontal layout of buttons, of magicgui or Qt."""
    row = QHBoxLayout()
    for button in buttons:
        row.addWidget(button if isinstance(button, QWidget) else button.native)
    return row


def form_layout(*fields: Widget) -> QFormLayout:
    """Return a layout of labelled fields, aligned; a label has its field's tooltip, and names it to screen readers.

    Parameters
    ----------
    *fields : magicgui.widgets.Widget
        From top to bottom; their labels contain the unit. A button fills its row.
    """
    layout = QFormLayout()
    layout.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
    layout.setVerticalSpacing(4)
    for field in fields:
        if isinstance(field, PushButton):
            layout.addRow(field.native)
        else:
            label = QLabel(field.label)
            label.setToolTip(field.tooltip or "")
            for part in (field.native, *field.native.findChildren(QLineEdit)):
                part.setAccessibleName(field.label)
            layout.addRow(label, field.native)
    return layout


def restore_fields(section: str, fields: Mapping[str, Any]) -> None:
    """Give fields the values of the last session; one that a field does not take leaves its default.

    Parameters
    ----------
    section : str
        Of the settings.
    fields : mapping of str to magicgui.widgets.bases.ValueWidget
        By the keys of their values.
    """
    for key, value in recall(section).items():
        if key in fields:
            with suppress(ValueError, TypeError):
                fields[key].value = value


def restore_boxes(section: str, key: str, boxes: Mapping[str, CheckBox]) -> None:
    """Tick the boxes that were ticked in the last session.

    Parameters
    ----------
    section, key : str
        Of the settings, where the names of the ticked boxes are.
    boxes : mapping of str to magicgui.widgets.CheckBox
        By their names.
    """
    ticked = recall(section).get(key)
    if isinstance(ticked, list):
        for name, box in boxes.items():
            box.value = name in ticked
