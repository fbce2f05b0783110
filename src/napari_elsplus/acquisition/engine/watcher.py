"""The thread that watches a running stream: what fails without a command ends it, parked."""

from __future__ import annotations

from threading import Event, Thread
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

_PERIOD_S: Final = 0.05
"""Chosen: a tenth of the 0.5 s in which the galvo has to be parked after a fault."""


class Watcher(Thread):
    """Calls a check periodically; whatever fails, the watch goes on.

    Parameters
    ----------
    check : callable
        Raises what has failed.
    failed : callable
        Receives what was raised.
    """

    def __init__(self, check: Callable[[], None], failed: Callable[[Exception], None]) -> None:
        super().__init__(name="engine-watch", daemon=True)
        self._check, self._failed = check, failed
        self._stopping = Event()
        self.start()

    def stop(self) -> None:
        """End the watch."""
        self._stopping.set()
        self.join()

    def run(self) -> None:
        """Check until :meth:`stop`."""
        while not self._stopping.wait(_PERIOD_S):
            try:
                self._check()
            except Exception as error:  # noqa: BLE001 - handled by the owner
                self._failed(error)
