"""Both images of the bundle, as they were located and aligned in one frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.bundle.location import Disc
    from napari_elsplus.processing.calibration.bundle.view_alignment import Alignment

    Image = NDArray[np.float32]

MAX_SATURATED: Final = 0.01
"""Largest saturated share of a frame; chosen, well above the share of hot pixels and below that of a core's image."""


@dataclass(frozen=True, slots=True)
class BundlePair:
    """Both bundle images and their alignment.

    Parameters
    ----------
    confocal, residual : Disc
        The bundle's image in each view.
    alignment : Alignment
        Map from the residual to the confocal image, and the gain.
    image : numpy.ndarray
        Mean frame (rows, cols) in which they were located, float32.
    saturated : float
        Share of the frame that is saturated.
    """

    confocal: Disc
    residual: Disc
    alignment: Alignment
    image: Image
    saturated: float = 0.0

    @property
    def shows_flat_field(self) -> bool:
        """True if the frame may serve as a flat field."""
        return self.saturated <= MAX_SATURATED

    @property
    def discs(self) -> list[tuple[tuple[float, float], float]]:
        """Centre and diameter in pixels of both views."""
        return [(disc.centre, disc.diameter_px) for disc in (self.confocal, self.residual)]

    @property
    def split(self) -> int:
        """Column of the frame between the views."""
        return round((self.confocal.centre[1] + self.residual.centre[1]) / 2)

    @property
    def view_offset(self) -> tuple[float, float, float]:
        """Rows and columns from the confocal to the residual image's centre; slope there of a level line."""
        down, across = np.linalg.solve(self.alignment.residual_to_confocal[:, :2], (0.0, 1.0))
        return self.offset_rows, self.residual.centre[1] - self.confocal.centre[1], float(down / across)

    @property
    def offset_rows(self) -> float:
        """Row of the residual bundle image minus that of the confocal: the slit offset, independent of the line."""
        return self.residual.centre[0] - self.confocal.centre[0]

    @property
    def offset_uncertainty_rows(self) -> float:
        """One standard deviation of :attr:`offset_rows`."""
        return float(np.hypot(self.residual.centre_uncertainty_px, self.confocal.centre_uncertainty_px))
