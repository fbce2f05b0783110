"""Long computations in a thread: progress bar, Cancel button, and errors as notifications."""

from __future__ import annotations

from math import inf
from operator import length_hint
from threading import Event
from time import perf_counter
from typing import TYPE_CHECKING, Any, TypeVar

from napari.qt.threading import create_worker
from qtpy.QtWidgets import QGridLayout, QProgressBar, QPushButton, QWidget

from napari_elsplus._problems import problems
from napari_elsplus.errors import ElsPlusError, InputError, error_message
from napari_elsplus.processing.compilation import compilation_remark, reported_compilation
from napari_elsplus.widgets.shared.panel import panel_of, text_label, timer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    Item = TypeVar("Item")

POLL_MS = 100
"""Interval at which the bar is updated, milliseconds; chosen, faster than a bar can be read."""


class Cancelled(Exception):
    """The user has pressed Cancel."""


class Work(QWidget):
    """A progress bar with a Cancel button that runs one computation at a time; hidden while idle.

    Parameters
    ----------
    ended : callable
        Called after each computation, also a failed or cancelled one.
    cancel : callable
        Called on Cancel, to end a computation in another process.
    """

    def __init__(self, ended: Callable[[], None], cancel: Callable[[], None] = lambda: None) -> None:
        super().__init__()
        self._cancel_elsewhere = cancel
        self._ended = ended
        self._cancelled = Event()
        self._done, self._total, self._counts, self._since = 0, 0, True, perf_counter()
        self._worker: Any = None
        self._saves = False
        self._name, self._kernel = "", [""]
        self._bar, self._step = QProgressBar(), text_label()
        self._cancel = QPushButton("Cancel")
        self._cancel.setToolTip("Stop after this step")
        self._cancel.clicked.connect(self.cancel)
        layout = QGridLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setColumnStretch(0, 1)
        layout.addWidget(self._step, 0, 0, 1, 2)
        layout.addWidget(self._bar, 1, 0)
        layout.addWidget(self._cancel, 1, 1)
        self._poll = timer(self, POLL_MS, self._show_progress)
        self.hide()

    @property
    def busy(self) -> bool:
        """True while a computation runs."""
        return self._worker is not None

    @property
    def saving(self) -> bool:
        """True while a result is being written, which is not cancelled and for which the window waits."""
        return self.busy and self._saves

    def begin(
        self, total: int, work: Callable[[], Any], finished: Callable[[Any], None], *, saves: bool = False
    ) -> None:
        """Run a computation in a thread.

        Parameters
        ----------
        total : int
            Number of steps that :meth:`progress` will count in all; 0: the length of what it iterates over, where that
            is known.
        work : callable
            Runs in the thread.
        finished : callable
            Called with the result in the window's thread; not called after a failure or Cancel.
        saves : bool
            It writes a result, in one step: there is no Cancel button.

        Raises
        ------
        InputError
            If a computation runs already.
        """
        if self.busy:
            raise InputError("a computation is running", "wait until it has ended, or press Cancel")
        self._cancelled.clear()
        self._done, self._total, self._counts, self._since = 0, total, total == 0, perf_counter()
        self._name, self._saves = "", saves
        self._cancel.setVisible(not saves)
        self._step.hide()
        self._bar.setRange(0, total)
        self._finished = finished

        once = [work]  # napari keeps references to workers: they must hold none to data, nor to a panel
        kernel = self._kernel = [""]

        def compiling(name: str) -> None:
            kernel[0] = name

        def guarded() -> tuple[Any, Exception | None]:
            try:
                with reported_compilation(compiling):
                    return once.pop()(), None
            except (ElsPlusError, OSError, Cancelled) as error:
                return None, error

        self._worker = create_worker(guarded, _connect={"returned": self._take}, _start_thread=False)
        self._worker.finished.connect(self._end)
        self.show()
        self._poll.start()
        self._worker.start()

    def progress(self, items: Iterable[Item], step: str = "") -> Iterator[Item]:
        """Iterate over items in the thread: count them for the bar, and raise `Cancelled` after Cancel.

        Parameters
        ----------
        items : iterable
            What the thread goes through.
        step : str
            Name of the step, displayed above the bar.
        """
        self._name = step
        if self._counts:
            self._done, self._total, self._since = 0, length_hint(items), perf_counter()
        for item in items:
            self.stop_if_cancelled()
            yield item
            self._done += 1

    def stop_if_cancelled(self) -> None:
        """End the computation, in its thread, if the user has cancelled.

        Raises
        ------
        Cancelled
            After Cancel.
        """
        if self._cancelled.is_set():
            raise Cancelled

    def show_step(self, text: str, done: int, total: int) -> None:
        """Show the progress of a computation in another process.

        Parameters
        ----------
        text : str
            Name of the step, displayed above the bar.
        done, total : int
            Steps done, and of how many.
        """
        self._done, self._total, self._name, self._since = done, total, text, inf

    def cancel(self) -> None:
        """Stop at the next step."""
        self._cancelled.set()
        self._cancel_elsewhere()

    def _show_progress(self) -> None:
        self._step.setText(compilation_remark(self._kernel[0]) or self._name)
        self._step.setVisible(bool(self._step.text()))
        self._bar.setRange(0, self._total)
        self._bar.setValue(self._done)
        left_s = (perf_counter() - self._since) * (self._total / self._done - 1) if self._done else 0.0
        self._bar.setFormat(f"%p %, {duration_text(left_s)} left" if left_s >= 1 else "%p %")

    def _take(self, outcome: tuple[Any, Exception | None]) -> None:
        result, error = outcome
        if isinstance(error, (ElsPlusError, OSError)):
            problems.report(error_message(error), panel_of(self))
        elif error is None and not self._cancelled.is_set():
            self._finished(result)

    def _end(self) -> None:
        self._poll.stop()
        self._worker = None
        del self._finished
        self.hide()
        self._ended()


def duration_text(seconds: float) -> str:
    """Return a number of `seconds` as text, in minutes from two minutes on.

    Examples
    --------
    >>> duration_text(119.0), duration_text(121.0)
    ('119 s', '2 min')
    """
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
