"""The two views of a raw frame, binned onto a coarser grid, subtracted and smoothed in one pass over its memory.

The rows of the grid consist of blocks of pixels. Which these are, and where each lies in the frame, is found once:
whole-pixel shifts of the residual view are constant over long runs of columns. A run is divided into blocks. The last
one ends where the run ends, so that it reads no pixels beyond, and fills only pixels of the run. The camera's memory
that comes next is prefetched. A row is smoothed as soon as it is binned with its neighbours, so that no more than these
have to stay in the nearest cache.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from napari_elsplus.errors import CalibrationError
from napari_elsplus.processing.compiled import lean_kernel, prefetch
from napari_elsplus.processing.tracking.front_end.binned_blocks import AHEAD, BLOCK, VECTOR, bin_blocks, smooth_row
from napari_elsplus.processing.vectors import aligned_zeros

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Frame = NDArray[Any]
    Image = NDArray[np.float32]
    Indices = NDArray[np.intp]
    Matrix = NDArray[np.float64]


_ROWS: Final = 8
"""Binned rows that are kept, at least the five of the smoothing kernel."""
MARGIN: Final = BLOCK + 2
"""Columns before the first pixel of a binned row: a block, and two of the smoothing kernel, so that what it reads is at
multiples of a vector."""


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
    rows : numpy.ndarray
        (n, 3) int32, for each row of the grid: the block after its last one; its first lit column, and the one after
        the last.
    """

    places: NDArray[np.int32]
    fractions: NDArray[np.float32]
    slopes: tuple[np.float32, np.float32]
    rows: NDArray[np.int32]


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
    memory = rows % _ROWS * scratch(len(lit)).shape[1] + MARGIN + cols
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
    first, last = lit.argmax(axis=1), lit.any(axis=1) * (len(lit) - lit[:, ::-1].argmax(axis=1))
    slopes = binning * (residual[:, 1] - (0.0, 1.0))
    fractions = (corners[1] - whole[1])[:, begin] + slopes[:, None] * (start - begin)
    return ViewBlocks(
        np.pad(places, ((0, AHEAD), (0, 0)), mode="edge"),
        np.ascontiguousarray(fractions.T, np.float32),
        (np.float32(slopes[0]), np.float32(slopes[1])),
        np.stack([np.searchsorted(rows[begin], np.arange(len(lit)), "right"), first, last], axis=1).astype(np.int32),
    )


def scratch(side: int) -> NDArray[np.float32]:
    """Return memory for the newest binned rows of a grid of that side.

    Rows have margins of a block on either side, into which one that begins before the row, or ends after it, reaches.
    """
    width = -(-(side + MARGIN + BLOCK) // VECTOR) * VECTOR
    return aligned_zeros(_ROWS * width).reshape(_ROWS, width)


def _corners(view: Matrix, binning: int, rows: Indices, cols: Indices) -> NDArray[np.float64]:
    """Return where in the frame the first camera pixels of pixels of the grid lie, (2, n)."""
    half = 0.5 * (binning - 1)
    corners: NDArray[np.float64] = view @ np.stack([binning * rows + half, binning * cols + half, np.ones(len(rows))])
    return corners - half


@lean_kernel
def subtract_views(
    raw: Frame, raw_residual: Frame, pixels: tuple[int, ...], blocks: ViewBlocks,
    weights: tuple[np.float32, np.float32], scale: Image, offset: Image, binned: Image, out: Image,
) -> None:  # fmt: skip
    """Add both views of a frame, binned and weighted; smooth; multiply by a scale and subtract an offset.

    Parameters
    ----------
    raw, raw_residual : numpy.ndarray
        (rows, cols), C-contiguous: frames that the confocal and the residual view are taken from.
    pixels : tuple of int
        0, 1, ...: as many as there are camera pixels per grid pixel in a row; compiled for that number.
    blocks : ViewBlocks
        Of both views in frames of this size.
    weights : tuple of float32
        Of the two views.
    scale, offset : numpy.ndarray
        (n, n) float32. The smoothing kernel 1 4 6 4 1, a Gaussian of one pixel, is not normalised.
    binned : numpy.ndarray
        From :func:`scratch`.
    out : numpy.ndarray
        (n, n) float32 image, C-contiguous; zero where the scale and the offset are, and in its last row's last pixels.
    """
    for n in range(AHEAD):
        for r in range(len(pixels)):
            prefetch(raw, r, blocks.places[n, 0])
            prefetch(raw_residual, r, blocks.places[n, 1])
    side, width = out.shape[1], binned.shape[1]
    memory, times, less, image = binned.reshape(-1), scale.reshape(-1), offset.reshape(-1), out.reshape(-1)
    binned[:] = 0
    begin = 0
    for newest in range(len(out) + 2):
        end = blocks.rows[min(newest, len(out) - 1), 0]
        binned[newest % _ROWS] = 0
        bin_blocks(
            raw, raw_residual, pixels, blocks.places, blocks.fractions, (begin, end), blocks.slopes, weights, memory
        )
        begin, row = end, newest - 2
        if row < 0:
            continue
        out[row] = 0
        first, last = blocks.rows[row, 1] // VECTOR * VECTOR, blocks.rows[row, 2]
        at = row * side + first
        # the last vector of a row may reach into the next one, which follows, but not beyond the image
        count = min((last - first + VECTOR - 1) // VECTOR, (len(image) - at) // VECTOR)
        col = MARGIN + first - 2
        above, over, here = (row - 2) % _ROWS * width, (row - 1) % _ROWS * width, row % _ROWS * width
        under, below = (row + 1) % _ROWS * width, newest % _ROWS * width
        begins = above + col, over + col, here + col, under + col, below + col
        smooth_row(memory, begins, times, less, image, at, count)


@lean_kernel
def survey(part: Frame, limit: float) -> tuple[float, float, bool]:
    """Return the mean level of `part` (rows, cols) of a frame, the share at a `limit`, and if all is at one level."""
    total, full, alike = 0.0, 0, 0
    rows, cols = part.shape
    for r in range(rows):
        for c in range(cols):
            total += part[r, c]
            full += part[r, c] == limit
            alike += part[r, c] == part[0, 0]
    return total / part.size, full / part.size, alike == part.size
