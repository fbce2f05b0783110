"""Which blocks of pixels the rows of the grid consist of, and where each lies in the frame; found once.

Whole-pixel shifts of the residual view are constant over long runs of columns. A run is divided into blocks. The last
one ends where the run ends, so that it reads no pixels beyond, and fills only pixels of the run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from napari_elsplus.errors import CalibrationError
from napari_elsplus.processing.tracking.front_end.binned_blocks import AHEAD, BLOCK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Indices = NDArray[np.intp]
    Matrix = NDArray[np.float64]


class ViewBlocks(NamedTuple):
    """Blocks of the rows of the grid.

    Parameters
    ----------
    places : numpy.ndarray
        (blocks, 4) int32: elements of the frame, counted through its rows, of the first camera pixel of the confocal
        view and of the residual one; element of :func:`scratch`; bits of the pixels that are filled. The last entry
        is repeated for as many blocks as are prefetched ahead.
    fractions : numpy.ndarray
        (blocks, 2) float32: rows and columns of the camera by which the residual view lies beyond its first pixel.
    slopes : tuple of float32
        Their changes from pixel to pixel of the grid.
    """

    places: NDArray[np.int32]
    fractions: NDArray[np.float32]
    slopes: tuple[np.float32, np.float32]


def view_blocks(
    confocal: Matrix, residual: Matrix, binning: int, lit: NDArray[np.bool_], frame_shape: tuple[int, int]
) -> ViewBlocks:
    """Return the blocks of a grid.

    Parameters
    ----------
    confocal, residual : numpy.ndarray
        (2, 3): from (row, col, 1), counted in camera pixels from the grid's corner, to (row, col) in the frame. The
        confocal view is taken at whole pixels.
    binning : int
        Camera pixels per grid pixel in a row.
    lit : numpy.ndarray
        (n, n) bool: pixels of the grid that are filled; of each row those from one column to another.
    frame_shape : tuple of int
        Rows and columns of the frames, in which the lit pixels lie.

    Raises
    ------
    CalibrationError
        If the frames have hardly more pixels than a block.
    """
    rows, cols = np.nonzero(lit)
    memory = (rows + 2) * scratch(len(lit)).shape[1] + BLOCK + cols
    corners = np.stack([_corners(view, binning, rows, cols) for view in (confocal, residual)])
    whole = np.floor(corners)
    elements = (frame_shape[1] * whole[:, 0] + whole[:, 1]).astype(int)
    breaks = (np.diff(elements) != binning).any(axis=0) | (np.diff(rows) != 0)
    ends = np.append(np.flatnonzero(breaks) + 1, len(rows))
    begins = np.append(0, ends[:-1])
    # blocks of each run: their first pixels, counted through the lit ones, of which those before the run are not filled
    counts = -(-(ends - begins) // BLOCK)
    run = np.repeat(np.arange(len(counts)), counts)
    begin, end = begins[run], ends[run]
    start = begin + BLOCK * (np.arange(len(run)) - np.repeat(np.cumsum(counts) - counts, counts))
    in_frame = begin - elements[:, begin].min(axis=0) // binning
    start = np.where(start + BLOCK <= end, start, np.maximum(end - BLOCK, in_frame))
    at = elements[:, begin] + binning * (start - begin)
    if at.max() + binning * (frame_shape[1] + BLOCK) >= frame_shape[0] * frame_shape[1]:
        raise CalibrationError(
            f"frames of {frame_shape[0]} x {frame_shape[1]} pixels are too small", "record a larger region"
        )
    low, high = np.maximum(begin - start, 0), np.minimum(end - start, BLOCK)
    filled = (1 << high) - (1 << low)
    places = np.stack([*at, memory[begin] + start - begin, filled], axis=1).astype(np.uint32).view(np.int32)
    slopes = binning * (residual[:, 1] - (0.0, 1.0))
    fractions = (corners[1] - whole[1])[:, begin] + slopes[:, None] * (start - begin)
    return ViewBlocks(
        np.pad(places, ((0, AHEAD), (0, 0)), mode="edge"),
        np.ascontiguousarray(fractions.T, np.float32),
        (np.float32(slopes[0]), np.float32(slopes[1])),
    )


def scratch(side: int) -> NDArray[np.float32]:
    """Return memory for the binned rows of a grid of that side, with two rows of zeros on either side, and for a line.

    Rows have margins of a block on either side, into which one that begins before the row, or ends after it, reaches.
    """
    return np.zeros((side + 5, side + 2 * BLOCK), np.float32)


def _corners(view: Matrix, binning: int, rows: Indices, cols: Indices) -> NDArray[np.float64]:
    """Return where in the frame the first camera pixels of pixels of the grid lie, (2, n)."""
    half = 0.5 * (binning - 1)
    corners: NDArray[np.float64] = view @ np.stack([binning * rows + half, binning * cols + half, np.ones(len(rows))])
    return corners - half
