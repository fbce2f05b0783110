"""Both images of the bundle, as they were located and aligned in one frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.processing.calibration.bundle.core_matching import COMPARED_DISC
from napari_elsplus.processing.calibration.line.view_offset import ViewOffset
from napari_elsplus.processing.images.cores import core_spacing_px
from napari_elsplus.processing.images.sectioning import disc

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.bundle.location import Circle, Disc
    from napari_elsplus.processing.calibration.bundle.view_alignment import Alignment
    from napari_elsplus.processing.calibration.line.location import Line

    Image = NDArray[np.float32]

MAX_SATURATED: Final = 0.01
"""Largest saturated share of a frame; chosen, well above the share of hot pixels and below that of a core's image."""
MAX_STRUCTURE: Final = 0.12
"""Largest structure of the light of a flat field, see :func:`structure_of_light`; measured: 0.01 to 0.054 in fifteen
evenly lit bundles, simulated and photographed, 0.07 to 0.084 where only 30 or 38 irregular cores lie side by side;
0.105 behind a USAF target, 0.31 behind lens tissue, 0.52 with squares of a tenth of the light. With squares that give
0.09, 0.12 and 0.17 all, 21 and 19 of 30 frames are tracked by such a flat field, without any 29."""
SMOOTHED_DIAMETERS: Final = 1 / 50
SMOOTHED_SPACINGS: Final = 1.5
"""Standard deviation of the Gaussian that averages the cores, in diameters and in their spacings, whichever is more;
chosen: thirty of them count or more, however few lie side by side."""
SHAPE_DEGREE: Final = 4
"""Of the polynomial that is taken for the shape of the lamp's light; chosen, as that of a vignette."""


def structure_of_light(image: Image, inside: NDArray[np.bool_]) -> float:
    """Return how much the light varies over the bundle on the scale of some cores, as a specimen's does.

    Parameters
    ----------
    image : numpy.ndarray
        (n, n) light above darkness, float32.
    inside : numpy.ndarray
        (n, n), the bundle's disc that fills the image, as far as it is seen.

    Returns
    -------
    float
        Standard deviation of the light, averaged over some cores, about a smooth surface; over its mean.

    Examples
    --------
    >>> evenly_lit = np.ones((100, 100), np.float32)
    >>> inside = disc(100, 98)
    >>> round(structure_of_light(evenly_lit, inside), 3)
    0.0
    >>> striped = evenly_lit * (np.arange(100) // 10 % 2)
    >>> round(structure_of_light(striped.astype(np.float32), inside), 1)
    0.7
    """
    sigma_px = max(SMOOTHED_DIAMETERS * len(image), SMOOTHED_SPACINGS * (core_spacing_px(image, inside) or 0.0))
    lit = inside.astype(np.float32)
    light = cv2.GaussianBlur(np.where(inside, image, np.float32(0)), (0, 0), sigma_px)
    light /= np.maximum(cv2.GaussianBlur(lit, (0, 0), sigma_px), np.float32(1e-3))
    step = max(1, int(sigma_px))
    row, col = np.nonzero((inside & disc(len(image), COMPARED_DISC * len(image)))[::step, ::step])
    seen = light[row * step, col * step].astype(np.float64)
    y, x = (2 * step * at / len(image) - 1 for at in (row, col))
    powers = [(up, across) for up in range(SHAPE_DEGREE + 1) for across in range(SHAPE_DEGREE + 1 - up)]
    terms = np.stack([y**up * x**across for up, across in powers], axis=1)
    smooth = terms @ np.linalg.lstsq(terms, seen)[0]
    return float((seen - smooth).std() / max(seen.mean(), 1e-9))


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
    structure : float
        Of the light in the confocal view, see :func:`structure_of_light`.
    """

    confocal: Disc
    residual: Disc
    alignment: Alignment
    image: Image
    saturated: float = 0.0
    structure: float = 0.0

    @property
    def shows_flat_field(self) -> bool:
        """True if the frame may serve as a flat field."""
        return self.saturated <= MAX_SATURATED and self.structure <= MAX_STRUCTURE

    @property
    def discs(self) -> list[Circle]:
        """Centre and diameter in pixels of both views."""
        return [self.confocal.circle, self.residual.circle]

    @property
    def split(self) -> int:
        """Column of the frame between the views."""
        return round((self.confocal.centre[1] + self.residual.centre[1]) / 2)

    def view_offset(self, line: Line) -> ViewOffset:
        """Return the offset from a line in the confocal view to that in the residual one.

        Parameters
        ----------
        line : Line
            In the confocal view. Where the views differ in scale, its row matters.
        """
        affine, at = self.alignment.residual_to_confocal, np.array((line.row, line.column))
        down, across = np.linalg.solve(affine[:, :2], at - affine[:, 2]) - at
        to_residual = np.linalg.inv(affine[:, :2])
        fall, along = to_residual @ (line.slope, 1.0)
        stretch = np.linalg.det(to_residual) / along  # of rows across the line, which is turned with its view
        return ViewOffset(float(down), float(across), float(fall / along - line.slope), float(stretch))

    @property
    def offset_rows(self) -> float:
        """Row of the residual bundle image minus that of the confocal: the slit offset, independent of the line."""
        return self.residual.centre[0] - self.confocal.centre[0]

    @property
    def offset_uncertainty_rows(self) -> float:
        """One standard deviation of :attr:`offset_rows`."""
        return float(np.hypot(self.residual.centre_uncertainty_px, self.confocal.centre_uncertainty_px))
