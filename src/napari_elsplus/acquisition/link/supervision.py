"""Supervision of the client by its heartbeats: a frozen window does not leave the laser on tissue."""

from __future__ import annotations

import logging
import time
from math import isfinite
from threading import Event, Thread
from typing import TYPE_CHECKING, Final

from napari_elsplus.acquisition.link.messages import HEARTBEAT_S, HEARTBEAT_TIMEOUT_S
from napari_elsplus.errors import DeviceError, InputError

if TYPE_CHECKING:
    from collections.abc import Callable

_log = logging.getLogger(__name__)

_TESTS: Final = 10
"""Tests in the interval of heartbeats; chosen: at most 0.05 s late."""


class Supervision(Thread):
    """Acts once when no heartbeat has come for a time; the next one arms it again.

    Parameters
    ----------
    act : callable
        Receives the fault; called in this thread.
    """

    def __init__(self, act: Callable[[DeviceError], None]) -> None:
        super().__init__(name="supervision", daemon=True)
        self._act = act
        self._timeout_s = HEARTBEAT_TIMEOUT_S
        self._beat_s = time.monotonic()
        self._armed = True
        self._stopping = Event()

    def set_timeout(self, timeout_s: float) -> None:
        """Set the timeout: seconds without a heartbeat.

        Raises
        ------
        InputError
            If it is shorter than two heartbeats, or endless.
        """
        if not (isfinite(timeout_s) and timeout_s >= 2 * HEARTBEAT_S):
            raise InputError(f"a heartbeat timeout of {timeout_s} s", f"choose {2 * HEARTBEAT_S:g} s or more")
        self._timeout_s = timeout_s

    def beat(self) -> None:
        """Note a heartbeat."""
        self._beat_s, self._armed = time.monotonic(), True

    def stop(self) -> None:
        """End."""
        self._stopping.set()
        self.join()

    def run(self) -> None:
        """Supervise until :meth:`stop`."""
        while not self._stopping.wait(HEARTBEAT_S / _TESTS):
            silent_s = time.monotonic() - self._beat_s
            if self._armed and silent_s > self._timeout_s:
                self._armed = False
                problem = (
                    f"the window was frozen for {self._timeout_s:g} s: the galvo was parked and any recording ended"
                )
                remedy = "start again; heartbeat_timeout_s of [rig] in the settings file allows more"
                try:
                    self._act(DeviceError(problem, remedy))
                except Exception:  # noqa: BLE001 - the next silence has to be acted upon, too
                    _log.exception("a frozen window could not be acted upon")
