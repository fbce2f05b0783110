"""A growing track in columns: one row of eighty bytes for every frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, overload

import numpy as np

from napari_elsplus.io.tables.tracks import STATES, TrackPoint

if TYPE_CHECKING:
    from collections.abc import Iterable

ROW: Final = np.dtype(
    [
        ("frame", "<i8"), ("time_s", "<f8"), ("segment", "<i8"), ("row_px", "<f8"), ("col_px", "<f8"),
        ("row_um", "<f8"), ("col_um", "<f8"), ("score", "<f8"), ("sigma_px", "<f8"), ("state", "<i8"),
    ]
)  # fmt: skip
"""One point of a track; `state` is an index into `STATES`."""
LOST: Final = STATES.index("lost")
_UNKNOWN: Final = ("row_px", "col_px", "row_um", "col_um", "score", "sigma_px")
_INITIAL_CAPACITY: Final = 1 << 10
"""Points for which memory is reserved first, doubled when they are full; chosen: seconds of frames."""


class TrackTable(Sequence[TrackPoint]):
    """Points of a track; one thread writes, any thread may read.

    Parameters
    ----------
    points : iterable of TrackPoint
        The first points.

    Attributes
    ----------
    rewritten : int
        Number of times that existing points changed.

    Examples
    --------
    >>> where = [(k, 0.1 * k, 0, 2.0 * k, 0.0, 4.0 * k, 0.0) for k in range(3)]
    >>> table = TrackTable(TrackPoint(*values, 0.9, 0.1, "tracked") for values in where)
    >>> table[-1].row_px, table.columns["row_um"].tolist(), table.counts
    (4.0, [0.0, 4.0, 8.0], {'tracked': 3, 'predicted': 0, 'lost': 0})
    >>> table.lose(0)
    >>> table[0].state, table.counts["lost"]
    ('lost', 3)
    """

    def __init__(self, points: Iterable[TrackPoint] = ()) -> None:
        self._rows = np.zeros(_INITIAL_CAPACITY, ROW)
        self._count = self.rewritten = 0
        self._states = np.zeros(len(STATES), np.int64)
        for point in points:
            self.append(point)

    def append(self, point: TrackPoint) -> None:
        """Append a point."""
        index = self._count
        self._ensure_capacity(index + 1)
        self._rows[index] = packed(point)
        self._states[self._rows["state"][index]] += 1
        self._count += 1

    def write(self, first: int, rows: Any) -> None:
        """Write consecutive rows over existing ones and beyond the end.

        Parameters
        ----------
        first : int
            Index of the first row written.
        rows : numpy.ndarray, (n,)
            Of the type `ROW`.
        """
        last = first + len(rows)
        self._ensure_capacity(last)
        self._states -= _counted(self._rows[first : min(last, self._count)])
        self._rows[first:last] = rows
        self._states += _counted(rows)
        self.rewritten += first < self._count
        self._count = max(self._count, last)

    def lose(self, segment: int) -> None:
        """Set the state of all frames of a segment to lost."""
        rows = self.columns
        lose(rows, segment)
        self._states = _counted(rows)
        self.rewritten += 1

    @property
    def columns(self) -> Any:
        """(n,) rows of the type `ROW`, in place: ``columns["row_px"]``."""
        count = self._count  # read before the rows, which another thread may reallocate
        return self._rows[:count]

    @property
    def counts(self) -> dict[str, int]:
        """Number of frames by state."""
        return dict(zip(STATES, self._states.tolist(), strict=True))

    def _ensure_capacity(self, count: int) -> None:
        while count > len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> TrackPoint: ...
    @overload
    def __getitem__(self, index: slice) -> list[TrackPoint]: ...
    def __getitem__(self, index: int | slice) -> TrackPoint | list[TrackPoint]:
        rows = self.columns[index]
        return [_point(values) for values in rows.tolist()] if isinstance(index, slice) else _point(rows.item())


def packed(point: TrackPoint) -> tuple[Any, ...]:
    """Return a point of a track as the values of a row of the type `ROW`."""
    *values, state = point
    return (*values, STATES.index(state))


def lose(rows: Any, segment: int) -> None:
    """Set the rows (type `ROW`) of a segment to lost, positions NaN, in place."""
    gone = rows["segment"] == segment
    for name in _UNKNOWN:
        rows[name][gone] = np.nan
    rows["state"][gone] = LOST


def _counted(rows: Any) -> Any:
    return np.bincount(rows["state"], minlength=len(STATES))


def _point(values: Sequence[Any]) -> TrackPoint:
    *before, state = values
    return TrackPoint(*(*before, STATES[state]))
