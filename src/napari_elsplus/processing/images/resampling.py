"""Resampling through an affine map by a windowed sinc, which preserves the contrast of the core pattern.

A bundle is sampled by as few as 2.4 pixels per core, so that the core pattern lies at 0.48 cycles per pixel. Linear
interpolation by half a pixel leaves 6 % of it, and two views that are interpolated by different fractions then differ
by their core patterns. A Kaiser-windowed sinc of twelve taps is within 0.5 % up to 0.35 cycles per pixel.
"""

from __future__ import annotations

from math import ceil, floor
from typing import TYPE_CHECKING, Final, Self

import cv2
import numpy as np

from napari_elsplus.processing.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Part = tuple[slice, slice]


LOBES: Final = 6
"""Taps on each side of a point; derived: with six the kernel is within 0.5 % up to 0.35 cycles per pixel."""
_KAISER_BETA: Final = 5.0
"""Shape of the Kaiser window; chosen: near 5 the pass band is flat to 0.5 %."""
PHASES: Final = 256
"""Number of tabulated fractions of a pixel; derived: half a step is an error of 0.002 px."""
_MAX_DEVIATION_PX: Final = 0.06
"""Largest distance of a pixel from the centre of its block, at which weights are taken, pixels; derived: the
first-order correction then leaves an error of 1.6 % of the core pattern."""


def taps(fraction: NDArray[np.floating] | float) -> NDArray[np.float32]:
    """Return interpolation weights for a point that lies a fraction of a pixel beyond a pixel; their sum is 1.

    Parameters
    ----------
    fraction : float or numpy.ndarray
        In [0, 1].

    Returns
    -------
    numpy.ndarray
        (..., 12) float32, for pixels -5 to 6 relative to the one before the point.

    Examples
    --------
    >>> int(taps(0.0).argmax()), round(float(taps(0.3).sum()), 6)
    (5, 1.0)
    """
    distance = np.arange(1 - LOBES, LOBES + 1) - np.asarray(fraction, float)[..., None]
    window = np.i0(_KAISER_BETA * np.sqrt(np.maximum(0, 1 - (distance / LOBES) ** 2)))
    weights = np.sinc(distance) * window
    normalised: NDArray[np.float32] = (weights / weights.sum(axis=-1, keepdims=True)).astype(np.float32)
    return normalised


def tabulated_taps(beyond_px: float = 0.0) -> NDArray[np.float32]:
    """Return the interpolation weights at all tabulated fractions, or some way beyond each, (257, 12) float32.

    Parameters
    ----------
    beyond_px : float
        Distance from the fractions, pixels.
    """
    return taps(np.arange(PHASES + 1) / PHASES + beyond_px)


def crop_to_frame(centre: tuple[float, float], side: int) -> NDArray[np.float64]:
    """Return the map of a square crop about a place in a frame: what :func:`within_frame` takes.

    Parameters
    ----------
    centre : tuple of float
        (row, col) in the frame of the crop's middle.
    side : int
        Rows and columns of the crop.

    Returns
    -------
    numpy.ndarray
        (2, 3): maps (row, col, 1) in the crop to (row, col) in the frame.

    Examples
    --------
    >>> crop_to_frame((10.0, 20.0), 5).tolist()
    [[1.0, 0.0, 8.0], [0.0, 1.0, 18.0]]
    """
    return np.column_stack([np.eye(2), np.subtract(centre, (side - 1) / 2)])


def within_frame(grid_to_frame: NDArray[np.float64], side: int, frame_shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the pixels of a square grid that an affine map puts into a frame.

    Parameters
    ----------
    grid_to_frame : numpy.ndarray
        (2, 3): maps (row, col, 1) on the grid to (row, col) in the frame.
    side : int
        Rows and columns of the grid.
    frame_shape : tuple of int
        Rows and columns of the frame.

    Returns
    -------
    numpy.ndarray
        (side, side), bool.

    Examples
    --------
    >>> within_frame(np.array([[1.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), 2, (9, 9)).tolist()
    [[False, False], [True, True]]
    """
    at, within = np.arange(side), np.ones((side, side), bool)
    corners = grid_to_frame @ np.array([(0, 0, 1), (0, side - 1, 1), (side - 1, 0, 1), (side - 1, side - 1, 1)]).T
    if (corners >= 0).all() and (corners <= np.reshape(frame_shape, (2, 1)) - 1).all():
        return within
    for (by_row, by_col, start), size in zip(grid_to_frame, frame_shape, strict=True):
        points = (by_row * at + start)[:, None] + by_col * at
        within &= (points >= 0) & (points <= size - 1)
    return within


def overlap(first: tuple[int, int], window_shape: tuple[int, ...], image_shape: tuple[int, ...]) -> tuple[Part, Part]:
    """Return the slices of an image, and of a window of it, in which both lie; empty where they do not overlap.

    Parameters
    ----------
    first : tuple of int
        Row and column of the image at which the window begins; may be negative.
    window_shape, image_shape : tuple of int
        Rows and columns of each.

    Examples
    --------
    >>> overlap((-2, 3), (4, 4), (9, 5))
    ((slice(0, 2, None), slice(3, 5, None)), (slice(2, 4, None), slice(0, 2, None)))
    """
    parts = []
    for start, size, limit in zip(first, window_shape, image_shape, strict=True):
        low = max(start, 0)
        high = max(min(start + size, limit), low)
        parts.append((slice(low, high), slice(low - start, high - start)))
    (rows, in_rows), (cols, in_cols) = parts
    return (rows, cols), (in_rows, in_cols)


class WindowedResampler:
    """Resampling of the part of an image that some points need.

    Parameters
    ----------
    low, high : numpy.ndarray
        (2,) smallest and largest row and column of the points.

    Attributes
    ----------
    first : tuple of int
        Row and column of the image at which the window begins; may be negative.
    window : numpy.ndarray
        (rows, cols) float32: part of the image that is needed, to be filled in before each call.
    """

    def __init__(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
        self.first = floor(low[0]) - LOBES, floor(low[1]) - LOBES
        rows, cols = (ceil(b) + LOBES + 2 - a for a, b in zip(self.first, high, strict=True))
        self.window = np.zeros((rows, cols), np.float32)

    def filled(self, image: NDArray[np.float32]) -> Self:
        """Fill the window, which is zero, with an image (rows, cols) float32 as far as that reaches; return self."""
        in_image, in_window = overlap(self.first, self.window.shape, image.shape)
        self.window[in_window] = image[in_image]
        return self


class Resampler(WindowedResampler):
    """Resampling of images through one affine map; buffers are reused.

    The map is applied in two passes, along the rows and then along the columns. Along the direction that is not
    resampled, the fraction of a pixel changes only by the map's small rotation: a block of pixels shares its weights,
    corrected to first order, so that the innermost loops are plain sums of contiguous rows.

    Parameters
    ----------
    grid_to_image : numpy.ndarray
        (2, 3): maps (row, col, 1) on the grid to (row, col) in the image. Near the identity in scale and rotation.
    side : int
        Rows and columns of the grid.
    """

    def __init__(self, grid_to_image: NDArray[np.float64], side: int) -> None:
        corners = np.array([(r, c, 1.0) for r in (0, side - 1) for c in (0, side - 1)]) @ grid_to_image.T
        low, high = corners.min(axis=0), corners.max(axis=0)
        super().__init__(low, high)
        rows, cols = self.window.shape
        self._window_across = np.empty((cols, rows), np.float32)
        self._resampled_across = np.empty((side, rows), np.float32)
        self._resampled = np.empty((rows, side), np.float32)
        (a, b, r0), (c, d, c0) = grid_to_image
        shear = c / a
        self._across = (c0 - self.first[1] - shear * (r0 - self.first[0]), d - shear * b, shear)
        self._down = (r0 - self.first[0], a, b)
        step = 1e-3
        self._table = tabulated_taps()
        self._derivative = (tabulated_taps(step) - tabulated_taps(-step)) / np.float32(2 * step)

    def __call__(self, out: NDArray[np.float32]) -> NDArray[np.float32]:
        """Resample the content of the window into `out`, (side, side) float32, and return it."""
        cv2.transpose(self.window, dst=self._window_across)
        _resample_down(self._window_across, *self._across, self._table, self._derivative, self._resampled_across)
        cv2.transpose(self._resampled_across, dst=self._resampled)
        _resample_down(self._resampled, *self._down, self._table, self._derivative, out)
        return out


def resampled(image: NDArray[np.float32], grid_to_image: NDArray[np.float64], side: int) -> NDArray[np.float32]:
    """Resample one image once; pixels outside of the image are zero.

    Parameters
    ----------
    image : numpy.ndarray
        (rows, cols) float32.
    grid_to_image : numpy.ndarray
        (2, 3), as in :class:`Resampler`.
    side : int
        Rows and columns of the grid.

    Returns
    -------
    numpy.ndarray
        (side, side) float32.
    """
    return Resampler(grid_to_image, side).filled(image)(np.empty((side, side), np.float32))


def cropped(image: NDArray[np.float32], centre: tuple[float, float], side: int) -> NDArray[np.float32]:
    """Resample a square crop about a place in an image; pixels outside of the image are zero.

    Parameters
    ----------
    image : numpy.ndarray
        (rows, cols) float32.
    centre : tuple of float
        (row, col) in the image of the crop's middle.
    side : int
        Rows and columns of the crop.

    Returns
    -------
    numpy.ndarray
        (side, side) float32.
    """
    return resampled(image, crop_to_frame(centre, side), side)


@kernel
def _resample_down(
    image: NDArray[np.float32],
    start: float,
    per_row: float,
    per_col: float,
    table: NDArray[np.float32],
    derivative: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Interpolate each column of an image at rows start + per_row * (row of out) + per_col * column."""
    rows, cols = image.shape
    block = cols
    if abs(per_col) * cols > 2 * _MAX_DEVIATION_PX:
        block = max(1, int(2 * _MAX_DEVIATION_PX / abs(per_col)))
    slope = np.float32(per_col)
    for r in range(out.shape[0]):
        for first in range(0, cols, block):
            last = min(first + block, cols)
            half = np.float32(0.5 * (last - first - 1))
            at = start + per_row * r + per_col * 0.5 * (first + last - 1)
            whole = int(np.floor(at))
            phase = int((at - whole) * PHASES + 0.5)
            top = min(max(whole - LOBES + 1, 0), rows - 2 * LOBES)
            total = out[r, first:last]
            for k in range(0, 2 * LOBES, 4):
                x0, x1 = image[top + k, first:last], image[top + k + 1, first:last]
                x2, x3 = image[top + k + 2, first:last], image[top + k + 3, first:last]
                d0, d1 = slope * derivative[phase, k], slope * derivative[phase, k + 1]
                d2, d3 = slope * derivative[phase, k + 2], slope * derivative[phase, k + 3]
                w0, w1 = table[phase, k] - half * d0, table[phase, k + 1] - half * d1
                w2, w3 = table[phase, k + 2] - half * d2, table[phase, k + 3] - half * d3
                if k == 0:
                    total[:] = 0
                for c in range(total.shape[0]):
                    t = np.float32(np.int32(c))  # of 32 bits, which are converted in vectors
                    total[c] += ((w0 + t * d0) * x0[c] + (w1 + t * d1) * x1[c]) + (
                        (w2 + t * d2) * x2[c] + (w3 + t * d3) * x3[c]
                    )
