"""Commands that have not ended, in the order in which they came, and which of them the newest waits for."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, NamedTuple

from napari_elsplus.acquisition.link.commands import COMMANDS, Scheduling

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.acquisition.link.messages import Request

MAX_SILENT_S: Final = 2.0
"""Seconds after which a command that has not ended is stated; chosen: above what commands of a rig that works take."""


class _Given(NamedTuple):
    name: str
    given_s: float

    @property
    def title(self) -> str:
        return self.name.replace("_", " ")

    @property
    def is_exclusive(self) -> bool:
        return COMMANDS[self.name].scheduling is Scheduling.EXCLUSIVE


class OutstandingCommands:
    """Commands of a client that have not ended; procedures, which have a progress of their own, are left out.

    Parameters
    ----------
    clock_s : callable
        Returns the time in seconds.

    Examples
    --------
    >>> from napari_elsplus.acquisition.link.messages import Request
    >>> now_s = iter([0.0, 9.0, 12.0])
    >>> outstanding = OutstandingCommands(lambda: next(now_s))
    >>> outstanding.add(Request(1, "configure")); outstanding.add(Request(2, "stop"))
    >>> outstanding.waiting()
    'stop waits for configure, which has not ended for 12 s; Park acts at once, and disconnecting ends the engine'
    """

    def __init__(self, clock_s: Callable[[], float] = time.perf_counter) -> None:
        self._clock_s = clock_s
        self._given: dict[int, _Given] = {}

    def add(self, request: Request) -> None:
        """Note a `request` that has come."""
        if COMMANDS[request.name].scheduling is not Scheduling.PROCEDURE:
            self._given[request.number] = _Given(request.name, self._clock_s())

    def remove(self, request: Request) -> None:
        """Note that a `request` has ended."""
        self._given.pop(request.number, None)

    def waiting(self) -> str:
        """Return what the newest exclusive command waits for, and what can be done; empty while none has waited long.

        One that is executed may wait, too: for a command beside it that holds the engine.
        """
        given = list(self._given.values())
        now_s = self._clock_s()
        exclusive = [index for index, one in enumerate(given) if one.is_exclusive]
        if not exclusive or now_s - given[0].given_s < MAX_SILENT_S:
            return ""
        first, newest = given[0], given[exclusive[-1]]
        waits = f"{newest.title} waits for {first.title}, which" if newest is not first else newest.title
        lasts_s = now_s - first.given_s
        return f"{waits} has not ended for {lasts_s:.0f} s; Park acts at once, and disconnecting ends the engine"
