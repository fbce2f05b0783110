"""Camera settings, active calibration and view, and the live images that follow from them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.acquisition.engine.camera_setup import CameraSetup
from napari_elsplus.acquisition.engine.display import Display
from napari_elsplus.acquisition.engine.live_images import LiveView
from napari_elsplus.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.acquisition.engine.status import Settings
    from napari_elsplus.acquisition.engine.workers import DisplaySink
    from napari_elsplus.acquisition.streaming.ring import Layout, Ring
    from napari_elsplus.hardware.rig import Rig
    from napari_elsplus.instrument.calibration import Calibration


class Imaging:
    """Settings of the live images; the images are rebuilt after each change.

    Parameters
    ----------
    rig : Rig
        Open.
    make_ring : callable
        Makes the display's ring of a layout, and returns its name and the ring.
    publish : callable
        Receives the images that are made from now on, with their ring.

    Attributes
    ----------
    setup : CameraSetup
        Settings of the camera.
    display : Display
        The live images with their ring.
    calibration : Calibration or None
        The active one.
    misfit : CalibrationError or None
        Why it cannot be applied to the frames as configured now; raw frames are displayed then.
    """

    def __init__(
        self,
        rig: Rig,
        make_ring: Callable[[Layout], tuple[str, Ring]],
        publish: Callable[[DisplaySink], None],
    ) -> None:
        self.setup = CameraSetup(rig)
        self.display = Display(make_ring)
        self.calibration: Calibration | None = None
        self.misfit: CalibrationError | None = None
        self._view: LiveView | None = LiveView()
        self._publish = publish

    def configure(self, settings: Settings) -> None:
        """Configure the camera by settings; raw frames are displayed if the calibration does not fit them.

        Raises
        ------
        InputError, DeviceError
            As :meth:`CameraSetup.configure`.
        """
        self.setup.configure(settings)
        self._renew(raw_if_misfit=True)

    def activate(self, calibration: Calibration | None, *, restoring: bool = False) -> None:
        """Activate a calibration.

        Parameters
        ----------
        calibration : Calibration or None
            None: raw frames only.
        restoring : bool
            Activate it also if it does not fit the frames, with raw frames displayed.

        Raises
        ------
        CalibrationError
            If it does not fit the frames, or lacks what the view needs.
        """
        self.calibration = calibration
        self._renew(raw_if_misfit=restoring)

    def show(self, view: LiveView | None) -> None:
        """Make images for a view; None where nobody looks at them.

        Raises
        ------
        CalibrationError
            If the calibration lacks what the view needs; the view before stays.
        """
        before, self._view = self._view, view
        try:
            self._renew()
        except BaseException:
            self._view = before
            raise

    def require_fit(self) -> None:
        """Raise a CalibrationError if the active calibration does not fit the frames."""
        if self.misfit is not None:
            needed = self.setup.settings.preset
            raise CalibrationError(self.misfit.problem, f"calibrate for the preset {needed}, or choose another preset")

    def _renew(self, *, raw_if_misfit: bool = False) -> None:
        if not self.setup.configured:
            return
        try:
            sink = self.display.renew(self.setup.frame_shape, self.calibration, self._view)
            self.misfit = None
        except CalibrationError as error:
            if not raw_if_misfit:
                raise
            sink = self.display.renew(self.setup.frame_shape, None, self._view)
            self.misfit = error
        self._publish(sink)
