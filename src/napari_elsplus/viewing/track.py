"""The probe's track as lines and marks over its mosaic, and how fast the probe may go."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from math import hypot, nan
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.tracking.paper import SIDE_PX, TEMPLATE_PX
from napari_elsplus.processing.tracking.pose import State
from napari_elsplus.processing.tracking.tracker import FARTHEST
from napari_elsplus.tracking_pipeline import Method

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.io import TrackPoint

LEAST_STEP_PX: Final = 2.0
"""Frames that are closer than this to the last one drawn, in pixels of the mosaic, are not drawn."""
MOST_LINES: Final = 2_000
"""With more lines than this, every second is left out."""
LATELY_FRAMES: Final = 12
"""Frames over which the present speed is taken."""
PREDICTED, LOST, BEGINS = "predicted", "lost", "begins"
_TRACKED, _PREDICTED, _LOST = (state.value for state in State)


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


class TrackDrawing:
    """Draws a track that grows; only frames that are new are looked at.

    Parameters
    ----------
    camera_px_per_pixel : float
        Camera pixels per pixel of the mosaic.

    Attributes
    ----------
    counts : collections.Counter
        Frames by their state.
    segments : int
        Segments with a tracked frame.
    """

    def __init__(self, camera_px_per_pixel: float) -> None:
        self._scale = camera_px_per_pixel
        self._step_px = LEAST_STEP_PX
        self.counts: Counter[str] = Counter()
        self._seen = 0
        self._lines: list[tuple[float, float, float, float, float, int]] = []
        self._marks: list[tuple[float, float, int, str]] = []
        self._vertex: tuple[float, float, int] | None = None
        self._last: tuple[float, float, int] | None = None
        self._score = nan
        self._begun: set[int] = set()

    @property
    def segments(self) -> int:
        """Segments with a tracked frame."""
        return len(self._begun)

    def add(self, rows: Sequence[TrackPoint]) -> bool:
        """Take in the rows that came since the last time; whether there were any."""
        fresh = rows[self._seen :]
        for row in fresh:
            self._add(row)
        self._seen += len(fresh)
        if len(self._lines) > MOST_LINES:
            self._thin()
        return bool(fresh)

    def drawing(self, place: Callable[[int], tuple[int, int]]) -> Drawing:
        """Draw all of it.

        Parameters
        ----------
        place : callable
            Row and column of the sheet where a segment's (0, 0) lies.
        """
        lines = np.array(self._lines, np.float64).reshape(-1, 6)
        segment = lines[:, 5].astype(np.int64)
        marks = np.array([mark[:3] for mark in self._marks], np.float64).reshape(-1, 3)
        places = {number: place(number) for number in {*segment.tolist(), *marks[:, 2].astype(int).tolist()}}
        starts = lines[:, :2] + _look_up(places, segment)
        return Drawing(
            np.stack([starts, lines[:, 2:4]], axis=1),
            lines[:, 4],
            segment,
            marks[:, :2] + _look_up(places, marks[:, 2].astype(np.int64)),
            np.array([mark[3] for mark in self._marks], np.str_),
            np.array([str(mark[2] + 1) if mark[3] == BEGINS else "" for mark in self._marks], np.str_),
        )

    def _add(self, row: TrackPoint) -> None:
        self.counts[row.state] += 1
        if row.state == _LOST:
            if self._last is not None:
                self._end_line()
                self._marks.append((*self._last, LOST))
            self._vertex = self._last = None
            return
        here = (row.row_px / self._scale, row.col_px / self._scale, row.segment)
        if row.state == _PREDICTED:
            self._end_line()
            self._marks.append((*here, PREDICTED))
            self._vertex = None
            return
        if row.segment not in self._begun:
            self._begun.add(row.segment)
            self._marks.append((*here, BEGINS))
        if self._vertex is None or self._vertex[2] != row.segment:
            self._vertex, self._score = here, nan
        else:
            self._score = float(np.fmin(self._score, row.score))
            if hypot(here[0] - self._vertex[0], here[1] - self._vertex[1]) >= self._step_px:
                self._draw_to(here)
        self._last = here

    def _end_line(self) -> None:
        if self._vertex is not None and self._last is not None and self._last[2] == self._vertex[2]:
            self._draw_to(self._last)

    def _draw_to(self, here: tuple[float, float, int]) -> None:
        assert self._vertex is not None
        row, col, segment = self._vertex
        if here[:2] != (row, col):
            self._lines.append((row, col, here[0] - row, here[1] - col, self._score, segment))
        self._vertex, self._score = here, nan

    def _thin(self) -> None:
        """Join lines two by two where they follow one another."""
        self._step_px *= 2
        kept: list[tuple[float, float, float, float, float, int]] = []
        joined = False
        for line in self._lines:
            row, col, down, across, score, segment = line
            before = kept[-1] if kept else None
            follows = before is not None and before[5] == segment
            follows = follows and abs(before[0] + before[2] - row) + abs(before[1] + before[3] - col) < 1e-6  # type: ignore[index]
            if follows and not joined and before is not None:
                lowest = float(np.fmin(before[4], score))
                kept[-1] = (before[0], before[1], before[2] + down, before[3] + across, lowest, segment)
                joined = True
            else:
                kept.append(line)
                joined = False
        self._lines = kept


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


def fastest_px_per_frame(diameter: float, camera_px_per_pixel: float, method: Method | str) -> float:
    """Displacement from one frame to the next that a method can still follow, camera pixels.

    Ours looks as far as 0.6 bundle diameters; the paper's template of 128 pixels must lie within the next image of 250.

    Parameters
    ----------
    diameter : float
        Of the bundle, pixels of the mosaic.
    camera_px_per_pixel : float
        Camera pixels per pixel of the mosaic.
    method : Method or str
        How the probe is tracked.

    Examples
    --------
    >>> round(fastest_px_per_frame(232.0, 2.0, "elsplus"), 1)
    278.4
    """
    if Method(method) is Method.PAPER:
        return (SIDE_PX - TEMPLATE_PX) / 2 * camera_px_per_pixel
    return FARTHEST * diameter * camera_px_per_pixel


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
    tracked = [row for row in last if row.state == _TRACKED and row.segment == last[-1].segment]
    share = sum(row.state == _TRACKED for row in last) / len(last)
    if len(tracked) < 2:
        return Speed(fastest_px=fastest_px, tracked=share)
    first, final = tracked[0], tracked[-1]
    way = sum(hypot(b.row_px - a.row_px, b.col_px - a.col_px) for a, b in pairwise(tracked))
    frames, seconds = final.frame - first.frame, final.time_s - first.time_s
    per_frame = way / frames if frames else nan
    rate = (um_per_px or nan) * frames / seconds if seconds > 0 else nan
    return Speed(per_frame, fastest_px, per_frame * rate, fastest_px * rate, share)


def placed(
    rows: Sequence[TrackPoint], place: Callable[[int], tuple[int, int]], camera_px_per_pixel: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where the tracked frames lie on the sheet, (m, 2) pixels of the mosaic, and their scores, (m,)."""
    tracked = [row for row in rows if row.state == _TRACKED]
    segment = np.array([row.segment for row in tracked], np.int64)
    places = {number: place(number) for number in set(segment.tolist())}
    where = np.array([(row.row_px, row.col_px) for row in tracked], np.float64).reshape(-1, 2) / camera_px_per_pixel
    return where + _look_up(places, segment), np.array([row.score for row in tracked], np.float64)


def _look_up(places: dict[int, tuple[int, int]], numbers: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.array([places[number] for number in numbers.tolist()], np.float64).reshape(-1, 2)
