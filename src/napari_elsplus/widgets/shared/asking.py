"""Questions to the engine that the window does not wait for: answers and errors come by a timer, in its own thread."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

from napari.utils.notifications import show_error
from qtpy.QtCore import QObject, QTimer

from napari_elsplus.errors import ElsPlusError, error_message

if TYPE_CHECKING:
    from collections.abc import Callable

    T = TypeVar("T")

POLL_MS: Final = 30


class _Question(NamedTuple):
    """What is waited for, and what happens then."""

    future: Future[Any]
    then: Callable[[Any], None]
    otherwise: Callable[[], None]


class Asking(QObject):
    """Waits for futures beside the window.

    Parameters
    ----------
    parent : QObject
        The panel that asks.
    settled : callable
        Called whenever an answer or an error has come.
    """

    def __init__(self, parent: QObject, settled: Callable[[], None]) -> None:
        super().__init__(parent)
        self._settled = settled
        self._open: list[_Question] = []
        self._pool = ThreadPoolExecutor(1, "elsplus-asking")
        self._poll = QTimer(self)
        self._poll.setInterval(POLL_MS)
        self._poll.timeout.connect(self._look)

    @property
    def busy(self) -> bool:
        """Whether an answer is still to come."""
        return bool(self._open)

    def ask(
        self,
        future: Future[T],
        then: Callable[[T], None] = lambda _: None,
        otherwise: Callable[[], None] = lambda: None,
    ) -> None:
        """Wait for an answer; an error that the user can mend is shown once.

        Parameters
        ----------
        future : Future
            What is asked.
        then : callable
            Gets the answer.
        otherwise : callable
            Called after an error.
        """
        self._open.append(_Question(future, then, otherwise))
        self._poll.start()

    def do(self, work: Callable[[], T], then: Callable[[T], None] = lambda _: None) -> None:
        """Do something slow in a thread, and wait for its result."""
        self.ask(self._pool.submit(work), then)

    def stop(self) -> None:
        """Wait for nothing any more."""
        self._poll.stop()
        self._open.clear()
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _look(self) -> None:
        for question in [question for question in self._open if question.future.done()]:
            self._open.remove(question)
            error = question.future.exception()
            if isinstance(error, (ElsPlusError, OSError)):
                show_error(error_message(error))
                question.otherwise()
            elif error is not None:
                raise error
            else:
                question.then(question.future.result())
            self._settled()
        if not self._open:
            self._poll.stop()
