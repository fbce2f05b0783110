"""The one engine that all panels of a window share."""

from __future__ import annotations

import weakref
from threading import Lock
from typing import TYPE_CHECKING

from napari_elsplus.acquisition.client import EngineClient
from napari_elsplus.errors import DeviceError

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.acquisition.status import Settings

_latest: Callable[[], Connection | None] = lambda: None  # noqa: E731 - a dead weak reference says the same


class Connection:
    """An engine's process that is started when a rig is connected, and ends when nobody uses it any more.

    A rig can be opened once, so there is one connection; :func:`join` returns it.
    """

    def __init__(self) -> None:
        self._client: EngineClient | None = None
        self._users = 0
        self._lock = Lock()
        self.rig: str | None = None
        """Name of the rig that is connected."""

    @property
    def client(self) -> EngineClient | None:
        """The engine, if a rig is connected and its process lives."""
        client = self._client
        return client if client is not None and self.rig is not None and client.died is None else None

    @property
    def died(self) -> DeviceError | None:
        """What happened, if the engine's process ended without being told to."""
        return self._client.died if self._client is not None else None

    def require(self) -> EngineClient:
        """Return the engine.

        Raises
        ------
        DeviceError
            If no rig is connected.
        """
        client = self.client
        if client is None:
            raise DeviceError("no rig is connected", "connect to one first; `simulated` is always there")
        return client

    def connect(self, rig: str, settings: Settings) -> EngineClient:
        """Open a rig and set it up; takes seconds, so not in the window's thread.

        Raises
        ------
        DeviceError
            If it cannot be opened.
        InputError
            If there is no such rig, or the camera cannot do that.
        """
        with self._lock:
            self._end()
            client = EngineClient()
            try:
                client.open(rig).result()
                client.configure(settings).result()
            except BaseException:
                client.close()
                raise
            self._client, self.rig = client, rig
        return client

    def disconnect(self) -> None:
        """End the engine's process: the mirror is parked, a recording finished."""
        with self._lock:
            self._end()

    def leave(self) -> None:
        """Say that a panel does not use it any more; the last one's leaving disconnects."""
        self._users -= 1
        if self._users == 0:
            self.disconnect()

    def _end(self) -> None:
        client, self._client, self.rig = self._client, None, None
        if client is not None:
            client.close()

    def _enter(self) -> Connection:
        self._users += 1
        return self


def join() -> Connection:
    """Return the connection that the window's panels share; each panel leaves it when it goes."""
    global _latest
    connection = _latest() or Connection()
    _latest = weakref.ref(connection)
    return connection._enter()  # noqa: SLF001 - its own
