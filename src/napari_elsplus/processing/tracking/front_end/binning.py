"""The two views of a raw frame, binned onto a coarser grid, subtracted and smoothed in one pass over its memory.

The camera's memory that comes next is prefetched.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from napari_elsplus.processing.compiled import lean_kernel, prefetch
from napari_elsplus.processing.tracking.front_end.binned_blocks import AHEAD, BLOCK, bin_blocks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.view_blocks import ViewBlocks

    Frame = NDArray[Any]
    Image = NDArray[np.float32]


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
        From :func:`~napari_elsplus.processing.tracking.front_end.view_blocks.scratch`.
    out : numpy.ndarray
        (n, n) float32 image, C-contiguous; zero where the scale and the offset are.
    """
    for n in range(AHEAD):
        for r in range(len(pixels)):
            prefetch(raw, r, blocks.places[n, 0])
            prefetch(raw_residual, r, blocks.places[n, 1])
    bin_blocks(
        raw, raw_residual, pixels, blocks.places, blocks.fractions, len(blocks.places) - AHEAD, blocks.slopes, weights,
        binned.reshape(-1),
    )  # fmt: skip
    four, six, side = np.float32(4), np.float32(6), out.shape[1]
    line = binned[-1]
    for row in range(len(out)):
        r0, r1, r2, r3, r4 = binned[row], binned[row + 1], binned[row + 2], binned[row + 3], binned[row + 4]
        for k in range(len(line)):
            line[k] = r0[k] + r4[k] + four * (r1[k] + r3[k]) + six * r2[k]
        c0, c1, c2 = line[BLOCK - 2 :], line[BLOCK - 1 :], line[BLOCK:]
        c3, c4 = line[BLOCK + 1 :], line[BLOCK + 2 :]
        into, times, less = out[row], scale[row], offset[row]
        for k in range(side):
            into[k] = times[k] * (c0[k] + c4[k] + four * (c1[k] + c3[k]) + six * c2[k]) - less[k]


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
