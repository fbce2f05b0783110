"""The mirror in step with the camera, standing, or parked."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.hardware.scan.clearance import check_parking
from napari_elsplus.hardware.scan.waveform import GalvoLimits, els_waveform

if TYPE_CHECKING:
    from napari_elsplus.acquisition.engine.camera_setup import CameraSetup
    from napari_elsplus.hardware.rig import Rig
    from napari_elsplus.instrument.calibration import Calibration


class GalvoController:
    """The scanner of a rig, driven as a calibration says.

    Parameters
    ----------
    rig : Rig
        Open.
    setup : CameraSetup
        Knows when which row is exposed.

    Attributes
    ----------
    scanning : bool
        Whether it was last told to scan.
    """

    def __init__(self, rig: Rig, setup: CameraSetup) -> None:
        self._scanner, self._strobe, self._setup = rig.scanner, rig.strobe, setup
        self._rigs_park_v = rig.scanner.park_v
        self.limits: GalvoLimits = rig.limits
        self.scanning = False

    def follow(self, calibration: Calibration | None) -> None:
        """Scan as far as the calibration knows how; without galvo and bundle a mirror that scans is parked.

        Raises
        ------
        InputError
            If the ramp does not fit the frame or the limits.
        DeviceError
            If the card fails.
        """
        if calibration is None or calibration.galvo is None or calibration.bundle is None:
            if self.scanning:
                self.park()
            return
        waveform = els_waveform(calibration, self._setup.timing(self._strobe), self.limits)
        self.scanning = False
        self._scanner.scan(waveform)
        self.scanning = True

    def park_by(self, calibration: Calibration | None) -> None:
        """Park where a calibration says from now on; where it does not say, where the rig does.

        Raises
        ------
        InputError
            If that is outside the rig's limits, or on the bundle; the place before stays.
        DeviceError
            If the card fails.
        """
        galvo = calibration.galvo if calibration is not None else None
        volts = galvo.park_v if galvo is not None and galvo.park_v is not None else self._rigs_park_v
        check_parking(volts, calibration)
        self._scanner.park_at(volts)

    def hold(self, volts: float) -> None:
        """Let the line stand; the rig parks it when that goes on too long."""
        self._scanner.hold(volts)
        self.scanning = False

    def park(self) -> None:
        """Take the line off the bundle."""
        self.scanning = False
        self._scanner.park()

    def check(self) -> None:
        """Raise what has gone wrong since the mirror was told to move.

        Raises
        ------
        DeviceError
            If something has; the scanner has parked then.
        """
        self._scanner.check()
