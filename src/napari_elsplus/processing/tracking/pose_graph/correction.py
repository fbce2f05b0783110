"""From where the tracker had a frame, while it knew no better, to where it belongs by all links so far."""

from __future__ import annotations

from cmath import rect
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Container, Mapping, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.pose import Pose


class Correction(NamedTuple):
    """From where the tracker has a frame to where it belongs: a rotation and a shift, into another segment.

    Parameters
    ----------
    segment : int
        To which it belongs.
    shift : complex
        Where the tracker's (0, 0) lies there, row + i col, pixels of the tracking grid.
    angle : float
        By which the tracker's segment is turned there, radians.

    Examples
    --------
    >>> from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
    >>> from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
    >>> pose = Pose(3, 10.0, 20.0, Velocity(1.0, 0.0), 0.9, 0.1, TrackingState.TRACKED)
    >>> Correction(0, shift=-1.5).of(pose)[:3]
    (0, 8.5, 20.0)
    """

    segment: int
    shift: complex = 0.0
    angle: float = 0.0

    def of(self, pose: Pose) -> Pose:
        """Return the pose where it belongs."""
        return pose.placed(rect(1, self.angle) * pose.at + self.shift, pose.angle + self.angle, self.segment)

    @classmethod
    def between(cls, pose: Pose, place: Pose) -> Correction:
        """Return what takes a pose to its place."""
        angle = place.angle - pose.angle
        return cls(place.segment, place.at - rect(1, angle) * pose.at, angle)


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
        self._tables = {
            segment: np.array([(frame, one.shift, rect(1, one.angle)) for frame, one in along]).T
            for segment, along in self._known.items()
        }

    def newest(self, segment: int) -> Correction:
        """Return that of frames to come.

        Parameters
        ----------
        segment : int
            As the tracker numbers them.
        """
        return self._known[segment][-1][1] if segment in self._known else Correction(segment)

    def without(self, segments: Container[int]) -> Corrections:
        """Return those of the tracker's other segments."""
        return Corrections({segment: along for segment, along in self._known.items() if segment not in segments})

    def of(self, frame: int, pose: Pose) -> Pose:
        """Return where a frame belongs that the tracker has at a pose."""
        return self.of_poses([frame], [pose])[0]

    def of_poses(self, frames: Sequence[int], poses: Sequence[Pose]) -> list[Pose]:
        """Return where frames belong that the tracker has at some poses, one for each."""
        segment, row, col = np.reshape([(pose.segment, pose.row, pose.col) for pose in poses], (-1, 3)).T
        there = self.of_frames(np.asarray(frames), segment.astype(np.int64), row, col)
        places = zip(poses, *(values.tolist() for values in there), strict=True)
        return [pose.placed(complex(y, x), pose.angle + turned, into) for pose, into, y, x, turned in places]

    def of_frames(
        self, frame: NDArray[np.int64], segment: NDArray[np.int64], row: NDArray[np.float64], col: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return segments, rows and columns at which frames belong, and by how much each is turned; NaN stays NaN.

        Parameters
        ----------
        frame, segment, row, col : numpy.ndarray
            (n,) each: which frames, and where the tracker has them.
        """
        into, at, turned = segment.copy(), row + 1j * col, np.zeros(len(frame))
        for number in self._tables.keys() & set(segment.tolist()):
            those, (known, *values) = np.flatnonzero(segment == number), self._tables[number]
            shift, factor = (np.interp(frame[those], known.real, value) for value in values)
            into[those], turned[those] = self.newest(number).segment, np.angle(factor)
            at[those] = factor * at[those] + shift
        return into, at.real, at.imag, turned
