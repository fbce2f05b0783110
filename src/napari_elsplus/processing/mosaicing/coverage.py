"""How often each place of a mosaic was seen, and how well the frames that saw it were tracked."""

from __future__ import annotations

from math import ceil
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.mosaicing.tiles import Rectangle

CELL_PX: Final = 8
"""Rows and columns of the mosaic that make one cell of the maps."""


def coverage_maps(
    places: NDArray[np.float64], scores: NDArray[np.float64], radius: float, part: Rectangle, cell_px: int = CELL_PX
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Count the frames over each cell of a mosaic, and average their scores.

    Parameters
    ----------
    places : numpy.ndarray
        (m, 2) centres of the frames that were laid down, (row, col) in pixels of the mosaic.
    scores : numpy.ndarray
        (m,) correlation of each with the frame that it was linked to; NaN for one that was the first.
    radius : float
        Of what is used of a frame, pixels of the mosaic.
    part : Rectangle
        The part of the mosaic that the maps cover.
    cell_px : int
        Pixels of the mosaic along a side of a cell.

    Returns
    -------
    frames : numpy.ndarray
        (rows, cols) float32: frames whose disc covers the cell's middle.
    quality : numpy.ndarray
        (rows, cols) float32: the mean of their scores; 0 where no frame with a score was.

    Examples
    --------
    >>> from napari_elsplus.processing.mosaicing.tiles import Rectangle
    >>> frames, quality = coverage_maps(np.array([[8.0, 8.0], [8.0, 16.0]]), np.array([np.nan, 0.5]), 6.0,
    ...                                 Rectangle(0, 0, 16, 24))
    >>> frames.tolist(), quality.tolist()
    ([[1.0, 2.0, 1.0], [1.0, 2.0, 1.0]], [[0.0, 0.5, 0.5], [0.0, 0.5, 0.5]])
    """
    shape = tuple(ceil(length / cell_px) for length in part.shape)
    frames, scored, total = (np.zeros(shape, np.float32) for _ in range(3))
    corner = np.array([part.top, part.left], np.float64)
    where = (np.asarray(places, np.float64).reshape(-1, 2) - corner) / cell_px - 0.5
    stamp_discs(where, np.asarray(scores, np.float64), radius / cell_px, frames, scored, total)
    return frames, np.divide(total, scored, out=np.zeros_like(total), where=scored > 0)


@kernel
def stamp_discs(
    where: NDArray[np.float64],
    scores: NDArray[np.float64],
    radius: float,
    frames: NDArray[np.float32],
    scored: NDArray[np.float32],
    total: NDArray[np.float32],
) -> None:
    """Add each disc to the counts and, where it has a score, to the sums of scores."""
    rows, cols = frames.shape
    for k in range(len(where)):
        row, col = where[k]
        known = scores[k] == scores[k]  # NaN is not
        score = np.float32(scores[k]) if known else np.float32(0)
        for r in range(max(0, int(np.ceil(row - radius))), min(rows, int(np.floor(row + radius)) + 1)):
            half = np.sqrt(radius * radius - (r - row) * (r - row))
            for c in range(max(0, int(np.ceil(col - half))), min(cols, int(np.floor(col + half)) + 1)):
                frames[r, c] += np.float32(1)
                if known:
                    scored[r, c] += np.float32(1)
                    total[r, c] += score
