"""Clarity of a frame from place to place: the variance of its grey levels, by which dead leaves are weighted.

A probe that loses contact on one side shows tissue there dimmer and out of focus. All frames show the same tissue where
they overlap, so that the variance around a point is a fair comparison of them, and a frame that shows a place with less
than half of it does not cover one that showed it clearly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.processing.tracking.front_end.grid import lit_pixels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid

    Image = NDArray[np.float32]

AROUND_DIAMETERS: Final = 1 / 16
"""Standard deviation of the Gaussian that weights the surroundings of a point, in diameters; chosen: tens of cores,
which contain some structure in most tissue, and a small part of the view."""
MIN_SHARE: Final = 1e-6
"""Of the unit, to which the variance is limited below; chosen: weights stay above 0, and nothing is less clear."""


_REDUCED_SIGMA_PX: Final = 4.0
"""The same at least on the reduced images on which it is computed; chosen: far from their pixels' size."""


class Clarity:
    """Measures the clarity of frames in units of that of the first one.

    Parameters
    ----------
    grid : Grid
        The frames' grid.
    """

    def __init__(self, grid: Grid) -> None:
        self._sigma_px = AROUND_DIAMETERS * grid.diameter
        self._lit = lit_pixels(*grid.spans())
        self._share = np.maximum(self._blurred(self._lit.astype(np.float32)), np.float32(1e-3))
        self._unit = 0.0

    def of(self, image: Image) -> Image:
        """Return the variance of the grey levels around each pixel over the mean of that in the first frame.

        Parameters
        ----------
        image : numpy.ndarray
            (side, side) float32.

        Returns
        -------
        numpy.ndarray
            (side, side) float32, above 0.
        """
        seen = np.where(self._lit, image, np.float32(0))
        variance = self._blurred(seen * seen) / self._share - np.square(self._blurred(seen) / self._share)
        self._unit = self._unit or max(float(variance[self._lit].mean()), 1e-6)
        relative: Image = np.maximum(variance / np.float32(self._unit), np.float32(MIN_SHARE))
        return relative

    def _blurred(self, image: Image) -> Image:
        step = max(1, int(self._sigma_px / _REDUCED_SIGMA_PX))
        size = (-(-image.shape[1] // step), -(-image.shape[0] // step))
        reduced = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        blurred = cv2.GaussianBlur(reduced, (0, 0), self._sigma_px / step)
        return np.asarray(cv2.resize(blurred, image.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
