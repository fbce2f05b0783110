"""The probe's track as lines and marks over its mosaic, and how fast the probe may go."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import hypot, nan
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from napari_elsplus.io.tracks import STATES
from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.processing.tracking.registry import tracking_method

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.io import TrackPoint, TrackTable

LEAST_STEP_PX: Final = 2.0
"""Frames that are closer than this to the last one drawn, in pixels of the mosaic, are not drawn."""
MOST_LINES: Final = 2_000
"""With more lines than this, some are joined, or left out where newer ones pass close by."""
_COARSE_STEP_PX: Final = 16.0
_LEAST_APART_PX: Final = 16.0
_FARTHEST_APART_PX: Final = 128.0
"""How close lines lie to one another in the end: at most half a bundle diameter apart."""
_ENOUGH: Final = 0.75
"""Part of the lines that may be left when there were too many."""
_STRETCH_LINES: Final = 16
_MOSTLY_NEW: Final = 0.3
"""Part of a stretch that nothing newer passes, from which on it is drawn."""
LATELY_FRAMES: Final = 12
"""Frames over which the present speed is taken."""
PREDICTED, LOST, BEGINS = "predicted", "lost", "begins"
ROWS_AT_ONCE: Final = 1 << 12
"""Rows that are taken in at a time: some ten milliseconds' worth, and more than come between two looks."""
MOST_MARKS: Final = 300
_FARTHEST_MARKS_PX: Final = 1 << 14
_TRACKED, _LOST = STATES.index(TrackingState.TRACKED), STATES.index(TrackingState.LOST)


class Drawing(NamedTuple):
    """A track in pixels of the sheet that its mosaics lie on.

    Parameters
    ----------
    lines : numpy.ndarray
        (m, 2, 2): start and step (row, col) of each line; where frames were not tracked there is none.
    score : numpy.ndarray
        (m,) the lowest correlation along each line.
    segment : numpy.ndarray
        (m,) int.
    marks : numpy.ndarray
        (k, 2) places at which a frame was predicted, the probe was lost, or a segment begins.
    kinds : numpy.ndarray
        (k,) str: which of the three.
    labels : numpy.ndarray
        (k,) str: the segment's number, from 1, where it begins; else empty.
    """

    lines: NDArray[np.float64]
    score: NDArray[np.float64]
    segment: NDArray[np.int64]
    marks: NDArray[np.float64]
    kinds: NDArray[np.str_]
    labels: NDArray[np.str_]


class _Here(NamedTuple):
    """A frame, and where it lies: pixels of the mosaic."""

    number: int
    row: float
    col: float
    segment: int

    def away_from(self, other: _Here) -> float:
        return hypot(self.row - other.row, self.col - other.col)


class TrackDrawing:
    """Draws a track that grows: which frames are drawn is chosen once, where they lie is looked up each time.

    A track whose frames are put elsewhere, all of them again and again, then costs no more than what is drawn of it.

    Parameters
    ----------
    rows : TrackTable
        The track.
    camera_px_per_pixel : float
        Camera pixels per pixel of the mosaic.
    """

    def __init__(self, rows: TrackTable, camera_px_per_pixel: float) -> None:
        self.rows = rows
        self._scale = camera_px_per_pixel
        self._step_px = self._mark_step_px = LEAST_STEP_PX
        self._apart_px = _LEAST_APART_PX
        self._seen = 0
        self._lines: list[tuple[int, int, float]] = []
        self._marks: list[tuple[int, str]] = []
        self._begins: dict[int, int] = {}
        self._vertex: _Here | None = None
        self._last: _Here | None = None
        self._score = nan

    @property
    def segments(self) -> int:
        """Segments with a tracked frame."""
        return len(self._begun())

    @property
    def behind(self) -> int:
        """Rows that are still to be taken in."""
        return len(self.rows) - self._seen

    def add(self) -> bool:
        """Take in rows that came since the last time, not too many at once; whether there were any."""
        rows = self.rows.columns
        self._vertex, self._last = (one and self._where(rows, one.number) for one in (self._vertex, self._last))
        fresh = rows[self._seen : self._seen + ROWS_AT_ONCE]
        places = (fresh["row_px"] / self._scale, fresh["col_px"] / self._scale, fresh["segment"])
        for index, row, col, segment, state, score in zip(
            range(self._seen, self._seen + len(fresh)),
            *(column.tolist() for column in (*places, fresh["state"], fresh["score"])),
            strict=True,
        ):
            self._add(_Here(index, row, col, segment), STATES[state], score)
        self._seen += len(fresh)
        if len(self._lines) > MOST_LINES:
            self._thin()
        if len(self._marks) > MOST_MARKS:
            self._thin_marks()
        return len(fresh) > 0

    def drawing(self, place: Callable[[int], tuple[int, int]]) -> Drawing:
        """Draw all of it.

        Parameters
        ----------
        place : callable
            Row and column of the sheet where a segment's (0, 0) lies.
        """
        rows = self.rows.columns
        lines = np.array([*self._lines, *self._unfinished()], np.float64).reshape(-1, 3)
        first, last = (rows[lines[:, end].astype(np.int64)] for end in (0, 1))
        drawn = (first["state"] == _TRACKED) & (last["state"] == _TRACKED) & (first["segment"] == last["segment"])
        starts, ends = (self._on_sheet(end[drawn], place) for end in (first, last))
        begins = [(index, BEGINS) for index in self._begun()[-MOST_MARKS:]]
        marks = sorted(begins + self._marks)
        marked = rows[[index for index, _ in marks]]
        known = marked["state"] != _LOST
        kinds = np.array([kind for _, kind in marks], np.str_)[known]
        numbers = (marked["segment"][known] + 1).astype(np.str_)
        return Drawing(
            np.stack([starts, ends - starts], axis=1),
            lines[drawn, 2],
            first["segment"][drawn],
            self._on_sheet(marked[known], place),
            kinds,
            np.where(kinds == BEGINS, numbers, ""),
        )

    def _add(self, here: _Here, state: str, score: float) -> None:
        if state == TrackingState.LOST:
            if self._last is not None:
                self._end_line()
                self._marks.append((self._last.number, LOST))
            self._vertex = self._last = None
            return
        if state == TrackingState.PREDICTED:
            self._end_line()
            self._marks.append((here.number, PREDICTED))
            self._vertex = None
            return
        self._begins.setdefault(here.segment, here.number)
        if self._vertex is None or self._vertex.segment != here.segment:
            self._vertex, self._score = here, nan
        else:
            self._score = float(np.fmin(self._score, score))
            if here.away_from(self._vertex) >= self._step_px:
                self._draw_to(here)
        self._last = here

    def _end_line(self) -> None:
        self._lines += self._unfinished()

    def _draw_to(self, here: _Here) -> None:
        assert self._vertex is not None
        self._lines.append((self._vertex.number, here.number, self._score))
        self._vertex, self._score = here, nan

    def _unfinished(self) -> list[tuple[int, int, float]]:
        """Return the line from the last frame that was drawn to the newest, if there is any between them."""
        one, other = self._vertex, self._last
        if one is None or other is None or one.segment != other.segment or one.away_from(other) == 0:
            return []
        return [(one.number, other.number, self._score)]

    def _thin(self) -> None:
        """Draw fewer lines: coarser ones first, then only the newest where many lie close to one another."""
        if self._step_px >= _COARSE_STEP_PX:
            self._leave_the_newest()
            while len(self._lines) > _ENOUGH * MOST_LINES and self._apart_px < _FARTHEST_APART_PX:
                self._apart_px *= 2
                self._leave_the_newest()
            if len(self._lines) <= _ENOUGH * MOST_LINES:
                return
        self._join()

    def _leave_the_newest(self) -> None:
        """Let go of stretches of the track that newer ones mostly pass over, or close by."""
        rows = self.rows.columns
        first, last = (rows[[line[end] for line in self._lines]] for end in (0, 1))
        middle = [(first[name] + last[name]) / (2 * self._scale) // self._apart_px for name in ("row_px", "col_px")]
        cells = list(zip(first["segment"].tolist(), *(one.tolist() for one in middle), strict=True))
        passed: set[tuple[int, float, float]] = set()
        kept: list[tuple[int, int, float]] = []
        for end in range(len(cells), 0, -_STRETCH_LINES):
            stretch = slice(max(0, end - _STRETCH_LINES), end)
            here = set(cells[stretch])
            if len(here - passed) > _MOSTLY_NEW * len(here):
                kept += reversed(self._lines[stretch])
                passed |= here
        self._lines = kept[::-1]

    def _join(self) -> None:
        """Join lines two by two where they follow one another."""
        self._step_px *= 2
        kept: list[tuple[int, int, float]] = []
        joined = True
        for first, last, score in self._lines:
            if not joined and kept[-1][1] == first:
                kept[-1] = (kept[-1][0], last, float(np.fmin(kept[-1][2], score)))
                joined = True
            else:
                kept.append((first, last, score))
                joined = False
        self._lines = kept

    def _thin_marks(self) -> None:
        """Leave of marks that lie close to one another the newest; and the newest of too many that lie apart."""
        marked = self.rows.columns[[index for index, _ in self._marks]]
        where = np.stack([marked["row_px"], marked["col_px"]], axis=1) / self._scale
        segments, marks = marked["segment"].tolist(), self._marks
        while len(self._marks) > MOST_MARKS / 2 and self._mark_step_px < _FARTHEST_MARKS_PX:
            cells = map(tuple, (where // self._mark_step_px).tolist())
            self._marks = sorted(dict(zip(zip(cells, segments, strict=True), marks, strict=True)).values())
            self._mark_step_px *= 1 if len(self._marks) <= MOST_MARKS / 2 else 2
        del self._marks[:-MOST_MARKS]

    def _begun(self) -> list[int]:
        """First tracked frames of the segments, as far as they are not lost, or found to belong to earlier ones."""
        indices = np.array(list(self._begins.values()), np.int64)
        rows = self.rows.columns[indices]
        there = rows["state"] == _TRACKED
        _, firsts = np.unique(rows["segment"][there], return_index=True)
        return sorted(indices[there][firsts].tolist())

    def _where(self, rows: Any, index: int) -> _Here:
        row = rows[index]
        return _Here(index, float(row["row_px"]) / self._scale, float(row["col_px"]) / self._scale, int(row["segment"]))

    def _on_sheet(self, rows: Any, place: Callable[[int], tuple[int, int]]) -> NDArray[np.float64]:
        return _on_sheet(rows, place, self._scale)


@dataclass(frozen=True)
class Speed:
    """How fast the probe goes, and how fast it may.

    Attributes
    ----------
    px_per_frame : float
        Camera pixels from one frame to the next, lately; NaN if nothing was tracked lately.
    fastest_px : float
        What can be followed.
    um_per_s : float
        The same speed; NaN where scale or times are unknown.
    fastest_um_per_s : float
        The same limit.
    tracked : float
        Part of the latest frames that were tracked, 0 to 1.
    """

    px_per_frame: float = nan
    fastest_px: float = nan
    um_per_s: float = nan
    fastest_um_per_s: float = nan
    tracked: float = 0.0

    @property
    def share(self) -> float:
        """Speed as a part of the fastest; NaN if unknown."""
        return self.px_per_frame / self.fastest_px


def fastest_px_per_frame(diameter: float, camera_px_per_pixel: float, method: str) -> float:
    """Return the largest displacement between successive frames that a method tracks, camera pixels.

    Parameters
    ----------
    diameter : float
        Of the bundle, pixels of the mosaic.
    camera_px_per_pixel : float
        Camera pixels per pixel of the mosaic.
    method : str
        Name of the tracking method.

    Examples
    --------
    >>> round(fastest_px_per_frame(232.0, 2.0, "elsplus"), 1)
    278.4
    """
    return tracking_method(method).max_displacement(diameter) * camera_px_per_pixel


def speed_of(rows: Sequence[TrackPoint], fastest_px: float, um_per_px: float | None = None) -> Speed:
    """Say how fast the probe has gone lately.

    Parameters
    ----------
    rows : sequence of TrackPoint
        The track; its end counts.
    fastest_px : float
        What can be followed, camera pixels per frame.
    um_per_px : float, optional
        Scale of a camera pixel.
    """
    last = rows[-LATELY_FRAMES:]
    if not last:
        return Speed(fastest_px=fastest_px)
    tracked = [row for row in last if row.state == TrackingState.TRACKED and row.segment == last[-1].segment]
    share = sum(row.state == TrackingState.TRACKED for row in last) / len(last)
    if len(tracked) < 2:
        return Speed(fastest_px=fastest_px, tracked=share)
    first, final = tracked[0], tracked[-1]
    way = sum(hypot(b.row_px - a.row_px, b.col_px - a.col_px) for a, b in pairwise(tracked))
    frames, seconds = final.frame - first.frame, final.time_s - first.time_s
    per_frame = way / frames if frames else nan
    rate = (um_per_px or nan) * frames / seconds if seconds > 0 else nan
    return Speed(per_frame, fastest_px, per_frame * rate, fastest_px * rate, share)


def placed(
    rows: Any, place: Callable[[int], tuple[int, int]], camera_px_per_pixel: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return of a table's rows that were tracked where they lie on the sheet, (m, 2), and their scores, (m,)."""
    tracked = rows[rows["state"] == _TRACKED]
    return _on_sheet(tracked, place, camera_px_per_pixel), tracked["score"]


def _on_sheet(rows: Any, place: Callable[[int], tuple[int, int]], camera_px_per_pixel: float) -> NDArray[np.float64]:
    numbers, which = np.unique(rows["segment"], return_inverse=True)
    origins = np.array([place(number) for number in numbers.tolist()], np.float64).reshape(-1, 2)
    return np.stack([rows["row_px"], rows["col_px"]], axis=1) / camera_px_per_pixel + origins[which]
