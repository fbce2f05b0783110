"""Synchronization of the panel's calibration with the active calibration of all panels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.instrument.calibration import Calibration

if TYPE_CHECKING:
    from concurrent.futures import Future
    from pathlib import Path

    from napari_elsplus.widgets.shared.connection import Connection


class Sharing:
    """Activates accepted calibrations, and returns those that another panel has activated.

    Parameters
    ----------
    connection : Connection
        Shared by the panels.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._activation: Future[None] | None = None
        self._seen: Calibration | None = None
        self._own: Calibration | None = None
        self._file: Path | None = None

    @property
    def file(self) -> Path | None:
        """File in which the panel's calibration was saved last, else that of the active one."""
        return self._file or self._connection.calibration_file

    def activate(self, calibration: Calibration, path: Path | None = None) -> Future[None] | None:
        """Activate a calibration for all panels and the engine, once it contains the bundle; None if nothing changes.

        Where it contains none any more, as after Undo, the one that this panel activated before is withdrawn.

        Parameters
        ----------
        calibration : Calibration
            Complete or not.
        path : Path, optional
            Its file.
        """
        self._file = path or self._file
        if calibration.bundle is not None:
            self._own = calibration
            self._activation = self._connection.apply(calibration, path)
        elif self._own is not None and self._connection.calibration is self._own:
            self._own = self._seen = None
            self._activation = self._connection.apply(None)
        else:
            return None
        return self._activation

    def activated_elsewhere(self, own: Calibration) -> Calibration | None:
        """Return the active calibration if another panel has changed it since the last call, an empty one if forgotten.

        Parameters
        ----------
        own : Calibration
            Of this panel.
        """
        shared = self._connection.calibration
        if shared is self._seen or not (self._activation is None or self._activation.done()):
            return None
        forgotten = shared is None and self._seen is not None
        self._seen = shared
        if forgotten:
            self._file = None
            return Calibration()
        return None if shared is own else shared
