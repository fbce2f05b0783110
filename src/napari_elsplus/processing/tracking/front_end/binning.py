"""The two views of a raw frame, binned onto a coarser grid, subtracted and smoothed in one pass over its memory.

Four rows of the grid at a time, so that everything but the camera's memory and the result stays in the processor's
nearest cache; the memory that comes next is prefetched.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from napari_elsplus.processing.compiled import lean_kernel, prefetch
from napari_elsplus.processing.tracking.front_end.binned_blocks import AHEAD, bin_blocks
from napari_elsplus.processing.tracking.front_end.smoothed_rows import MARGIN, ROWS, WIDTH, smooth_rows
from napari_elsplus.processing.tracking.front_end.view_blocks import HELD

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.view_blocks import ViewBlocks

    Frame = NDArray[Any]
    Image = NDArray[np.float32]


@lean_kernel
def subtract_views(
    raw: Frame, raw_residual: Frame, pixels: tuple[int, ...], blocks: ViewBlocks,
    weights: tuple[np.float32, np.float32], factors: Image, rows: Image, out: Image,
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
    factors : numpy.ndarray
        Scale and offset, of :func:`~napari_elsplus.processing.tracking.front_end.view_blocks.interleaved`. The
        smoothing kernel 1 4 6 4 1, a Gaussian of one pixel, is not normalised.
    rows : numpy.ndarray
        From :func:`~napari_elsplus.processing.tracking.front_end.view_blocks.scratch`.
    out : numpy.ndarray
        (n, n) float32 image, C-contiguous; zero where the scale and the offset are.
    """
    rows[:] = np.float32(0)
    for n in range(AHEAD):
        for r in range(len(pixels)):
            prefetch(raw, r, blocks.places[n, 0])
            prefetch(raw_residual, r, blocks.places[n, 1])
    for group in range(len(blocks.first) - 1):
        for row in range(ROWS * group, ROWS * (group + 1)):
            before, here = blocks.ends[row], blocks.ends[row + HELD]
            rows[before[0] : here[0]] = np.float32(0)
            rows[here[1] : before[1]] = np.float32(0)
        bin_blocks(
            raw, raw_residual, pixels, blocks.places, blocks.fractions, blocks.first[group], blocks.first[group + 1],
            blocks.slopes, weights, rows,
        )  # fmt: skip
        if group > 0:
            half, other = MARGIN + (group - 1) % 2 * ROWS * WIDTH, MARGIN + group % 2 * ROWS * WIDTH
            row = ROWS * (group - 1)
            smooth_rows(rows, half, other, factors, 2 * WIDTH * row, out, row)


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
