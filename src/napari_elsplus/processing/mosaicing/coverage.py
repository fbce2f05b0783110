"""Coverage maps of a mosaic: number of frames over each cell, and their mean tracking score."""

from __future__ import annotations

from math import ceil
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.mosaicing.tiles import Rectangle

CELL_PX: Final = 8
"""Side of a cell of the maps, pixels of the mosaic; chosen: about 1/30 of a frame, so that maps show single discs."""


class Coverage:
    """Count of frames over each cell of a mosaic, and mean of their scores.

    Parameters
    ----------
    part : Rectangle
        Part of the mosaic that the maps cover.
    radius : float
        Radius of the disc that is used of a frame, pixels of the mosaic.

    Examples
    --------
    >>> from napari_elsplus.processing.mosaicing.tiles import Rectangle
    >>> coverage = Coverage(Rectangle(0, 0, 16, 24), 6.0)
    >>> coverage.add(np.array([[8.0, 8.0], [8.0, 16.0]]), np.array([np.nan, 0.5]))
    >>> coverage.frames.tolist(), coverage.quality.tolist()
    ([[1.0, 2.0, 1.0], [1.0, 2.0, 1.0]], [[nan, 0.5, 0.5], [nan, 0.5, 0.5]])
    """

    def __init__(self, part: Rectangle, radius: float) -> None:
        self.part, self._radius = part, radius
        shape = tuple(ceil(length / CELL_PX) for length in part.shape)
        self._frames, self._scored, self._total = (np.zeros(shape, np.float32) for _ in range(3))

    def add(self, centres: NDArray[np.float64], scores: NDArray[np.float64]) -> None:
        """Add frames to the maps.

        Parameters
        ----------
        centres : numpy.ndarray
            (m, 2) float64 centres of inserted frames, (row, col) in pixels of the mosaic.
        scores : numpy.ndarray
            (m,) float64 correlation of each with the frame that it was registered to; NaN for a first frame.
        """
        corner = np.array([self.part.top, self.part.left], np.float64)
        cells = (np.asarray(centres, np.float64).reshape(-1, 2) - corner) / CELL_PX - 0.5
        stamp_discs(
            cells, np.ascontiguousarray(scores, np.float64), self._radius / CELL_PX,
            self._frames, self._scored, self._total,
        )  # fmt: skip

    @property
    def frames(self) -> NDArray[np.float32]:
        """Number of frames whose disc covers the middle of each cell, (rows, cols) float32."""
        return self._frames.copy()

    @property
    def quality(self) -> NDArray[np.float32]:
        """Mean score of these frames, (rows, cols) float32; NaN where none has a score."""
        return np.divide(self._total, self._scored, out=np.full_like(self._total, np.nan), where=self._scored > 0)


@kernel
def stamp_discs(
    centres: NDArray[np.float64],
    scores: NDArray[np.float64],
    radius: float,
    frames: NDArray[np.float32],
    scored: NDArray[np.float32],
    total: NDArray[np.float32],
) -> None:
    """Add each disc to the counts and, where it has a score, to the sums of scores.

    Parameters
    ----------
    centres : numpy.ndarray
        (m, 2) float64, (row, col) in cells.
    scores : numpy.ndarray
        (m,) float64; NaN where a frame has none.
    radius : float
        Of the discs, in cells.
    frames, scored, total : numpy.ndarray
        (rows, cols) float32 counts of frames and of frames with a score, and sum of the scores; modified in place.
    """
    rows, cols = frames.shape
    for k in range(len(centres)):
        row, col = centres[k]
        known = scores[k] == scores[k]  # NaN is not
        score = np.float32(scores[k]) if known else np.float32(0)
        for r in range(max(0, int(np.ceil(row - radius))), min(rows, int(np.floor(row + radius)) + 1)):
            half = np.sqrt(radius * radius - (r - row) * (r - row))
            for c in range(max(0, int(np.ceil(col - half))), min(cols, int(np.floor(col + half)) + 1)):
                frames[r, c] += np.float32(1)
                if known:
                    scored[r, c] += np.float32(1)
                    total[r, c] += score
