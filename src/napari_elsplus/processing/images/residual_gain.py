"""Gain of the residual view over the field, on the grid of the images."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from napari_elsplus.errors import CalibrationError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration


def inverse_gain_map(calibration: Calibration, centre: tuple[float, float], side: int) -> NDArray[np.float32] | None:
    """Return the inverse of the gain map, on the grid of the images; None without one.

    Parameters
    ----------
    calibration : Calibration
        With the bundle section.
    centre : tuple of float
        Row and column of the bundle's centre on the grid of the images.
    side : int
        Rows and columns of that grid.

    Returns
    -------
    numpy.ndarray or None
        (side, side) float32.

    Raises
    ------
    CalibrationError
        If an array that the calibration needs is absent, or the gain map has another size.
    """
    missing = calibration.missing_array()
    if missing is not None:
        raise CalibrationError(
            f"the calibration's {missing.replace('_', ' ')} is absent", "read it with the .npz beside its file"
        )
    relative = calibration.gain_map
    if relative is None:
        return None
    if relative.shape != (side, side) or not relative.min() > 0:
        raise CalibrationError(
            f"the gain map has {relative.shape} pixels and a least value of {relative.min():.3g}, "
            f"the images {side} x {side}",
            "calibrate the bundle again",
        )
    down, across = (at - (side - 1) / 2 for at in centre)
    shift = np.array([[1, 0, across], [0, 1, down]])
    moved = cv2.warpAffine(relative, shift, relative.shape, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(1 / moved, np.float32)
