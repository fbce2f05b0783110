"""The engine's process and the active calibration, shared by all panels of a window."""

from __future__ import annotations

import time
import weakref
from concurrent.futures import Future
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from qtpy.QtCore import QCoreApplication, QTimer

from napari_elsplus.acquisition.link.client import EngineClient
from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.parking import ParkStage, ParkState
from napari_elsplus.io.settings import recall

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from napari_elsplus.acquisition.engine.status import Settings
    from napari_elsplus.instrument.calibration import Calibration

EVENTS_MS: Final = 500
"""Period in which processed events are noted, milliseconds; chosen: that of the client's heartbeats."""
EVENTS_TIMEOUT_S: Final = 1.5
"""Time without processed events after which a window counts as frozen; chosen: three periods of its timer."""
_latest: Callable[[], Connection | None] = lambda: None  # noqa: E731 - stands for a dead weak reference


class Connection:
    """The engine's process: started when a rig is connected, ended when no panel uses it any more.

    A rig can be opened once, so all panels share one connection; :func:`join` returns it.
    """

    def __init__(self) -> None:
        self._client: EngineClient | None = None
        self._users = 0
        self._events_s = 0.0
        self._heart = QTimer()
        self._heart.timeout.connect(self.note_events)
        self._lock = Lock()
        self._applied: tuple[Calibration | None, Path | None] = (None, None)
        self._received: Calibration | None = None
        self._settings: Settings | None = None
        self.rig: str | None = None
        """Name of the connected rig."""
        self.connecting: str | None = None
        """Name of the rig that is being opened, by whichever panel; opening it once more would close it first."""
        self.parks = 0
        """Times that a user has commanded to park; what was commanded before one of them does not move the galvo."""

    @property
    def client(self) -> EngineClient | None:
        """Client of the engine; None unless a rig is connected and the process is alive."""
        client = self._client
        return client if client is not None and self.rig is not None and client.died is None else None

    @property
    def died(self) -> DeviceError | None:
        """Cause, if the engine's process ended unexpectedly."""
        return self._client.died if self._client is not None else None

    @property
    def calibration(self) -> Calibration | None:
        """The active calibration: that of the connected rig if it has one, else the one applied last."""
        client = self.client
        active = client.calibration if client is not None else None
        if active is not self._received:
            self._received = active  # a copy from the engine's process: the panels go on sharing one object
            if active is not None and not _same(active, self._applied[0]):
                self._applied = active, None
        return self._applied[0]

    @property
    def calibration_file(self) -> Path | None:
        """File of the active calibration, if it was saved."""
        applied, path = self._applied
        return path if applied is not None and applied is self.calibration else None

    def apply(self, calibration: Calibration | None, path: Path | None = None) -> Future[None]:
        """Make a calibration the active one of all panels, and of the engine where a rig is connected.

        Parameters
        ----------
        calibration : Calibration or None
            Becomes active if the engine accepts it; with None no calibration is active any more.
        path : Path, optional
            File in which it is saved.

        Returns
        -------
        Future
            Raises the engine's error where it refuses the calibration.
        """

        def keep(done: Future[None]) -> None:
            if done.exception() is None:
                self._applied = calibration, path

        client = self.client
        applied: Future[None] = Future() if client is None else client.use(calibration)
        applied.add_done_callback(keep)
        if client is None:
            applied.set_result(None)
        return applied

    @property
    def settings(self) -> Settings | None:
        """Settings that the connected rig accepted last, from whichever panel; None unless a rig is connected."""
        return None if self.client is None else self._settings

    def configure(self, settings: Settings) -> Future[None]:
        """Configure the connected rig; a running stream restarts.

        Parameters
        ----------
        settings : Settings
            Preset, slit width, frame rate and gain.

        Returns
        -------
        Future
            Raises the engine's error where the rig refuses the settings.

        Raises
        ------
        DeviceError
            If no rig is connected.
        """

        def keep(done: Future[None]) -> None:
            if done.exception() is None and client is self._client:
                self._settings = settings

        client = self.require()
        configured = client.configure(settings)
        configured.add_done_callback(keep)
        return configured

    def require(self) -> EngineClient:
        """Return the client of the engine.

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
        """Open a rig and configure it; takes seconds, so call it in a thread.

        Parameters
        ----------
        rig : str
            Name of the rig.
        settings : Settings
            Preset, slit width, frame rate and gain.

        Raises
        ------
        DeviceError
            If it cannot be opened, or the last panel was closed meanwhile.
        InputError
            If there is no such rig, or the camera refuses the settings; if ``heartbeat_timeout_s`` of ``[rig]`` in the
            settings file is too short.
        """
        self.connecting = rig
        try:
            with self._lock:
                return self._open(rig, settings)
        finally:
            self.connecting = None

    def disconnect(self) -> None:
        """End the engine's process: park the galvo, finish a recording; the active calibration is kept.

        Raises
        ------
        DeviceError
            If the galvo is not known to be parked.
        """
        with self._lock:
            client = self._client
            self._end()
        parking = ParkState() if client is None else client.status.park_state
        if parking.stage not in (ParkStage.PARKED, ParkStage.UNKNOWN):
            raise DeviceError(
                parking.message or "the engine did not end in order: switch the laser off",
                "connect again, which parks the galvo and confirms it",
            )

    def park(self) -> Future[None] | None:
        """Move the laser line off the bundle; return the future confirmation, None without a rig.

        What a panel is about to start, after connecting for instance, is not started: see `parks`.
        """
        self.parks += 1
        client = self.client
        return None if client is None else client.park()

    def leave(self) -> None:
        """Release the connection for one panel; the last one ends the engine and discards the calibration.

        The engine ends in a thread that outlives the window, so that closing does not block and no process remains.
        """
        self._users -= 1
        if self._users == 0:
            self._heart.stop()
            self._applied = None, None
            client, self._client, self.rig = self._client, None, None
            if client is not None or self._lock.locked():  # locked: a rig is being connected or disconnected
                Thread(target=self._end_beside, args=(client,), name="engine-end").start()

    def note_events(self) -> None:
        """Note that the window's events are processed; called twice a second, else the galvo is parked."""
        self._events_s = time.monotonic()

    def _open(self, rig: str, settings: Settings) -> EngineClient:
        if self._users == 0:  # closed before this thread came to it; later, `leave` finds the lock and ends it
            raise DeviceError("the last panel was closed", "open one, then connect again")
        self._end()
        client = EngineClient()
        try:
            client.open(rig).result()
            client.configure(settings).result()
            if (timeout_s := recall("rig").get("heartbeat_timeout_s")) is not None:
                client.set_heartbeat_timeout(float(timeout_s)).result()
            client.beat_while(self._processes_events)
        except BaseException:
            client.close()
            raise
        self._settings = settings
        self._client, self.rig = client, rig
        return client

    def _end(self) -> None:
        active, path = self.calibration, self.calibration_file
        client, self._client, self.rig = self._client, None, None
        self._applied = active, path
        if client is not None:
            client.close()

    def _end_beside(self, client: EngineClient | None) -> None:
        with self._lock:  # the next connection waits until the rig is free
            if client is not None:
                client.close()
            if self._users == 0 and self._client is not None:  # connected after the last panel was closed
                self._end()
                self._applied = None, None

    def _processes_events(self) -> bool:
        return self._users == 0 or time.monotonic() - self._events_s < EVENTS_TIMEOUT_S

    def _enter(self) -> Connection:
        self._users += 1
        self.note_events()
        if QCoreApplication.instance() is not None and not self._heart.isActive():
            self._heart.start(EVENTS_MS)
        return self


def _same(one: Calibration, other: Calibration | None) -> bool:
    """Return True if two calibrations have equal numbers and equal arrays."""
    return other is not None and _equal(vars(one), vars(other)) and _equal(one.model_extra, other.model_extra)


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_equal(value, other[key]) for key, value in one.items())
    return np.array_equal(one, other) if isinstance(one, np.ndarray) else bool(one == other)


def join() -> Connection:
    """Return the connection that the window's panels share; each panel calls :meth:`Connection.leave` once."""
    global _latest
    connection = _latest() or Connection()
    _latest = weakref.ref(connection)
    return connection._enter()  # noqa: SLF001 - its own
