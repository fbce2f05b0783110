"""The mirror in step with the camera, standing, or parked."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.hardware.waveform import MirrorLimits, els_waveform

if TYPE_CHECKING:
    from napari_elsplus.acquisition.camera_setup import CameraSetup
    from napari_elsplus.acquisition.rig import Rig
    from napari_elsplus.calibration import Calibration


class Mirror:
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
        self.limits: MirrorLimits = rig.limits
        self.scanning = False

    def follow(self, calibration: Calibration | None) -> None:
        """Scan as far as the calibration knows how; leave the mirror where it is without galvo and bundle.

        Raises
        ------
        InputError
            If the ramp does not fit the frame or the limits.
        DeviceError
            If the card fails.
        """
        self.scanning = False
        if calibration is None or calibration.galvo is None or calibration.bundle is None:
            return
        self._scanner.scan(els_waveform(calibration, self._setup.timing(self._strobe), self.limits))
        self.scanning = True

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
