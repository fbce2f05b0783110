"""Test of the size of frames against the camera region that was calibrated."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.errors import CalibrationError

if TYPE_CHECKING:
    from napari_elsplus.instrument.calibration import Calibration


def require_frame_shape(calibration: Calibration, frame_shape: tuple[int, ...]) -> None:
    """Refuse frames of another size than those that a calibration was measured on.

    Parameters
    ----------
    calibration : Calibration
        Its frame section and its background state the size; without either any frame fits.
    frame_shape : tuple of int
        Rows and columns of the frames.

    Raises
    ------
    CalibrationError
        If the sizes differ.
    """
    calibrated: dict[str, tuple[int, ...]] = {}
    if calibration.frame is not None:
        calibrated["frame"] = calibration.frame.shape
    if calibration.background is not None:
        calibrated["background"] = calibration.background.shape
    for name, shape in calibrated.items():
        if shape != tuple(frame_shape):
            raise CalibrationError(
                f"the calibration's {name} has {shape[0]} x {shape[1]} pixels, "
                f"the recording {frame_shape[0]} x {frame_shape[1]}",
                "use the calibration that was made with this camera region",
            )
