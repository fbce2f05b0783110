"""The paper's own mosaicing, kept as it is described: the baseline that other methods are measured against.

ELS+ images are smoothed by a 3 x 3 median (where the bundle is finely sampled), down-sampled to 250 x 250 pixels and
cropped to 90 % of the bundle's diameter; the shift between successive images is the peak of the normalised
cross-correlation between a template from one and the whole of the next, in whole pixels; each image is laid over the
mosaic as a dead leaf. Thrapp and Hughes, Methods, "Image Processing".
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.processing.images.sectioning import Mode, Sectioner, line_offset_px
from napari_elsplus.processing.tracking.front_end.grid import FIELD, Grid, lit_pixels
from napari_elsplus.processing.tracking.methods import TrackingMethod
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Velocity

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

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


class TemplateTracking(TrackingMethod):
    """Integer shifts from frame to frame, on a grid of 250 x 250 pixels.

    Parameters
    ----------
    calibration : Calibration
        Needs the bundle section.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    mode : Mode
        Image type to track.
    """

    def __init__(self, calibration: Calibration, frame_shape: tuple[int, int], mode: Mode) -> None:
        self._sectioner = sectioner = Sectioner(calibration, frame_shape)
        self._mode = mode
        self.scale = sectioner.side / SIDE_PX
        middle, diameter = (SIDE_PX - 1) / 2, sectioner.diameter_px / self.scale
        self.grid = Grid(SIDE_PX, 1, (0, 0), (middle, middle), diameter, RollingShutter(np.inf))
        seen = sectioner.seen | ~sectioner.inside
        if mode is not Mode.LS and not seen.all():
            there = cv2.resize(seen.astype(np.float32), (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA) >= 1
            # what the frame cuts off lies beyond one row or column, that of the bundle's middle
            rows, cols = (np.flatnonzero(line[SIDE_PX // 2]).tolist() for line in (there.T, there))
            rectangle = rows[0], rows[-1] + 1, cols[0], cols[-1] + 1
            self.grid = replace(self.grid, seen=rectangle, line_offset=line_offset_px(calibration) / self.scale)
        self._inside = lit_pixels(*self.grid.spans(FIELD)).astype(np.float32)
        self._median = takes_median(sectioner.diameter_px)
        self._template: NDArray[np.float32] | NDArray[np.uint8] | None = None
        self._row, self._col = 0, 0

    def prepare_image(self, raw: NDArray[Any], raw_residual: NDArray[Any], out: NDArray[np.float32]) -> None:
        """See :meth:`~.methods.TrackingMethod.prepare_image`; smoothed, down-sampled and cropped, NaN becomes zero."""
        image = np.nan_to_num(self._sectioner.section(raw, raw_residual, self._mode))
        smooth = cv2.medianBlur(image, 3) if self._median else image
        cv2.resize(smooth, (SIDE_PX, SIDE_PX), dst=out, interpolation=cv2.INTER_AREA)
        out *= self._inside

    def estimate_pose(self, image: NDArray[np.float32] | NDArray[np.uint8]) -> Pose:
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
