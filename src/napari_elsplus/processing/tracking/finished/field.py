"""Field of view and static pattern of a stack of finished images, estimated from a sample of its frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from math import ceil, floor
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.processing.analysis.uncertainty import robust_sigma
from napari_elsplus.processing.tracking.front_end.grid import FIELD, Grid, lit_pixels
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter
from napari_elsplus.processing.tracking.registration.masked_correlation import high_passed
from napari_elsplus.processing.tracking.standing_pattern import MIN_SAMPLES, evenly_spread

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.images.sectioning import Frames

COARSE_DIAMETER: Final = 192
"""Diameter of the field in cells of the search over all shifts; chosen: texture finer than this is not searched for."""
MIN_DIAMETER_PX: Final = 16
"""Smallest field that is tracked, pixels; chosen."""
_RIM_PX: Final = 4
"""Margin by which the field is smaller than what is lit, pixels; chosen, for the interpolation at its rim."""
_LIT: Final = 0.05
"""Fraction of the brightest level that a pixel reaches in some frame if it lies in the field; chosen."""
_MIN_LIT_DIAMETER: Final = 0.5
"""Smallest inscribed disc, as a fraction of the image, that is taken for the field; chosen, else the image is."""
_STATIC_CONTRAST: Final = 0.08
"""Contrast of the temporal median from which a cell belongs to the static pattern; chosen, a dead core has 0.2 to 1."""
_STATIC_RATIO: Final = 2.0
"""The same over the scatter of the cell in time, standard deviations."""
_MAX_STATIC: Final = 0.15
"""Fraction of the field up to which cells are taken for a static pattern: where more stands still, the probe rests."""
_MIN_UNEVEN: Final = 0.1
"""Standard deviation over the field of the logarithm of its light from which that is divided out; chosen: light that
falls to half at the rim has 0.15."""


@dataclass(frozen=True)
class FinishedField:
    """Field of view of finished images, and how they are compared.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the images.
    grid : Grid
        Grid of one pixel per pixel of the images; nine tenths of its diameter are the field.
    darkest, floor : float
        Grey levels: images are compared as ln(image - darkest + floor).
    quantum : float
        Grey level step of the images, 0 for floating point.
    mask : numpy.ndarray
        (rows, cols) float32 cells of the coarse images, 1 in the field without its static pattern, 0 elsewhere.
    light : numpy.ndarray
        (side, side) float32 light on the grid over its mean, by which images are divided before they are registered.
    """

    shape: tuple[int, int]
    grid: Grid
    darkest: float
    floor: float
    quantum: float
    mask: NDArray[np.float32]
    light: NDArray[np.float32]

    @classmethod
    def of(cls, samples: Sequence[NDArray[Any]]) -> FinishedField:
        """Estimate the field from frames of a stack.

        Parameters
        ----------
        samples : sequence of numpy.ndarray
            (rows, cols) images spread over the stack; eight or more for a static pattern.

        Raises
        ------
        InputError
            If the images are too small to be tracked.
        """
        rows, cols = samples[0].shape
        stack = [_finite(sample) for sample in samples]
        centre, diameter = _lit_disc(stack)
        if diameter < MIN_DIAMETER_PX:
            raise InputError(f"the images have {rows} x {cols} pixels", "choose a stack of larger ones")
        side = 4 * ceil((diameter + 2) / 4)
        origin = (floor(centre[0] - (side - 1) / 2 + 0.5), floor(centre[1] - (side - 1) / 2 + 0.5))
        own_centre = (centre[0] - origin[0], centre[1] - origin[1])
        grid = Grid(side, 1, origin, own_centre, (diameter - _RIM_PX) / FIELD, RollingShutter(np.inf))
        inside = lit_pixels(*grid.spans())
        middle = np.concatenate([_window(image, grid)[inside][::7] for image in stack])
        darkest = min(0.0, float(np.percentile(middle, 1)))
        level = max(float(np.median(middle)) - darkest, 0.5 * (float(np.percentile(middle, 99)) - darkest))
        quantum = 0.0 if np.asarray(samples[0]).dtype.kind == "f" else 1.0
        mask = np.floor(_coarse(inside.astype(np.float32)) + 1e-3)
        base = 0.1 * level + 1e-6
        median = np.median([_window(image, grid) for image in stack], axis=0)
        light = _vignette(np.log(np.maximum(median - darkest, 0) + base), inside, grid)
        field = cls((rows, cols), grid, darkest, base, quantum, mask, light)
        return replace(field, mask=mask * ~field._static_pattern(stack))

    @classmethod
    def of_stack(cls, frames: Frames) -> FinishedField:
        """Estimate the field from a sample of a stack's frames (rows, cols), as :meth:`of` does."""
        return cls.of(sample_frames(frames))

    @property
    def coarse_diameter(self) -> float:
        """Diameter of the field in cells."""
        return float(FIELD * self.grid.diameter / self.pixels_per_cell)

    @property
    def pixels_per_cell(self) -> float:
        """Pixels of the images per cell of the coarse ones."""
        return float(self.grid.side / self.mask.shape[0])

    def window(self, image: NDArray[Any]) -> NDArray[np.float32]:
        """Return an image (rows, cols) on the grid (side, side), zero where it does not reach or is not finite.

        Raises
        ------
        InputError
            If it has another size.
        """
        if image.shape != self.shape:
            raise InputError(
                f"a frame has {image.shape} pixels, the first one {self.shape}", "all frames must have one size"
            )
        return _window(_finite(image), self.grid)

    def coarse_logarithm(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the logarithm of an image on the grid (side, side), area-averaged to cells."""
        logarithm: NDArray[np.float32] = np.log(
            np.maximum(_coarse(image) - self.darkest, 0) + self.floor, dtype=np.float32
        )
        return logarithm

    def _static_pattern(self, stack: Sequence[NDArray[np.float32]]) -> NDArray[np.bool_]:
        """Return the cells (rows, cols) that show the same in all of a stack of images: dead cores, labels."""
        mask = self.mask
        nothing = np.zeros(mask.shape, bool)
        if len(stack) < MIN_SAMPLES:
            return nothing
        scale = COARSE_DIAMETER / 16
        logarithms = (self.coarse_logarithm(_window(image, self.grid)) for image in stack)
        passed = np.array([high_passed(logarithm, mask, scale) for logarithm in logarithms])
        median = np.median(passed, axis=0)
        scatter = robust_sigma(passed - median, axis=0)
        found = (np.abs(median) > np.maximum(_STATIC_CONTRAST, _STATIC_RATIO * scatter)).astype(np.uint8)
        grown = cv2.dilate(found, np.ones((5, 5), np.uint8)).astype(bool)
        return grown if grown[mask > 0].mean() < _MAX_STATIC else nothing


def sample_frames(frames: Frames) -> list[NDArray[Any]]:
    """Return frames (rows, cols) that are evenly spread over a stack."""
    return [np.asarray(frames[index]) for index in evenly_spread(len(frames))]


def _lit_disc(stack: Sequence[NDArray[np.float32]]) -> tuple[tuple[float, float], float]:
    """Return the centre (row, col) and diameter, pixels, of the largest disc that is lit; the image's where unclear."""
    brightest = reduce(np.maximum, stack)
    rows, cols = brightest.shape
    whole = ((rows - 1) / 2, (cols - 1) / 2), float(min(rows, cols))
    lit = (brightest > _LIT * np.percentile(brightest, 99)).astype(np.uint8)
    width = max(3, min(rows, cols) // 16) | 1
    lit = cv2.morphologyEx(lit, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width)))
    depth = cv2.distanceTransform(np.pad(lit, 1), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    radius = float(depth.max())
    if 2 * radius < _MIN_LIT_DIAMETER * min(rows, cols):
        return whole
    deepest = np.argwhere(depth > radius - 0.75)
    nearest = deepest[np.argmin(((deepest - whole[0]) ** 2).sum(axis=1))]
    return (float(nearest[0]), float(nearest[1])), 2 * radius - 1


def _vignette(logarithm: NDArray[np.floating], inside: NDArray[np.bool_], grid: Grid) -> NDArray[np.float32]:
    """Return the light (n, n) over its mean if its logarithm falls with the squared distance from the middle, else 1.

    It stands still, and smooth tissue would be registered by it.

    Parameters
    ----------
    logarithm : numpy.ndarray
        (n, n) of the median of the images.
    inside : numpy.ndarray
        (n, n) bool: the field.
    grid : Grid
        The grid of the field.
    """
    y, x = (np.arange(grid.side) - centre for centre in grid.centre)
    square = np.add.outer(y**2, x**2)
    square -= square[inside].mean()
    light = square * (square * logarithm)[inside].sum() / np.square(square[inside]).sum()
    return np.where(light[inside].std() < _MIN_UNEVEN, 1, np.exp(light)).astype(np.float32)


def _finite(image: NDArray[Any]) -> NDArray[np.float32]:
    return np.nan_to_num(np.asarray(image, np.float32), nan=0.0, posinf=0.0, neginf=0.0)


def _window(image: NDArray[np.float32], grid: Grid) -> NDArray[np.float32]:
    top, left = grid.origin
    shift = np.array([[1.0, 0.0, -left], [0.0, 1.0, -top]])
    return np.asarray(cv2.warpAffine(image, shift, (grid.side, grid.side), flags=cv2.INTER_NEAREST), np.float32)


def _coarse(image: NDArray[np.float32]) -> NDArray[np.float32]:
    cells = min(len(image), COARSE_DIAMETER)
    coarse: NDArray[np.float32] = cv2.resize(image, (cells, cells), interpolation=cv2.INTER_AREA)
    return coarse
