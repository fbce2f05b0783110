"""Engine requests that do not block the window: results and errors are delivered by a timer in the window's thread."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

from qtpy.QtCore import QObject
from qtpy.QtWidgets import QProgressBar

from napari_elsplus._problems import problems
from napari_elsplus.errors import CancelledError, ElsPlusError, error_message
from napari_elsplus.widgets.shared.panel import timer

if TYPE_CHECKING:
    from collections.abc import Callable

    from qtpy.QtWidgets import QWidget

    from napari_elsplus.acquisition.engine.status import Status

    T = TypeVar("T")

POLL_MS: Final = 30
"""Interval at which futures are tested, milliseconds; chosen well below the 200 ms within which a click must act."""


class Outstanding(NamedTuple):
    """A future and its callbacks."""

    future: Future[Any]
    then: Callable[[Any], None]
    failed: Callable[[], None]


class RequestBar(QProgressBar):
    """Progress of the engine's work: of a calibration by its counts, of connecting without; hidden while idle."""

    def __init__(self) -> None:
        super().__init__()
        self.hide()

    def show_state(self, status: Status | None, *, busy: bool) -> None:
        """Display the progress.

        Parameters
        ----------
        status : Status or None
            Status of the engine; None if no rig is connected.
        busy : bool
            A request is outstanding.
        """
        progress = None if status is None else status.progress
        if progress is not None:
            self.setRange(0, progress.total)
            self.setValue(progress.done)
            self.setFormat(f"{progress.step} %p %")
        elif busy:
            self.setRange(0, 0)
        self.setVisible(progress is not None or (busy and status is None))


class PendingRequests(QObject):
    """Delivers the results of futures in the window's thread.

    Parameters
    ----------
    parent : QWidget
        The panel that makes the requests.
    settled : callable
        Called after each result or error.
    """

    def __init__(self, parent: QWidget, settled: Callable[[], None]) -> None:
        super().__init__(parent)
        self._panel, self._settled = parent, settled
        self._open: list[Outstanding] = []
        self._pool = ThreadPoolExecutor(1, "elsplus-requests")
        self._poll = timer(self, POLL_MS, self._deliver)

    @property
    def busy(self) -> bool:
        """True while a result is outstanding."""
        return bool(self._open)

    def follow(
        self,
        future: Future[T],
        then: Callable[[T], None] = lambda _: None,
        failed: Callable[[], None] = lambda: None,
    ) -> Outstanding:
        """Deliver the result of a future; show an expected error once.

        Parameters
        ----------
        future : Future
            Returned by a method of the engine's client.
        then : callable
            Called with the result.
        failed : callable
            Called after an error that was shown.

        Returns
        -------
        Outstanding
            For :meth:`forget`.
        """
        request = Outstanding(future, then, failed)
        self._open.append(request)
        self._poll.start()
        return request

    def forget(self, request: Outstanding) -> None:
        """Deliver neither result nor error of an outstanding `request`."""
        self._open.remove(request)

    def waits_for(self, request: Outstanding | None) -> bool:
        """Return True while a `request` is outstanding."""
        return request in self._open

    def run(self, work: Callable[[], T], then: Callable[[T], None] = lambda _: None) -> None:
        """Run a slow function in a thread, one at a time, then deliver its result.

        Parameters
        ----------
        work : callable
            Runs in the thread; it must not touch widgets or layers.
        then : callable
            Called with the result in the window's thread.
        """
        self.follow(self._pool.submit(work), then)

    def stop(self) -> None:
        """Deliver nothing any more."""
        self._poll.stop()
        self._open.clear()
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _deliver(self) -> None:
        for request in [request for request in self._open if request.future.done()]:
            self._open.remove(request)
            error = request.future.exception()
            if isinstance(error, CancelledError):  # by the user, who needs no remedy
                problems.resolve(self._panel)
                request.failed()
            elif isinstance(error, (ElsPlusError, OSError)):
                problems.report(error_message(error), self._panel)
                request.failed()
            elif error is not None:
                raise error
            else:
                problems.resolve(self._panel)
                request.then(request.future.result())
            self._settled()
        if not self._open:
            self._poll.stop()
