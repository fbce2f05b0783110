"""Poses of every frame of a live track, as the tracker estimated them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray


class TrackedPath:
    """Poses of every frame as tracked; lost ones are nan.

    Attributes
    ----------
    segments : list of int
        Those that there are, in their order.

    Examples
    --------
    >>> path = TrackedPath()
    >>> [path.add(0, 1.5 * k, 0.0) for k in range(3)], path.row.tolist()
    ([0, 1, 2], [0.0, 1.5, 3.0])
    """

    def __init__(self) -> None:
        self._count = 0
        self.segments: list[int] = []
        self._segment = np.zeros(1 << 10, np.int64)
        self._where = np.zeros((1 << 10, 2))

    def add(self, segment: int, row: float, col: float) -> int:
        """Add a frame; return its index.

        Parameters
        ----------
        segment : int
            As the tracker numbers them.
        row, col : float
            Tracked position, pixels of the grid.
        """
        index = self._count
        if index == len(self._segment):
            self._segment = np.concatenate([self._segment, np.zeros_like(self._segment)])
            self._where = np.concatenate([self._where, np.zeros_like(self._where)])
        self._segment[index], self._where[index] = segment, (row, col)
        if segment not in self.segments[-1:]:
            self.segments.append(segment)
        self._count += 1
        return index

    def __len__(self) -> int:
        return self._count

    def forget(self, segments: Iterable[int]) -> None:
        """Call the frames of some segments lost."""
        self._where[np.isin(self._segment, list(segments))] = np.nan

    @property
    def segment(self) -> NDArray[np.int64]:
        """(n,) by the tracker's count."""
        return self._segment[: self._count]

    @property
    def row(self) -> NDArray[np.float64]:
        """(n,) rows."""
        return self._where[: self._count, 0]

    @property
    def col(self) -> NDArray[np.float64]:
        """(n,) columns."""
        return self._where[: self._count, 1]
