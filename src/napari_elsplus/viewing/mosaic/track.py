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

MIN_APART_PX: Final = 2.0
"""Side of the squares of which each keeps its newest frame, pixels of the mosaic; chosen, below the width of a line."""
MAX_LINES: Final = 2_000
"""Frames between which lines are drawn; above this, the squares are made larger. Chosen, so that napari updates the
lines within a tick."""
_MAX_APART_PX: Final = 1 << 14
"""Largest side of a square, pixels: a quarter of the largest mosaic."""
_JOINED: Final = 3.0
"""Way between frames that a line connects although others between them were left out, sides of a square; chosen: more
than the diagonal of two."""
SPEED_WINDOW_FRAMES: Final = 12
"""Frames over which the speed is averaged: 50 ms at 240 Hz, chosen."""
PREDICTED, LOST, BEGINS = "predicted", "lost", "begins"
ROWS_AT_ONCE: Final = 1 << 12
"""Rows read per call: about 10 ms, chosen, more than arrive between two calls."""
MAX_MARKS: Final = 300
"""Marks drawn; chosen, more could not be distinguished on a screen."""
_TRACKED, _PREDICTED, _LOST = map(STATES.index, (TrackingState.TRACKED, TrackingState.PREDICTED, TrackingState.LOST))


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


class _Apart:
    """Frames of a track of which each square of the mosaic keeps the newest, so that they are few."""

    def __init__(self, most: int) -> None:
        self.frames: NDArray[np.int64] = np.empty(0, np.int64)
        self.apart_px = MIN_APART_PX
        self._most = most

    def add(self, frames: NDArray[np.int64], rows: Any, camera_px_per_pixel: float) -> None:
        """Add later frames; `rows` are those of the table."""
        self.frames = np.append(self.frames, frames)
        self._thin(rows, camera_px_per_pixel)
        while len(self.frames) > self._most and self.apart_px < _MAX_APART_PX:
            self.apart_px *= 2
            self._thin(rows, camera_px_per_pixel)
        self.frames = self.frames[-self._most :]

    def _thin(self, rows: Any, camera_px_per_pixel: float) -> None:
        chosen = rows[self.frames[::-1]]
        squares = [chosen[name] // (self.apart_px * camera_px_per_pixel) for name in ("row_px", "col_px")]
        _, newest = np.unique(np.stack([chosen["segment"], *squares]), axis=1, return_index=True)
        self.frames = np.sort(self.frames[::-1][newest])


class TrackDrawing:
    """Simplifies a growing track to a bounded number of lines and marks.

    The frames to draw are selected once and their positions read at each drawing.

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
        self._seen = 0
        self._state = _LOST
        self._tracked = _Apart(MAX_LINES)
        self._marks = {PREDICTED: _Apart(MAX_MARKS // 2), LOST: _Apart(MAX_MARKS // 2)}
        self._begins: dict[int, int] = {}

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
        fresh = rows[self._seen : self._seen + ROWS_AT_ONCE]
        if not len(fresh):
            return False
        states = np.append(self._state, fresh["state"])
        before, state = states[:-1], states[1:]
        frames = np.arange(self._seen, self._seen + len(fresh))
        self._seen, self._state = self._seen + len(fresh), state[-1]
        tracked = frames[state == _TRACKED]
        for segment, frame in zip(rows["segment"][tracked].tolist(), tracked.tolist(), strict=True):
            self._begins.setdefault(segment, frame)
        self._tracked.add(tracked, rows, self._scale)
        self._marks[PREDICTED].add(frames[state == _PREDICTED], rows, self._scale)
        self._marks[LOST].add(frames[(state == _LOST) & (before != _LOST)] - 1, rows, self._scale)
        return True

    def geometry(self, place: Callable[[int], tuple[int, int]]) -> TrackGeometry:
        """Return lines and marks at their present positions.

        Parameters
        ----------
        place : callable
            Returns row and column of a segment's (0, 0) on the sheet.
        """
        rows = self.rows.columns
        starts, steps, score, segment = self._lines(place)
        begins = [(frame, BEGINS) for frame in self._begun()[-MAX_MARKS:]]
        marks = sorted(begins + [(frame, kind) for kind, one in self._marks.items() for frame in one.frames.tolist()])
        marked = rows[[frame for frame, _ in marks]]
        known = marked["state"] != _LOST
        kinds = np.array([kind for _, kind in marks], np.str_)[known]
        numbers = (marked["segment"][known] + 1).astype(np.str_)
        return TrackGeometry(
            np.stack([starts, steps], axis=1),
            score,
            segment,
            _on_sheet(marked[known], place, self._scale),
            kinds,
            np.where(kinds == BEGINS, numbers, ""),
        )

    def _lines(self, place: Callable[[int], tuple[int, int]]) -> tuple[NDArray[Any], ...]:
        """Return start, step, lowest score and segment of the lines between successive frames that are drawn."""
        frames = self._tracked.frames
        rows = self.rows.columns[: frames[-1] + 1 if len(frames) else 0]
        first, last, after = rows[frames[:-1]], rows[frames[1:]], frames[:-1] + 1
        steps_px = np.hypot(*(np.diff(rows[name], prepend=0) for name in ("row_px", "col_px"))) / self._scale
        near = np.add.reduceat(steps_px, after) < _JOINED * self._tracked.apart_px
        drawn = (first["segment"] == last["segment"]) & (first["state"] == _TRACKED) & (near | (frames[1:] == after))
        drawn &= np.logical_and.reduceat(rows["state"] == _TRACKED, after)
        starts, ends = (_on_sheet(end[drawn], place, self._scale) for end in (first, last))
        return starts, ends - starts, np.fmin.reduceat(rows["score"], after)[drawn], first["segment"][drawn]

    def _begun(self) -> list[int]:
        """Return the first tracked frames of the segments that were neither lost nor joined to earlier ones."""
        indices = np.array(list(self._begins.values()), np.int64)
        rows = self.rows.columns[indices]
        there = rows["state"] == _TRACKED
        _, firsts = np.unique(rows["segment"][there], return_index=True)
        return sorted(indices[there][firsts].tolist())


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
