"""The galvo of a rig: in step with the camera, held still, or parked."""

from __future__ import annotations

import logging
from functools import partial
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.parking import LASER_OFF, ParkStage
from napari_elsplus.hardware.scan.clearance import check_parking
from napari_elsplus.hardware.scan.waveform import GalvoLimits, els_waveform

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.acquisition.engine.camera_setup import CameraSetup
    from napari_elsplus.acquisition.engine.operations import Operations
    from napari_elsplus.acquisition.streaming.faults import FaultLog
    from napari_elsplus.hardware.parking import ParkState
    from napari_elsplus.hardware.rig import Rig
    from napari_elsplus.hardware.scan.timing import ScanTiming
    from napari_elsplus.hardware.scan.waveform import Waveform
    from napari_elsplus.instrument.calibration import Calibration

DEFAULT_HOLD_LIMIT_S: Final = 20.0
"""Hold limit of rig files that name none, seconds."""
_log = logging.getLogger(__name__)


class GalvoController:
    """The scanner of a rig, driven by a calibration.

    Parameters
    ----------
    rig : Rig
        Open.
    setup : CameraSetup
        Gives the times at which rows are exposed.
    operations : Operations
        An operation that was interrupted moves the galvo no more.
    faults : FaultLog
        Receives failures to park.

    Attributes
    ----------
    scanned_by : Calibration or None
        By which the line scans; None if the last command was not to scan.
    hold_limit_s : float
        Seconds after which the rig parks a line that is held still; 20 where its scanner has no such attribute.
    """

    def __init__(self, rig: Rig, setup: CameraSetup, operations: Operations, faults: FaultLog) -> None:
        self._scanner, self._strobe, self._setup = rig.scanner, rig.strobe, setup
        self._check_guarded = rig.check_guarded
        self._operations = operations
        self._rig_park_v = rig.scanner.park_v
        self.limits: GalvoLimits = rig.limits
        self.hold_limit_s: float = getattr(rig.scanner, "hold_limit_s", DEFAULT_HOLD_LIMIT_S)
        self.scanned_by: Calibration | None = None
        self._faults = faults
        self._end_subscription = rig.scanner.on_park_state(self._note)
        if rig.guardian is not None:
            rig.guardian.on_report(partial(faults.add, "guardian"))

    def waveform(self, calibration: Calibration | None) -> Waveform | None:
        """Return the scan by a calibration; None without its galvo and bundle sections.

        Raises
        ------
        InputError
            If the ramp does not fit the frame or the limits.
        """
        if calibration is None or calibration.galvo is None or calibration.bundle is None:
            return None
        return els_waveform(calibration, self.timing, self.limits)

    @property
    def timing(self) -> ScanTiming:
        """Exposure times of the rows, relative to the strobe."""
        return self._setup.timing(self._strobe)

    @property
    def scanning(self) -> bool:
        """True if the last command was to scan."""
        return self.scanned_by is not None

    def follow(self, waveform: Waveform | None, calibration: Calibration | None) -> None:
        """Scan by the waveform of a calibration; without one, park a galvo that scans.

        Parameters
        ----------
        waveform : Waveform or None
            Of :meth:`waveform`.
        calibration : Calibration or None
            From which it was made.

        Raises
        ------
        InputError
            If the operation was interrupted; the galvo is parked.
        DeviceError
            If the card fails.
        """
        if waveform is not None:
            self._move(lambda: self._scanner.scan(waveform), scanned_by=calibration)
        elif self.scanning:
            self.park()

    def park_by(self, calibration: Calibration | None) -> None:
        """Set the parking position of a calibration; where it has none, that of the rig.

        Raises
        ------
        InputError
            If it is outside the rig's limits, on the bundle or within its halo; the position before stays.
        DeviceError
            If the card fails.
        """
        galvo = calibration.galvo if calibration is not None else None
        volts = galvo.park_v if galvo is not None and galvo.park_v is not None else self._rig_park_v
        check_parking(volts, calibration, self.limits)
        self._scanner.park_at(volts)

    def hold(self, volts: float) -> None:
        """Hold the line still at some volts; the rig parks it after its time limit."""
        self._move(lambda: self._scanner.hold(volts))

    def park(self) -> None:
        """Move the line off the bundle; waits for no lock."""
        self.scanned_by = None
        self._scanner.park()

    def try_to_park(self) -> None:
        """Park; a failure is noted, and parking goes on."""
        try:
            self.park()
        except Exception as error:  # noqa: BLE001 - drivers of others raise what they will
            self._faults.add("scanner", error)

    def close(self) -> None:
        """Log what to do by hand if the closed scanner is not parked."""
        self._end_subscription()
        if self.park_state.stage is ParkStage.NOT_PARKED:
            _log.critical(self.park_state.message)

    @property
    def park_state(self) -> ParkState:
        """State of parking, read without any lock."""
        return self._scanner.park_state

    def watch_frames(self, received: Callable[[], int] | None) -> None:
        """Park when ramps come without frames, or frames without ramps, by a count of `received` frames, if any."""
        self._scanner.watch_frames(received)

    def check(self) -> None:
        """Raise the fault since the last command.

        Raises
        ------
        DeviceError
            If there is one; the scanner has parked then.
        """
        self._scanner.check()

    def _note(self, state: ParkState) -> None:
        if state.stage is ParkStage.NOT_PARKED:
            self._faults.add("scanner", DeviceError(state.message, "parking goes on until the card confirms it"))
        elif state.parked and self._faults.remove(LASER_OFF):
            late = DeviceError(
                "the galvo was parked late: the card had refused", "see what else uses it, and its cable"
            )
            self._faults.add("scanner", late)
        if state.parked and state.problem:
            self._faults.add("scanner", DeviceError(state.message, "switch the laser off by hand, and check that line"))

    def _move(self, move: Callable[[], None], scanned_by: Calibration | None = None) -> None:
        self._operations.check()
        self._check_guarded()
        before, self.scanned_by = self.scanned_by, None
        try:
            move()
        except InputError:  # nothing was put out: a scan goes on, unless it was parked meanwhile
            self.scanned_by = before if self.park_state.stage is ParkStage.DRIVEN else None
            raise
        except DeviceError:
            self._operations.check()  # interrupted: then that is the cause
            raise
        self.scanned_by = scanned_by
        try:
            self._operations.check()
        except InputError:  # interrupted while it moved: parking has the last word
            self.park()
            raise
