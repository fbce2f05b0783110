"""The paper's own mosaicing, kept as it is described: the baseline that other methods are measured against.

ELS+ images are smoothed by a 3 x 3 median (where the bundle is finely sampled), down-sampled to 250 x 250 pixels and
cropped to 90 % of the bundle's diameter; the shift between successive images is the peak of the normalised
cross-correlation between a template from one and the whole of the next, in whole pixels; each image is laid over the
mosaic as a dead leaf. Thrapp and Hughes, Methods, "Image Processing".
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.processing.tracking.front_end.grid import FIELD, Grid, lit_pixels, rectangle_within
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Velocity

if TYPE_CHECKING:
    from numpy.typing import NDArray

SIDE_PX: Final = 250
TEMPLATE_PX: Final = 128
CORES_ACROSS: Final = 195
"""Cores across the paper's bundle of about 30,000."""
FINE_SAMPLING_PX: Final = 3.0
"""Camera pixels per core from which on the paper applies the median."""


def takes_median(diameter_px: float) -> bool:
    """Return True if the paper smooths images of a bundle of this diameter: coarsely sampled ones are smooth enough.

    Examples
    --------
    >>> takes_median(464.0), takes_median(650.0)
    (False, True)
    """
    return diameter_px / CORES_ACROSS >= FINE_SAMPLING_PX


class TemplateTracker:
    """Integer shifts from frame to frame.

    Parameters
    ----------
    diameter_px : float
        Diameter of the bundle in the images that are given.
    side : int
        Rows and columns of these images; the bundle is in their middle.
    seen : numpy.ndarray, optional
        (side, side) bool: pixels that the frame contains in both views; all by default.
    line_offset : float
        Slit offset in rows of these images, where the frame cuts the views; see :class:`Grid`.

    Attributes
    ----------
    grid : Grid
        The grid of 250 x 250 pixels. One of its pixels is `scale` pixels of the images given.
    """

    def __init__(
        self, diameter_px: float, side: int, seen: NDArray[np.bool_] | None = None, line_offset: float = 0.0
    ) -> None:
        self.scale = side / SIDE_PX
        middle = (SIDE_PX - 1) / 2
        self.grid = Grid(SIDE_PX, 1, (0, 0), (middle, middle), diameter_px / self.scale, RollingShutter(np.inf))
        if seen is not None and not seen.all():
            there = cv2.resize(seen.astype(np.float32), (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA) >= 1
            rectangle = rectangle_within(there | ~lit_pixels(*self.grid.spans(1.0)))
            self.grid = replace(self.grid, seen=rectangle, line_offset=line_offset / self.scale)
        self._inside = lit_pixels(*self.grid.spans(FIELD)).astype(np.float32)
        self._median = takes_median(diameter_px)
        self._template: NDArray[np.float32] | NDArray[np.uint8] | None = None
        self._row, self._col = 0, 0

    def prepare(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the smoothed, down-sampled and cropped image, (250, 250) float32; NaN becomes zero."""
        image = np.nan_to_num(image)
        smooth = cv2.medianBlur(image, 3) if self._median else image
        small: NDArray[np.float32] = cv2.resize(smooth, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA)
        small *= self._inside
        return small

    def add(self, image: NDArray[np.float32] | NDArray[np.uint8]) -> Pose:
        """Track a prepared image; positions are whole pixels of the grid."""
        corner = (SIDE_PX - TEMPLATE_PX) // 2
        score = np.nan
        if self._template is not None:
            match = cv2.matchTemplate(image, self._template, cv2.TM_CCOEFF_NORMED)
            _, score, _, (col, row) = cv2.minMaxLoc(np.nan_to_num(match, copy=False, posinf=0.0, neginf=0.0))
            self._row -= row - corner
            self._col -= col - corner
        self._template = image[corner : corner + TEMPLATE_PX, corner : corner + TEMPLATE_PX].copy()
        still = Velocity(0.0, 0.0)
        return Pose(0, float(self._row), float(self._col), still, score, np.nan, TrackingState.TRACKED)
