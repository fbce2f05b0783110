"""The live display: images of the newest frames in a ring from which napari copies."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from napari_elsplus.acquisition.engine.live_images import LiveImages, LiveView
from napari_elsplus.acquisition.streaming.ring import Ring
from napari_elsplus.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.acquisition.engine.camera_setup import CameraSetup
    from napari_elsplus.acquisition.streaming.ring import Layout
    from napari_elsplus.instrument.calibration import Calibration


def on_the_heap(layout: Layout) -> Ring:
    """Make a display ring of a layout in this process alone."""
    return Ring(bytearray(layout.nbytes), layout)


class DisplaySink(NamedTuple):
    """What makes the live images, and the ring that receives them."""

    images: LiveImages
    ring: Ring


class Display:
    """Images of the newest frames by the active calibration and view, in a ring that is replaced with their layout.

    Parameters
    ----------
    setup : CameraSetup
        Settings of the camera.
    make_ring : callable
        Makes a ring of a layout.

    Attributes
    ----------
    calibration : Calibration or None
        The active one.
    misfit : CalibrationError or None
        Why it cannot be applied to the frames as configured now; raw frames are displayed then.
    sink : DisplaySink or None
        Makes the images, with their ring; None until the camera was configured.
    """

    def __init__(self, setup: CameraSetup, make_ring: Callable[[Layout], Ring]) -> None:
        self._setup, self._make_ring = setup, make_ring
        self._view: LiveView | None = LiveView()
        self._retired: list[Ring] = []
        self.calibration: Calibration | None = None
        self.misfit: CalibrationError | None = None
        self.sink: DisplaySink | None = None

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
        self.renew(raw_if_misfit=restoring)

    def show(self, view: LiveView | None) -> None:
        """Make images for a view, none for None; raw frames alone as long as the calibration does not fit.

        Raises
        ------
        CalibrationError
            If the calibration lacks what the view needs; the view before stays.
        """
        before, self._view = self._view, view
        try:
            self.renew(raw_if_misfit=self.misfit is not None)
        except BaseException:
            self._view = before
            raise

    def require_fit(self) -> None:
        """Raise a CalibrationError if the active calibration does not fit the frames."""
        if self.misfit is not None:
            needed = self._setup.settings.preset
            raise CalibrationError(self.misfit.problem, f"calibrate for the preset {needed}, or choose another preset")

    def renew(self, *, raw_if_misfit: bool = False) -> None:
        """Make the images of the frames as configured from now on; none of a camera that is unconfigured.

        Parameters
        ----------
        raw_if_misfit : bool
            Display raw frames where the calibration does not fit them.

        Raises
        ------
        CalibrationError
            If the calibration does not fit the frames, or lacks what the view needs; nothing has changed then.
        OSError
            If there is no memory for the ring; nothing has changed then.
        """
        if not self._setup.configured:
            return
        shape, misfit = self._setup.frame_shape, None
        try:
            images = LiveImages(shape, self.calibration, self._view)
        except CalibrationError as error:
            if not raw_if_misfit:
                raise
            images, misfit = LiveImages(shape, None, self._view), error
        if self.sink is not None and self.sink.ring.layout == images.layout:
            ring = self.sink.ring
        else:
            ring = self._make_ring(images.layout)
            if self.sink is not None:
                self._retired.append(self.sink.ring)
        self.sink, self.misfit = DisplaySink(images, ring), misfit

    def close_retired(self) -> None:
        """Close replaced rings; only while no frames stream."""
        while self._retired:
            self._retired.pop().close()

    def close(self) -> None:
        """Close every ring."""
        self.close_retired()
        if self.sink is not None:
            self.sink.ring.close()
        self.sink = None
