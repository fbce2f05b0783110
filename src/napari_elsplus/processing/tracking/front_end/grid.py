"""The grid on which frames are tracked and laid into the mosaic: near one pixel per core.

Where each core covers many pixels, images show steps at the rims of the cores, which stay where they are: registration
takes them for structure that moved less than the probe. Such bundles are binned until a core is two pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import acos, ceil, floor, pi, sqrt
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import compilable
from napari_elsplus.processing.images.cores import core_spacing_px
from napari_elsplus.processing.images.sectioning import LINE_FIELD, disc
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

GRID_DIAMETER_PX: Final = 240.0
"""The bundle is binned to about this diameter, near one pixel per core: the paper down-samples to 250."""
MAX_SPACING_PX: Final = 4.0
"""Spacing of cores, pixels of the grid, up to which the grid follows the diameter alone; chosen: of bundles with 3.3 px
from core to core mosaics keep their detail, and tracks are as exact."""
SPACING_PX: Final = 2.0
"""Spacing of cores on the grid of bundles with larger ones; chosen: with 2.5 half as many pairs are registered of a
bundle of 38 cores from side to side, with 1.5 errors grow."""
_CORE_FIELD: Final = 0.95
"""Part of the diameter in which cores are counted; chosen: without the rim."""
FIELD: Final = 0.9
"""Part of the bundle's diameter that is used: the paper crops to 90 %."""
INNER_FIELD: Final = 0.8
"""Part of it in which out-of-focus light cancels. Nearer to the rim the residual's line, which stands aside, is cut off
by it before the confocal one is; what is left there does not move with the scene."""


@dataclass(frozen=True, slots=True)
class Grid:
    """The grid of the tracked images within the camera's frame.

    Parameters
    ----------
    side : int
        Rows and columns of an image.
    binning : int
        Camera pixels per grid pixel, in both directions.
    origin : tuple of int
        Camera row and column of the first pixel's corner pixel.
    centre : tuple of float
        Row and column of the confocal bundle's centre on the grid.
    diameter : float
        Diameter of the lit disc in grid pixels.
    shutter : RollingShutter
        Timing of the grid's rows; without `line_periods_per_frame` in the calibration an infinitely fast one.
    seen : tuple of int, optional
        First row, row after the last, first column and column after the last of the grid that lie within the frame in
        both views; all by default.
    line_offset : float
        Slit offset in rows of the grid, by which the laser line stands aside while a point's residual is read: points
        whose line then stands outside of the bundle are left out. 0 by default: none.
    """

    side: int
    binning: int
    origin: tuple[int, int]
    centre: tuple[float, float]
    diameter: float
    shutter: RollingShutter
    seen: tuple[int, int, int, int] | None = None
    line_offset: float = 0.0

    @classmethod
    def of(cls, calibration: Calibration, diameter_px: float = GRID_DIAMETER_PX) -> Grid:
        """Return the grid on which a calibrated bundle is tracked.

        Parameters
        ----------
        calibration : Calibration
            With the bundle section; without line periods per frame the shutter counts as global.
        diameter_px : float
            Diameter of the bundle on the grid that is aimed at; the binning is a whole number. The diameter becomes
            smaller where the flat field shows that cores are few, unless it is infinite: pixels of the camera.
        """
        bundle = calibration.measured_bundle
        binning = max(1, round(bundle.diameter_px / diameter_px))
        if np.isfinite(diameter_px) and (flat := calibration.flat) is not None:
            spacing_px = core_spacing_px(flat, disc(len(flat), _CORE_FIELD * bundle.diameter_px)) or 0.0
            if spacing_px > MAX_SPACING_PX * binning:
                binning = round(spacing_px / SPACING_PX)
        side = 4 * ceil((bundle.diameter_px / binning + 2) / 4)
        row, col = bundle.confocal_centre
        top, left = (floor(c - (side * binning - 1) / 2 + 0.5) for c in (row, col))
        rows = calibration.optics.line_periods_per_frame if calibration.optics is not None else None
        shutter = RollingShutter(np.inf if rows is None else rows)
        camera = cls(side * binning, 1, (top, left), (row - top, col - left), bundle.diameter_px, shutter)
        return camera.binned(binning)

    def binned(self, by: int) -> Grid:
        """Return the grid of pixels so many times larger, cut off where its side is no multiple of them.

        Only those of its pixels count as seen that lie within the frame as a whole.

        Parameters
        ----------
        by : int
            Pixels of this grid per pixel of that one, in both directions.
        """
        row, col = ((c - (by - 1) / 2) / by for c in self.centre)
        seen = self.seen
        if seen is not None:
            seen = -(-seen[0] // by), seen[1] // by, -(-seen[2] // by), seen[3] // by
        return replace(
            self, side=self.side // by, binning=self.binning * by, centre=(row, col), diameter=self.diameter / by,
            shutter=RollingShutter(self.shutter.line_periods_per_frame / by), seen=seen,
            line_offset=self.line_offset / by,
        )  # fmt: skip

    def upside_down(self) -> Grid:
        """Return the grid of images whose last row comes first."""
        side, (row, col), seen = self.side, self.centre, self.seen
        if seen is not None:
            seen = side - seen[1], side - seen[0], *seen[2:]
        return replace(self, centre=(side - 1 - row, col), seen=seen, line_offset=-self.line_offset)

    def spans(self, field: float = FIELD) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """First column of each row inside the central part of the disc, and the one after the last.

        Parameters
        ----------
        field : float
            Part of the diameter.
        """
        side, (row, col), radius = self.side, self.centre, 0.5 * self.diameter
        y, (top, bottom, left, right) = np.arange(side) - row, self.seen or (0, side, 0, side)
        square = (field * radius) ** 2 - y**2
        if self.line_offset:
            square = np.minimum(square, (LINE_FIELD * radius) ** 2 - (y + self.line_offset) ** 2)
        square[:top] = square[bottom:] = 0
        half = np.sqrt(np.maximum(square, 0))
        first = np.clip(np.ceil(col - half), max(left, 1), side - 1)
        last = np.where(square > 0, np.minimum(np.floor(col + half) + 1, min(right, side - 1)), 0)
        return first.astype(np.int32), np.maximum(first, last).astype(np.int32)


def lit_pixels(first: NDArray[np.int32], last: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return the lit pixels of an (n, n) image: columns from `first` to before `last`, (n,), of each row."""
    columns = np.arange(len(first))
    return (columns >= first[:, None]) & (columns < last[:, None])


@compilable
def overlap_of_discs(diameters: float) -> float:
    """Share of a disc that another of its size covers, whose centre lies so many diameters away.

    Examples
    --------
    >>> [round(overlap_of_discs(diameters), 3) for diameters in (0.0, 0.5, 1.0)]
    [1.0, 0.391, 0.0]
    """
    apart = min(abs(diameters), 1.0)
    return 2 / pi * (acos(apart) - apart * sqrt(1 - apart**2))
