"""Faults of a run of the engine: each kept once, with its remedy."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from threading import Lock

from napari_elsplus.errors import ElsPlusError


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault of the engine.

    Parameters
    ----------
    source : str
        Part of the engine that failed: ``camera``, ``clock`` (the camera's), ``scanner``, ``guardian``, ``processing``,
        ``tracking``, ``recorder``, ``engine``.
    problem, remedy : str
        As of :class:`napari_elsplus.errors.ElsPlusError`.
    time_s : float
        Seconds since the epoch.
    """

    source: str
    problem: str
    remedy: str
    time_s: float

    def __str__(self) -> str:
        return f"{self.problem}: {self.remedy}"


class FaultLog:
    """Faults of a run; the same fault is kept once, however often it is seen.

    Examples
    --------
    >>> from napari_elsplus.errors import DeviceError
    >>> log = FaultLog()
    >>> for _ in range(240):
    ...     log.add("camera", DeviceError("the camera is gone", "plug it in and connect again"))
    >>> [str(fault) for fault in log.all()]
    ['the camera is gone: plug it in and connect again']
    """

    def __init__(self) -> None:
        self._faults: dict[tuple[str, str], Fault] = {}
        self._lock = Lock()

    def add(self, source: str, error: BaseException) -> None:
        """Keep the error of a source, unless it is there already; a defect is written to standard error, too."""
        if isinstance(error, ElsPlusError):
            problem, remedy = error.problem, error.remedy
        else:
            problem, remedy = (
                f"{type(error).__name__}: {error}",
                "this is a defect: report it with what the terminal shows",
            )
        with self._lock:
            new = (source, problem) not in self._faults
            self._faults.setdefault((source, problem), Fault(source, problem, remedy, time.time()))
        if new and not isinstance(error, ElsPlusError):
            sys.excepthook(type(error), error, error.__traceback__)

    def remove(self, beginning: str) -> bool:
        """Remove the faults whose problem has a beginning, and is over; return True if there were any."""
        with self._lock:
            over = [key for key in self._faults if key[1].startswith(beginning)]
            for key in over:
                del self._faults[key]
        return bool(over)

    def all(self) -> tuple[Fault, ...]:
        """Return every fault, oldest first."""
        with self._lock:
            return tuple(self._faults.values())

    def clear(self) -> None:
        """Remove all faults: a new run begins."""
        with self._lock:
            self._faults.clear()
