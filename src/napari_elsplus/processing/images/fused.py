"""Fused sectioning: LS, residual and ELS+ of raw frames in one pass over the memory.

It holds for views that are nearly parallel to the camera, as those of a bench are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.images.blocks import BLOCK, MAX_EXPANSION_PX, TAPS, expanded_weights
from napari_elsplus.processing.images.fused_kernel import BAND, LINE, WIDTH, section_views
from napari_elsplus.processing.vectors import aligned_zeros

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.images.fused_kernel import ViewArrays

_KEPT: Final = 64
"""Rows beyond a band's that are kept before they are moved; chosen: eight bands share one
move."""
MAX_SLOPE: Final = MAX_EXPANSION_PX / (0.5 * BLOCK)
"""Largest rotation, rad: 0.86 degrees; derived: within a block the expansion of the weights holds."""
MAX_STRETCH: Final = MAX_EXPANSION_PX / (0.5 * BLOCK)
"""Largest difference of the scale from 1; derived likewise."""
_NOT_WANTED: Final = np.empty((0, 0), np.float32)
"""In place of an image that is not computed."""


class View:
    """A bundle view of the frame: its map, weights and memory.

    Parameters
    ----------
    grid_to_frame : numpy.ndarray
        (2, 3): maps (row, col, 1) on the grid to (row, col) in the frame.
    side : int
        Rows and columns of the grid.
    factor : float
        By which the grey levels are multiplied.

    Attributes
    ----------
    at_whole_pixels : bool
        The map is a shift by whole pixels: nothing is interpolated.
    """

    def __init__(self, grid_to_frame: NDArray[np.float64], side: int, factor: float) -> None:
        (a, b, row), (c, d, col) = grid_to_frame
        shear = c / a
        along = d - shear * b
        shift_only = np.allclose(grid_to_frame[:, :2], np.eye(2), atol=1e-9)
        self.at_whole_pixels = bool(shift_only and np.allclose([row, col], np.rint([row, col]), atol=1e-6))
        kept = int(abs(b) * WIDTH + BAND * a) + TAPS + 6 + _KEPT
        weights = expanded_weights().ravel()
        self._map = np.array([row, a, b, col - shear * row, shear, along])
        self._sizes = np.array([kept, 0, 0])
        self._memory = aligned_zeros(WIDTH * (BAND + kept) + 2 * LINE)
        self._weights = weights, weights * np.float32(factor)

    @property
    def arrays(self) -> ViewArrays:
        """Map; sizes and progress; weights along the columns and, times the factor, along the rows; memory."""
        return (self._map, self._sizes, *self._weights, self._memory)


class FusedSections:
    """Sectioning of frames in one pass, for two views that are nearly parallel to the camera.

    Beyond the frame its edge is continued.

    Parameters
    ----------
    grid_to_confocal, grid_to_residual : numpy.ndarray
        (2, 3): map (row, col, 1) on the grid to (row, col) in the frame.
    residual_gain : float
        Brightness of the residual view over the confocal one.
    inside : numpy.ndarray
        (n, n), bool: the lit disc.
    background : numpy.ndarray or None
        (rows, cols) float32, grey levels.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    factors : numpy.ndarray, optional
        (n, n) float32, by which the residual view is multiplied besides.
    """

    def __init__(
        self,
        grid_to_confocal: NDArray[np.float64],
        grid_to_residual: NDArray[np.float64],
        residual_gain: float,
        inside: NDArray[np.bool_],
        background: NDArray[np.float32] | None,
        frame_shape: tuple[int, int],
        factors: NDArray[np.float32] | None = None,
    ) -> None:
        side = len(inside)
        self._views = View(grid_to_confocal, side, 1.0), View(grid_to_residual, side, 1 / residual_gain)
        self._extents = extents(inside)
        self._factors = _NOT_WANTED if factors is None else np.ascontiguousarray(factors, np.float32)
        dark = np.zeros(frame_shape, np.float32) if background is None else background
        self._background = np.ascontiguousarray(dark, np.float32)

    @staticmethod
    def fits(grid_to_frame: NDArray[np.float64], side: int) -> bool:
        """Return True if a view's rotation, scale and size are within the limits.

        Parameters
        ----------
        grid_to_frame : numpy.ndarray
            (2, 3): maps (row, col, 1) on the grid to (row, col) in the frame.
        side : int
            Rows and columns of the grid.
        """
        (a, b, _), (c, d, _) = grid_to_frame
        rotation, stretch = max(abs(b), abs(c / a)), max(abs(a - 1), abs(d - c / a * b - 1))
        return bool(rotation <= MAX_SLOPE and stretch <= MAX_STRETCH and side <= WIDTH)

    def __call__(
        self,
        raw: NDArray[np.generic],
        raw_residual: NDArray[np.generic],
        ls: NDArray[np.float32] | None,
        residual: NDArray[np.float32] | None,
        els: NDArray[np.float32] | None,
    ) -> None:
        """Fill the images that are given, (n, n) float32, from the frames of the two views."""
        kind = np.uint8 if raw.dtype == raw_residual.dtype == np.uint8 else np.float32
        frame = np.ascontiguousarray(raw, kind)
        next_frame = frame if raw_residual is raw else np.ascontiguousarray(raw_residual, kind)
        wanted = [_NOT_WANTED if image is None else image for image in (ls, residual, els)]
        filled = [image if image.flags.c_contiguous else np.empty_like(image, order="C") for image in wanted]
        confocal, aligned = self._views
        section_views(
            frame, next_frame, self._background, confocal.arrays, aligned.arrays, confocal.at_whole_pixels,
            *self._extents, self._factors, *filled,
        )  # fmt: skip
        for image, made in zip(wanted, filled, strict=True):
            if made is not image:
                np.copyto(image, made)

    def ls(self, raw: NDArray[np.generic], out: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the confocal view of a raw frame.

        Parameters
        ----------
        raw : numpy.ndarray
            (rows, cols) grey levels.
        out : numpy.ndarray
            (n, n) float32, filled and returned.
        """
        self(raw, raw, out, None, None)
        return out


def extents(inside: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the extent of a disc by rows and by blocks of columns.

    Parameters
    ----------
    inside : numpy.ndarray
        (n, n), bool: convex.

    Returns
    -------
    spans : numpy.ndarray
        (n, 2): first column of each row, and the one after its last; 0, 0 for an empty row.
    blocks : numpy.ndarray
        (blocks, 2): the same for rows, of each block of 16 columns.
    """
    side = len(inside)
    padded = np.zeros((-(-side // BLOCK) * BLOCK, side), bool)
    padded[:side] = inside.T
    by_block: NDArray[np.bool_] = np.logical_or.reduce(padded.reshape(-1, BLOCK, side), axis=1)
    return _extent(inside), _extent(by_block)


def _extent(lines: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the first element of each line that is True, and the one after the last."""
    lit = np.logical_or.reduce(lines, axis=1)
    first, last = lines.argmax(axis=1), lines.shape[1] - lines[:, ::-1].argmax(axis=1)
    return np.where(lit[:, None], np.column_stack([first, last]), 0).astype(np.int64)
