"""Stand-in of napari's window in the rehearsal: holds the engine's client and executes what the rehearsal sends.

Run as ``python -m napari_elsplus.diagnosis.rehearsal.window``.
"""

from __future__ import annotations

import sys
import threading
import time
from contextlib import closing
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.acquisition.link.client import EngineClient
from napari_elsplus.diagnosis.rehearsal.messages import answer_requests, report_to_rehearsal

if TYPE_CHECKING:
    from concurrent.futures import Future

ENGINE: Final = (sys.executable, "-m", "napari_elsplus.diagnosis.rehearsal.engine")
"""Starts the engine's process, with fault switches on the simulated devices."""
COPY_EVERY_S: Final = 0.004
"""Seconds between two copies; chosen: a frame period, four times as often as a live panel."""


class Window:
    """Executes requests on an engine's client.

    Parameters
    ----------
    client : EngineClient
        The client.
    """

    def __init__(self, client: EngineClient) -> None:
        self._client = client
        self._futures: list[Future[Any]] = []
        self._copied = 0

    def connect(self) -> None:
        """Start another engine, after the one before was closed."""
        self._client = EngineClient(ENGINE)

    def copy_images(self) -> int:
        """Copy every image of the engine until it is closed, as a live panel does; return how many were copied."""
        if not self._copied:
            threading.Thread(target=self._copy, args=(self._client,), name="live images", daemon=True).start()
        return self._copied

    def _copy(self, client: EngineClient) -> None:
        newest = -1
        while (ring := client.display()) is not None:
            out = {name: np.empty(shape, dtype) for name, shape, dtype in ring.layout.fields}
            while (stamp := ring.newest_after(newest, out)) is not None or client.display() is ring:
                if stamp is not None:
                    newest, self._copied = stamp.sequence, self._copied + 1
                time.sleep(COPY_EVERY_S)
        self._copied = 0

    def call(self, name: str, *arguments: Any, **options: Any) -> int:
        """Send a command of that name; return the number by which `wait` finds its result."""
        self._futures.append(getattr(self._client, name)(*arguments, **options))
        return len(self._futures) - 1

    def wait(self, number: int, timeout_s: float) -> Any:
        """Return the result of the command of that number within `timeout_s`, or raise its error."""
        return self._futures[number].result(timeout_s)

    def status(self) -> Any:
        """Return the newest status, and why there is no engine any more."""
        return self._client.status, self._client.died

    def close(self) -> None:
        """End the engine."""
        self._client.close()


if __name__ == "__main__":
    with closing(Window(EngineClient(ENGINE))) as window:
        answer_requests(report_to_rehearsal("window"), window)
