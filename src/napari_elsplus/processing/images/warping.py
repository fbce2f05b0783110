"""Resampling through an affine map with low-order distortion, by the windowed sinc of :mod:`resampling`.

The distortion is a polynomial of third degree in the position on the confocal view. It contains every radial distortion
of third order about any centre, and the difference of two of them. Positions are tabulated once; an image is resampled
along its rows and then along its columns, with weights of its own for every pixel.
"""

from __future__ import annotations

from math import ceil, floor
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import kernel
from napari_elsplus.processing.images.resampling import LOBES, taps

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

POWERS: Final = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
"""Powers of row and column of the ten terms of the polynomial."""
_PHASES: Final = 256
"""Number of tabulated fractions of a pixel; derived: half a step is an error of 0.002 px."""


def polynomial_terms(rows: Floats, cols: Floats) -> Floats:
    """Return the ten terms of the polynomial at normalised positions.

    Parameters
    ----------
    rows, cols : numpy.ndarray
        Position about the confocal centre over the bundle's radius, any one shape.

    Returns
    -------
    numpy.ndarray
        (10, ...) in the order of :data:`POWERS`.

    Examples
    --------
    >>> polynomial_terms(np.array(2.0), np.array(3.0)).tolist()
    [1.0, 2.0, 3.0, 4.0, 6.0, 9.0, 8.0, 12.0, 18.0, 27.0]
    """
    return np.stack([rows**down * cols**across for down, across in POWERS])


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


class WarpedResampler:
    """Resampling of images at tabulated positions; the counterpart of :class:`Resampler` for distorted views.

    Parameters
    ----------
    positions : numpy.ndarray
        (2, n, n): row and column in the image of each pixel of the grid. Rows grow with rows, columns with columns.

    Attributes
    ----------
    first : tuple of int
        Row and column of the image at which the window begins; may be negative.
    window : numpy.ndarray
        (rows, cols) float32: part of the image that is needed, to be filled in before each call.
    """

    def __init__(self, positions: Floats) -> None:
        low, high = positions.min(axis=(1, 2)), positions.max(axis=(1, 2))
        self.first = (floor(low[0]) - LOBES, floor(low[1]) - LOBES)
        rows, cols = (ceil(b) + LOBES + 2 - a for a, b in zip(self.first, high, strict=True))
        self.window = np.zeros((rows, cols), np.float32)
        down, across = (at - first for at, first in zip(positions, self.first, strict=True))
        side = down.shape[1]
        crossing = np.empty((rows, side))
        for c in range(side):
            crossing[:, c] = np.interp(np.arange(rows), down[:, c], across[:, c])
        self._left, self._left_phase = _split(crossing, cols)
        self._top, self._top_phase = _split(down, rows)
        self._between = np.empty((rows, side), np.float32)
        self._table = taps(np.arange(_PHASES + 1) / _PHASES)

    def __call__(self, out: NDArray[np.float32]) -> NDArray[np.float32]:
        """Resample the content of the window into `out`, (n, n) float32, and return it."""
        _along_rows(self.window, self._left, self._left_phase, self._table, self._between)
        _along_columns(self._between, self._top, self._top_phase, self._table, out)
        return out


def warped(image: NDArray[np.float32], positions: Floats) -> NDArray[np.float32]:
    """Resample one image once at positions; pixels outside of the image are zero.

    Parameters
    ----------
    image : numpy.ndarray
        (rows, cols) float32.
    positions : numpy.ndarray
        (2, n, n), as in :class:`WarpedResampler`.

    Returns
    -------
    numpy.ndarray
        (n, n) float32.
    """
    resampler = WarpedResampler(positions)
    (top, left), window = resampler.first, resampler.window
    low = max(top, 0), max(left, 0)
    high = min(top + window.shape[0], image.shape[0]), min(left + window.shape[1], image.shape[1])
    seen = image[low[0] : max(high[0], low[0]), low[1] : max(high[1], low[1])]
    window[low[0] - top : low[0] - top + seen.shape[0], low[1] - left : low[1] - left + seen.shape[1]] = seen
    return resampler(np.empty(positions.shape[1:], np.float32))


def _split(at: Floats, size: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the first of the twelve pixels from which each sample is interpolated, and its tabulated fraction."""
    whole = np.floor(at)
    first = np.clip(whole - LOBES + 1, 0, size - 2 * LOBES).astype(np.int32)
    return first, ((at - whole) * _PHASES + 0.5).astype(np.int32)


@kernel
def _along_rows(
    image: NDArray[np.float32],
    left: NDArray[np.int32],
    phase: NDArray[np.int32],
    table: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Interpolate each row of an image at a column of its own for every pixel."""
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            total = np.float32(0)
            for k in range(2 * LOBES):
                total += table[phase[r, c], k] * image[r, left[r, c] + k]
            out[r, c] = total


@kernel
def _along_columns(
    image: NDArray[np.float32],
    top: NDArray[np.int32],
    phase: NDArray[np.int32],
    table: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Interpolate each column of an image at a row of its own for every pixel."""
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            total = np.float32(0)
            for k in range(2 * LOBES):
                total += table[phase[r, c], k] * image[top[r, c] + k, c]
            out[r, c] = total
