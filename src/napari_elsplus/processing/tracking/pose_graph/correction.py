"""From where the tracker had a frame, while it knew no better, to where it belongs by all links so far."""

from __future__ import annotations

from math import atan2
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from napari_elsplus.processing.tracking.registration.motion_models import turned_by

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.pose import Pose


class Correction(NamedTuple):
    """From where the tracker has a frame to where it belongs.

    Parameters
    ----------
    segment : int
        To which it belongs.
    row, col : float
        Where the tracker's (0, 0) lies there, pixels of the tracking grid.
    angle : float
        By which the tracker's segment is turned there, radians.

    Examples
    --------
    >>> from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
    >>> from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
    >>> pose = Pose(3, 10.0, 20.0, Velocity(1.0, 0.0), 0.9, 0.1, TrackingState.TRACKED)
    >>> Correction(0, row=-1.5).of(pose)[:3]
    (0, 8.5, 20.0)
    """

    segment: int
    row: float = 0.0
    col: float = 0.0
    angle: float = 0.0

    def of(self, pose: Pose) -> Pose:
        """Return the pose where it belongs."""
        row, col = pose.row, pose.col
        if self.angle != 0:
            row, col = (turned_by(self.angle) @ (row, col)).tolist()
        return pose._replace(
            segment=self.segment, row=row + self.row, col=col + self.col,
            angle=pose.angle + self.angle,
        )  # fmt: skip

    @classmethod
    def between(cls, pose: Pose, place: Pose) -> Correction:
        """Return what takes a pose to its place."""
        angle = place.angle - pose.angle
        row, col = turned_by(angle) @ (pose.row, pose.col)
        return cls(place.segment, place.row - float(row), place.col - float(col), angle)


class Corrections:
    """Corrections along the track: known at some frames; others lie between where the two around them put them.

    Parameters
    ----------
    known : mapping of int to sequence
        For each of the tracker's segments the frames at which its correction is known, in their order, and what it is
        there. Segments that are not among them stay as they are.

    Examples
    --------
    >>> from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
    >>> from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
    >>> drifted = Corrections({2: [(10, Correction(0, 5.0)), (20, Correction(0, 7.0))]})
    >>> pose = Pose(2, 100.0, 0.0, Velocity(1.0, 0.0), 0.9, 0.1, TrackingState.TRACKED)
    >>> [drifted.of(frame, pose).row for frame in (0, 15, 30)]
    [105.0, 106.0, 107.0]
    """

    def __init__(self, known: Mapping[int, Sequence[tuple[int, Correction]]] | None = None) -> None:
        self._known = dict(known or {})
        self._newest = {segment: along[-1][1] for segment, along in self._known.items()}
        self._frames = {segment: np.array([frame for frame, _ in along]) for segment, along in self._known.items()}
        self._values = {
            segment: np.array([(one.row, one.col, *turned_by(one.angle)[:, 0]) for _, one in along])
            for segment, along in self._known.items()
        }

    def newest(self, segment: int) -> Correction:
        """Return that of frames to come.

        Parameters
        ----------
        segment : int
            As the tracker numbers them.
        """
        return self._newest.get(segment) or Correction(segment)

    def without(self, segments: Container[int]) -> Corrections:
        """Return those of the tracker's other segments."""
        return Corrections({segment: along for segment, along in self._known.items() if segment not in segments})

    def of(self, frame: int, pose: Pose) -> Pose:
        """Return where a frame belongs that the tracker has at a pose."""
        segment = pose.segment
        if segment not in self._frames:
            return pose
        row, col, cosine, sine = self._between(segment, np.array([frame]))[:, 0].tolist()
        into = self._newest[segment].segment
        return Correction(into, row, col, atan2(sine, cosine)).of(pose)

    def of_frames(
        self,
        frame: NDArray[np.int64],
        segment: NDArray[np.int64],
        row: NDArray[np.float64],
        col: NDArray[np.float64],
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return segments, rows and columns at which frames belong, and by how much each is turned; NaN stays NaN.

        Parameters
        ----------
        frame, segment, row, col : numpy.ndarray
            (n,) each: which frames, and where the tracker has them.
        """
        into, down, across, turned = segment.copy(), row.copy(), col.copy(), np.zeros(len(frame))
        for number in np.unique(segment).tolist():
            if number not in self._frames:
                continue
            those = np.flatnonzero(segment == number)
            top, left, cosine, sine = self._between(number, frame[those])
            into[those], turned[those] = self._newest[number].segment, np.arctan2(sine, cosine)
            down[those] = cosine * row[those] - sine * col[those] + top
            across[those] = sine * row[those] + cosine * col[those] + left
        return into, down, across, turned

    def _between(self, segment: int, frames: NDArray[np.int64]) -> NDArray[np.float64]:
        known, values = self._frames[segment], self._values[segment]
        return np.stack([np.interp(frames, known, column) for column in values.T])


class Path:
    """Poses of every frame as tracked; lost ones are nan.

    Attributes
    ----------
    segments : list of int
        Those that there are, in their order.

    Examples
    --------
    >>> path = Path()
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
