"""The probe's track as lines and marks over its mosaic, and its speed against the trackable limit."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import hypot, nan
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from napari_elsplus.io.tables.tracks import STATES
from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.processing.tracking.registry import tracking_method

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.io import TrackPoint, TrackTable

MIN_STEP_PX: Final = 2.0
"""Least length of a line, pixels of the mosaic; chosen, below the width of a drawn line."""
MAX_LINES: Final = 2_000
"""Lines drawn; above this, lines are joined, or left out where newer ones pass close by. Chosen, so
that napari updates them within a tick."""
_COARSE_STEP_PX: Final = 16.0
"""Length of joined lines from which on lines are left out instead, pixels of the mosaic; chosen."""
_MIN_SPACING_PX: Final = 16.0
_MAX_SPACING_PX: Final = 128.0
"""Smallest and largest spacing of the cells in which only the newest lines remain, pixels of the mosaic; chosen: up to
half a bundle diameter."""
_THINNED_SHARE: Final = 0.75
"""Share of MAX_LINES that remains after thinning, so that it is not repeated at each row; chosen."""
_STRETCH_LINES: Final = 16
"""Successive lines that are kept or left out together, so that the track is not dashed; chosen."""
_MIN_NEW_SHARE: Final = 0.3
"""Least share of a stretch's cells that no newer line passes, for it to be kept; chosen."""
SPEED_WINDOW_FRAMES: Final = 12
"""Frames over which the speed is averaged: 50 ms at 240 Hz, chosen."""
PREDICTED, LOST, BEGINS = "predicted", "lost", "begins"
ROWS_AT_ONCE: Final = 1 << 12
"""Rows read per call: about 10 ms, chosen, more than arrive between two calls."""
MAX_MARKS: Final = 300
"""Marks drawn; chosen, more could not be distinguished on a screen."""
_MAX_MARK_SPACING_PX: Final = 1 << 14
"""Largest spacing to which marks are thinned, pixels: a quarter of the largest mosaic."""
_TRACKED, _LOST = STATES.index(TrackingState.TRACKED), STATES.index(TrackingState.LOST)


class TrackGeometry(NamedTuple):
    """Lines and marks of a track, in pixels of the sheet on which its mosaics lie.

    Parameters
    ----------
    lines : numpy.ndarray
        (m, 2, 2): start and step (row, col) of each line; none where frames were not tracked.
    score : numpy.ndarray
        (m,) lowest correlation along each line.
    segment : numpy.ndarray
        (m,) int.
    marks : numpy.ndarray
        (k, 2) positions where a frame was predicted, the probe was lost, or a segment begins.
    kinds : numpy.ndarray
        (k,) str: `PREDICTED`, `LOST` or `BEGINS`.
    labels : numpy.ndarray
        (k,) str: the segment's number, from 1, where it begins; else empty.
    """

    lines: NDArray[np.float64]
    score: NDArray[np.float64]
    segment: NDArray[np.int64]
    marks: NDArray[np.float64]
    kinds: NDArray[np.str_]
    labels: NDArray[np.str_]


class _FramePlace(NamedTuple):
    """Index and position of a frame, pixels of the mosaic."""

    number: int
    row: float
    col: float
    segment: int

    def distance_to(self, other: _FramePlace) -> float:
        return hypot(self.row - other.row, self.col - other.col)


class TrackDrawing:
    """Simplifies a growing track to a bounded number of lines and marks.

    The frames to draw are selected once and their positions read at each drawing, so that the cost of a change of all
    poses depends on what is drawn, not on the length of the track.

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
        self._step_px = self._mark_step_px = MIN_STEP_PX
        self._apart_px = _MIN_SPACING_PX
        self._seen = 0
        self._lines: list[tuple[int, int, float]] = []
        self._marks: list[tuple[int, str]] = []
        self._begins: dict[int, int] = {}
        self._vertex: _FramePlace | None = None
        self._last: _FramePlace | None = None
        self._score = nan

    @property
    def segments(self) -> int:
        """Number of segments with a tracked frame."""
        return len(self._begun())

    @property
    def behind(self) -> int:
        """Number of rows still to be read."""
        return len(self.rows) - self._seen

    def add(self) -> bool:
        """Read the next rows, a limited number, and return True if there were any."""
        rows = self.rows.columns
        self._vertex, self._last = (one and self._where(rows, one.number) for one in (self._vertex, self._last))
        fresh = rows[self._seen : self._seen + ROWS_AT_ONCE]
        places = (fresh["row_px"] / self._scale, fresh["col_px"] / self._scale, fresh["segment"])
        for index, row, col, segment, state, score in zip(
            range(self._seen, self._seen + len(fresh)),
            *(column.tolist() for column in (*places, fresh["state"], fresh["score"])),
            strict=True,
        ):
            self._add(_FramePlace(index, row, col, segment), STATES[state], score)
        self._seen += len(fresh)
        if len(self._lines) > MAX_LINES:
            self._thin()
        if len(self._marks) > MAX_MARKS:
            self._thin_marks()
        return len(fresh) > 0

    def geometry(self, place: Callable[[int], tuple[int, int]]) -> TrackGeometry:
        """Return lines and marks at their present positions.

        Parameters
        ----------
        place : callable
            Returns row and column of a segment's (0, 0) on the sheet.
        """
        rows = self.rows.columns
        lines = np.array([*self._lines, *self._unfinished()], np.float64).reshape(-1, 3)
        first, last = (rows[lines[:, end].astype(np.int64)] for end in (0, 1))
        drawn = (first["state"] == _TRACKED) & (last["state"] == _TRACKED) & (first["segment"] == last["segment"])
        starts, ends = (self._on_sheet(end[drawn], place) for end in (first, last))
        begins = [(index, BEGINS) for index in self._begun()[-MAX_MARKS:]]
        marks = sorted(begins + self._marks)
        marked = rows[[index for index, _ in marks]]
        known = marked["state"] != _LOST
        kinds = np.array([kind for _, kind in marks], np.str_)[known]
        numbers = (marked["segment"][known] + 1).astype(np.str_)
        return TrackGeometry(
            np.stack([starts, ends - starts], axis=1),
            lines[drawn, 2],
            first["segment"][drawn],
            self._on_sheet(marked[known], place),
            kinds,
            np.where(kinds == BEGINS, numbers, ""),
        )

    def _add(self, here: _FramePlace, state: str, score: float) -> None:
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
            if here.distance_to(self._vertex) >= self._step_px:
                self._draw_to(here)
        self._last = here

    def _end_line(self) -> None:
        self._lines += self._unfinished()

    def _draw_to(self, here: _FramePlace) -> None:
        assert self._vertex is not None
        self._lines.append((self._vertex.number, here.number, self._score))
        self._vertex, self._score = here, nan

    def _unfinished(self) -> list[tuple[int, int, float]]:
        """Return the line from the last selected frame to the newest, if they differ."""
        one, other = self._vertex, self._last
        if one is None or other is None or one.segment != other.segment or one.distance_to(other) == 0:
            return []
        return [(one.number, other.number, self._score)]

    def _thin(self) -> None:
        """Reduce the number of lines: join them first, then keep the newest where many are close together."""
        if self._step_px >= _COARSE_STEP_PX:
            self._keep_newest()
            while len(self._lines) > _THINNED_SHARE * MAX_LINES and self._apart_px < _MAX_SPACING_PX:
                self._apart_px *= 2
                self._keep_newest()
            if len(self._lines) <= _THINNED_SHARE * MAX_LINES:
                return
        self._join()

    def _keep_newest(self) -> None:
        """Drop stretches of the track along which newer ones mostly pass."""
        rows = self.rows.columns
        first, last = (rows[[line[end] for line in self._lines]] for end in (0, 1))
        middle = [(first[name] + last[name]) / (2 * self._scale) // self._apart_px for name in ("row_px", "col_px")]
        cells = list(zip(first["segment"].tolist(), *(one.tolist() for one in middle), strict=True))
        passed: set[tuple[int, float, float]] = set()
        kept: list[tuple[int, int, float]] = []
        for end in range(len(cells), 0, -_STRETCH_LINES):
            stretch = slice(max(0, end - _STRETCH_LINES), end)
            here = set(cells[stretch])
            if len(here - passed) > _MIN_NEW_SHARE * len(here):
                kept += reversed(self._lines[stretch])
                passed |= here
        self._lines = kept[::-1]

    def _join(self) -> None:
        """Join successive lines in pairs."""
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
        """Keep the newest of marks that are close together, and the newest of too many that are not."""
        marked = self.rows.columns[[index for index, _ in self._marks]]
        where = np.stack([marked["row_px"], marked["col_px"]], axis=1) / self._scale
        segments, marks = marked["segment"].tolist(), self._marks
        while len(self._marks) > MAX_MARKS / 2 and self._mark_step_px < _MAX_MARK_SPACING_PX:
            cells = map(tuple, (where // self._mark_step_px).tolist())
            self._marks = sorted(dict(zip(zip(cells, segments, strict=True), marks, strict=True)).values())
            self._mark_step_px *= 1 if len(self._marks) <= MAX_MARKS / 2 else 2
        del self._marks[:-MAX_MARKS]

    def _begun(self) -> list[int]:
        """Return the first tracked frames of the segments that were neither lost nor joined to earlier ones."""
        indices = np.array(list(self._begins.values()), np.int64)
        rows = self.rows.columns[indices]
        there = rows["state"] == _TRACKED
        _, firsts = np.unique(rows["segment"][there], return_index=True)
        return sorted(indices[there][firsts].tolist())

    def _where(self, rows: Any, index: int) -> _FramePlace:
        row = rows[index]
        return _FramePlace(
            index, float(row["row_px"]) / self._scale, float(row["col_px"]) / self._scale, int(row["segment"])
        )

    def _on_sheet(self, rows: Any, place: Callable[[int], tuple[int, int]]) -> NDArray[np.float64]:
        return _on_sheet(rows, place, self._scale)


@dataclass(frozen=True)
class Speed:
    """Speed of the probe and its trackable limit.

    Attributes
    ----------
    px_per_frame : float
        Mean displacement of the latest frames, camera pixels per frame; NaN if none was tracked.
    max_px_per_frame : float
        Largest trackable displacement.
    um_per_s : float
        Speed; NaN where scale or times are unknown.
    max_um_per_s : float
        Largest trackable speed.
    tracked : float
        Fraction of the latest frames that were tracked, 0 to 1; NaN before the first frame.
    """

    px_per_frame: float = nan
    max_px_per_frame: float = nan
    um_per_s: float = nan
    max_um_per_s: float = nan
    tracked: float = nan

    @property
    def share(self) -> float:
        """Speed as a fraction of the limit; NaN if unknown."""
        return self.px_per_frame / self.max_px_per_frame


def max_trackable_px_per_frame(diameter: float, camera_px_per_pixel: float, method: str) -> float:
    """Return the largest displacement between successive frames that a method tracks, camera pixels.

    Parameters
    ----------
    diameter : float
        Bundle diameter, pixels of the mosaic.
    camera_px_per_pixel : float
        Camera pixels per pixel of the mosaic.
    method : str
        Name of the tracking method.

    Examples
    --------
    >>> round(max_trackable_px_per_frame(232.0, 2.0, "elsplus"), 1)
    278.4
    """
    return tracking_method(method).max_displacement(diameter) * camera_px_per_pixel


def probe_speed(rows: Sequence[TrackPoint], max_px_per_frame: float, um_per_px: float | None = None) -> Speed:
    """Return the probe's mean speed over the latest frames.

    Parameters
    ----------
    rows : sequence of TrackPoint
        The track; its last frames are used.
    max_px_per_frame : float
        Largest trackable displacement, camera pixels.
    um_per_px : float, optional
        Scale of a camera pixel.
    """
    last = rows[-SPEED_WINDOW_FRAMES:]
    if not last:
        return Speed(max_px_per_frame=max_px_per_frame)
    tracked = [row for row in last if row.state == TrackingState.TRACKED and row.segment == last[-1].segment]
    share = sum(row.state == TrackingState.TRACKED for row in last) / len(last)
    if len(tracked) < 2:
        return Speed(max_px_per_frame=max_px_per_frame, tracked=share)
    first, final = tracked[0], tracked[-1]
    way = sum(hypot(b.row_px - a.row_px, b.col_px - a.col_px) for a, b in pairwise(tracked))
    frames, seconds = final.frame - first.frame, final.time_s - first.time_s
    per_frame = way / frames if frames else nan
    rate = (um_per_px or nan) * frames / seconds if seconds > 0 else nan
    return Speed(per_frame, max_px_per_frame, per_frame * rate, max_px_per_frame * rate, share)


def placed(
    rows: Any, place: Callable[[int], tuple[int, int]], camera_px_per_pixel: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return positions on the sheet and scores of the tracked rows of a table.

    Parameters
    ----------
    rows : numpy.ndarray
        Structured array of a `TrackTable`.
    place : callable
        Returns row and column of a segment's (0, 0) on the sheet.
    camera_px_per_pixel : float
        Camera pixels per pixel of the mosaic.

    Returns
    -------
    tuple of numpy.ndarray
        Positions (m, 2) and scores (m,).
    """
    tracked = rows[rows["state"] == _TRACKED]
    return _on_sheet(tracked, place, camera_px_per_pixel), tracked["score"]


def _on_sheet(rows: Any, place: Callable[[int], tuple[int, int]], camera_px_per_pixel: float) -> NDArray[np.float64]:
    numbers, which = np.unique(rows["segment"], return_inverse=True)
    origins = np.array([place(number) for number in numbers.tolist()], np.float64).reshape(-1, 2)
    return np.stack([rows["row_px"], rows["col_px"]], axis=1) / camera_px_per_pixel + origins[which]
