"""Resampling through an affine map with low-order distortion, by the windowed sinc of :mod:`resampling`.

The distortion is a polynomial of third degree in the position on the confocal view. It contains every radial distortion
of third order about any centre, and the difference of two of them. Positions are tabulated once; an image is resampled
along its rows and then along its columns, with weights of its own for every pixel.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import kernel
from napari_elsplus.processing.images.resampling import LOBES, PHASES, WindowedResampler, tabulated_taps

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

POWERS: Final = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
"""Powers of row and column of the ten terms of the polynomial."""


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


class WarpedResampler(WindowedResampler):
    """Resampling of images at tabulated positions; the counterpart of :class:`Resampler` for distorted views.

    Parameters
    ----------
    positions : numpy.ndarray
        (2, n, n): row and column in the image of each pixel of the grid. Rows grow with rows, columns with columns.
    """

    def __init__(self, positions: Floats) -> None:
        low, high = positions.min(axis=(1, 2)), positions.max(axis=(1, 2))
        super().__init__(low, high)
        rows, cols = self.window.shape
        down, across = (at - first for at, first in zip(positions, self.first, strict=True))
        side = down.shape[1]
        crossing = np.empty((rows, side))
        for c in range(side):
            crossing[:, c] = np.interp(np.arange(rows), down[:, c], across[:, c])
        left, self._left_phase = _split(crossing, cols)
        top, self._top_phase = _split(down, rows)
        self._left = left + cols * np.arange(rows, dtype=np.int32)[:, None]
        self._top = side * top + np.arange(side, dtype=np.int32)
        self._between = np.empty((rows, side), np.float32)
        self._table = tabulated_taps()

    def __call__(self, out: NDArray[np.float32]) -> NDArray[np.float32]:
        """Resample the content of the window into `out`, (n, n) float32, and return it."""
        _interpolate(self.window.ravel(), self._left, 1, self._left_phase, self._table, self._between)
        _interpolate(self._between.ravel(), self._top, self._between.shape[1], self._top_phase, self._table, out)
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
    return WarpedResampler(positions).filled(image)(np.empty(positions.shape[1:], np.float32))


def _split(at: Floats, size: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the first of the twelve pixels from which each sample is interpolated, and its tabulated fraction."""
    whole = np.floor(at)
    first = np.clip(whole - LOBES + 1, 0, size - 2 * LOBES).astype(np.int32)
    return first, ((at - whole) * PHASES + 0.5).astype(np.int32)


@kernel
def _interpolate(
    pixels: NDArray[np.float32],
    first: NDArray[np.int32],
    step: int,
    phase: NDArray[np.int32],
    table: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Interpolate among twelve of some pixels for every sample, from the first of them and a step apart."""
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            total = np.float32(0)
            for k in range(2 * LOBES):
                total += table[phase[r, c], k] * pixels[first[r, c] + k * step]
            out[r, c] = total
