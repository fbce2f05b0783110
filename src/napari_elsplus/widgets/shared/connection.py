"""The one engine and the one calibration that all panels of a window share."""

from __future__ import annotations

import weakref
from concurrent.futures import Future
from threading import Lock, Thread
from typing import TYPE_CHECKING

from napari_elsplus.acquisition.link.client import EngineClient
from napari_elsplus.errors import DeviceError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from napari_elsplus.acquisition.engine.status import Settings
    from napari_elsplus.instrument.calibration import Calibration

_latest: Callable[[], Connection | None] = lambda: None  # noqa: E731 - a dead weak reference says the same


class Connection:
    """An engine's process that is started when a rig is connected, and ends when nobody uses it any more.

    A rig can be opened once, so there is one connection; :func:`join` returns it.
    """

    def __init__(self) -> None:
        self._client: EngineClient | None = None
        self._users = 0
        self._lock = Lock()
        self._taken: tuple[Calibration | None, Path | None] = (None, None)
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

    @property
    def calibration(self) -> Calibration | None:
        """What all panels work by: in force where a rig has one, else what was taken last."""
        client = self.client
        in_force = client.calibration if client is not None else None
        return in_force if in_force is not None else self._taken[0]

    @property
    def calibration_file(self) -> Path | None:
        """The file of that calibration, if it lies in one."""
        taken, path = self._taken
        return path if taken is not None and taken is self.calibration else None

    def take(self, calibration: Calibration, path: Path | None = None) -> Future[None]:
        """Let all panels work by a calibration, and the engine where a rig is connected.

        Parameters
        ----------
        calibration : Calibration
            It is kept if the engine can use it.
        path : Path, optional
            The file that it lies in.

        Returns
        -------
        Future
            Raises what the engine says against it.
        """

        def keep(done: Future[None]) -> None:
            if done.exception() is None:
                self._taken = calibration, path

        client = self.client
        asked: Future[None] = Future() if client is None else client.use(calibration)
        asked.add_done_callback(keep)
        if client is None:
            asked.set_result(None)
        return asked

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
        """End the engine's process: the mirror is parked, a recording finished; what was calibrated stays known."""
        with self._lock:
            self._end()

    def leave(self) -> None:
        """Say that a panel does not use it any more; the last one ends the engine and forgets the calibration.

        Nobody waits for that but a thread, which outlives the window, so that no process is left behind.
        """
        self._users -= 1
        if self._users == 0:
            self._taken = None, None
            client, self._client, self.rig = self._client, None, None
            if client is not None:
                Thread(target=self._end_beside, args=(client,), name="engine-end").start()

    def _end(self) -> None:
        known, path = self.calibration, self.calibration_file
        client, self._client, self.rig = self._client, None, None
        self._taken = known, path
        if client is not None:
            client.close()

    def _end_beside(self, client: EngineClient) -> None:
        with self._lock:  # whoever connects next waits until the rig is free
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
