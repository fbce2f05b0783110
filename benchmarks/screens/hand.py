"""Mouse and keyboard of a test, with the time that a person takes for the same.

Times of the keystroke-level model (Card, Moran and Newell 1980, doi:10.1145/358886.358895), seconds.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from qtpy.QtCore import QMimeData, QPoint, QPointF, Qt, QTimer, QUrl
from qtpy.QtGui import QDragEnterEvent, QDropEvent
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication, QFileDialog, QWidget

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from qtpy.QtWidgets import QAbstractSpinBox

    from napari_elsplus.widgets.dock.panel import ElsPlusDock
    from napari_elsplus.widgets.shared.panel import Panel

POINT_S: Final = 1.1
PRESS_S: Final = 0.1
"""Press or release of a mouse button."""
KEY_S: Final = 0.28
"""A key, by an average typist."""
HOME_S: Final = 0.4
"""Hand from mouse to keyboard, or back."""
THINK_S: Final = 1.35
"""Mental preparation of an action."""
READ_S: Final = 3.0
"""To read a panel that comes to the front; chosen."""
SEARCH_S: Final = 5.0
"""To find a file in the desktop's window; chosen."""
TIMEOUT_S: Final = 240.0
_DIALOG_MS: Final = 100
MOUSE_AND_KEYS: Final[Any] = QTest
"""Its stubs declare static functions as methods."""
LEFT: Final = Qt.MouseButton.LeftButton
PLAIN: Final = Qt.KeyboardModifier.NoModifier


@dataclass
class Step:
    """A step of a walk.

    Attributes
    ----------
    action : str
        What the user does.
    person_s : float
        Time of a person, seconds.
    computer_s : float
        Time that the computer took, seconds.
    """

    action: str
    person_s: float
    computer_s: float


@dataclass
class Hand:
    """Acts on a dock as a person does.

    Attributes
    ----------
    dock : ElsPlusDock
        In a visible window.
    typed : int
        Numbers that were typed.
    steps : list of Step
        What was done.
    """

    dock: ElsPlusDock
    typed: int = 0
    steps: list[Step] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        """Time of person and computer."""
        return sum(step.person_s + step.computer_s for step in self.steps)

    def show(self, title: str) -> Panel:
        """Click on the tab with a `title`, and return its panel."""
        bar = self.dock.tabs.tabBar()
        assert bar is not None
        at = [bar.tabText(index) for index in range(bar.count())].index(title)
        click = lambda: MOUSE_AND_KEYS.mouseClick(bar, LEFT, pos=bar.tabRect(at).center())  # noqa: E731
        self._do(f"tab {title}", POINT_S + 2 * PRESS_S + READ_S, click)
        panel = self.dock.by_title[title].panel
        assert panel is not None
        return panel

    def click(self, button: QWidget, name: str, until: Callable[[], bool] = lambda: True) -> None:
        """Click on a button.

        Parameters
        ----------
        button : QWidget
            Enabled and visible.
        name : str
            For the list of steps.
        until : callable
            Returns True when the computer has done it.
        """
        assert button.isEnabled(), button.toolTip()
        click = lambda: MOUSE_AND_KEYS.mouseClick(button, LEFT)  # noqa: E731
        self._do(f"press {name}", THINK_S + POINT_S + 2 * PRESS_S, click, until)

    def click_and_confirm(self, button: QWidget, name: str, until: Callable[[], bool] = lambda: True) -> None:
        """Click on a button that opens a file dialog, and confirm the suggested name with the return key."""
        native = QApplication.testAttribute(Qt.ApplicationAttribute.AA_DontUseNativeDialogs)
        QApplication.setAttribute(Qt.ApplicationAttribute.AA_DontUseNativeDialogs, True)
        timer = QTimer()
        timer.timeout.connect(_confirm)
        timer.start(_DIALOG_MS)
        self.click(button, name, until)
        timer.stop()
        QApplication.setAttribute(Qt.ApplicationAttribute.AA_DontUseNativeDialogs, native)
        self.steps[-1].person_s += THINK_S + HOME_S + KEY_S + HOME_S

    def type(self, spin_box: QAbstractSpinBox, number: float, name: str) -> None:
        """Click into a field with a `name`, select its text, and type a number."""
        text = f"{number:g}"

        def act() -> None:
            line = spin_box.lineEdit()
            assert line is not None
            MOUSE_AND_KEYS.mouseClick(line, LEFT)
            MOUSE_AND_KEYS.keyClick(line, Qt.Key.Key_A, Qt.KeyboardModifier.ControlModifier)
            MOUSE_AND_KEYS.keyClicks(line, text)
            MOUSE_AND_KEYS.keyClick(line, Qt.Key.Key_Return)

        self.typed += 1
        self._do(f"type {text}: {name}", THINK_S + POINT_S + 2 * PRESS_S + 2 * HOME_S + KEY_S * (len(text) + 3), act)

    def drop(self, panel: QWidget, path: Path, until: Callable[[], bool]) -> None:
        """Drop the file at a path on a panel; see :meth:`click`."""

        def act() -> None:
            data = QMimeData()
            data.setUrls([QUrl.fromLocalFile(str(path))])
            carried = Qt.DropAction.CopyAction, data, LEFT, PLAIN
            enter = QDragEnterEvent(QPoint(5, 5), *carried)
            QApplication.sendEvent(panel, enter)
            assert enter.isAccepted()
            QApplication.sendEvent(panel, QDropEvent(QPointF(5, 5), *carried))

        self._do(f"drop {path.name}", SEARCH_S + THINK_S + 2 * POINT_S + 2 * PRESS_S, act, until)

    def draw_line(self, canvas: QWidget, start: QPoint, end: QPoint, until: Callable[[], bool]) -> None:
        """Draw a line on a canvas with the button held; see :meth:`click`."""

        def act() -> None:
            MOUSE_AND_KEYS.mousePress(canvas, LEFT, PLAIN, start)
            for share in (0.25, 0.5, 0.75, 1.0):
                _go_on(0.05)
                MOUSE_AND_KEYS.mouseMove(canvas, start + (end - start) * share)
            _go_on(0.05)
            MOUSE_AND_KEYS.mouseRelease(canvas, LEFT, PLAIN, end)

        self._do("draw a line", THINK_S + 2 * POINT_S + 2 * PRESS_S, act, until)

    def _do(
        self, action: str, person_s: float, act: Callable[[], object], until: Callable[[], bool] = lambda: True
    ) -> None:
        begin_s = time.perf_counter()
        act()
        wait_until(action, until)
        self.steps.append(Step(action, person_s, time.perf_counter() - begin_s))


def wait_until(what: str, condition: Callable[[], bool]) -> None:
    """Process the window's events until a condition holds.

    Parameters
    ----------
    what : str
        What is waited for, for the message.
    condition : callable
        Tested between events.

    Raises
    ------
    TimeoutError
        If it does not hold within `TIMEOUT_S`.
    """
    end_s = time.perf_counter() + TIMEOUT_S
    while not condition():
        if time.perf_counter() > end_s:
            raise TimeoutError(f"{what}: the window did not reach the expected state")
        _go_on(0.02)


def _confirm() -> None:
    """Press return in an open file dialog."""
    dialog = QApplication.activeModalWidget()
    if isinstance(dialog, QFileDialog):
        MOUSE_AND_KEYS.keyClick(dialog, Qt.Key.Key_Return)


def _go_on(seconds: float) -> None:
    end_s = time.perf_counter() + seconds
    while time.perf_counter() < end_s:
        QApplication.processEvents()
        time.sleep(0.005)
