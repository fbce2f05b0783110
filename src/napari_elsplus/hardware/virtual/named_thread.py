"""A thread for the simulator's work, so that its processor time is not counted with that of the drivers."""

from __future__ import annotations

import queue
import threading
import weakref
from typing import TYPE_CHECKING, Any, TypeVar, cast

from napari_elsplus.hardware.priority import Rank, join_frame_core

if TYPE_CHECKING:
    from collections.abc import Callable

Result = TypeVar("Result")


class NamedThread:
    """A thread that runs one call at a time while the caller waits; starts with the first call, ends with its owner.

    Parameters
    ----------
    name : str
        Name of the thread, by which processor time is reported.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._calls: queue.SimpleQueue[Callable[[], Any] | None] = queue.SimpleQueue()
        self._results: queue.SimpleQueue[tuple[Any, Exception | None]] = queue.SimpleQueue()
        self._started = False

    def run(self, call: Callable[[], Result]) -> Result:
        """Run a `call` in the thread; return what it returned, or raise what it raised."""
        if not self._started:
            self._started = True
            weakref.finalize(self, self._calls.put, None)
            threading.Thread(target=_serve, args=(self._calls, self._results), name=self._name, daemon=True).start()
        self._calls.put(call)
        result, error = self._results.get()
        try:
            if error is not None:
                raise error
            return cast("Result", result)
        finally:
            del error  # its traceback holds this frame, and so the owner


def _serve(
    calls: queue.SimpleQueue[Callable[[], Any] | None], results: queue.SimpleQueue[tuple[Any, Exception | None]]
) -> None:
    join_frame_core(Rank.REST)  # what a simulator computes delays no frame that has come
    while (call := calls.get()) is not None:
        result: tuple[Any, Exception | None]
        try:
            result = call(), None
        except Exception as error:  # noqa: BLE001 - raised for the caller
            result = None, error
        del call  # it may hold the owner
        results.put(result)
        del result
