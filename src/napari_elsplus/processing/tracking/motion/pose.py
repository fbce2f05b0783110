"""Pose of a frame, and its state."""

from __future__ import annotations

from enum import StrEnum
from math import nan
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray


class TrackingState(StrEnum):
    """State of a frame's pose."""

    TRACKED = "tracked"
    """Registered to another frame."""
    PREDICTED = "predicted"
    """Not registered; the pose is extrapolated from the motion before."""
    LOST = "lost"
    """Unknown."""


class Pose(NamedTuple):
    """Pose of the probe while one frame was read; pixels of the tracking grid.

    Parameters
    ----------
    segment : int
        Positions are comparable within a segment.
    row, col : float
        Position when the bundle's middle row is read, relative to the segment's first frame; nan if lost.
    velocity : Velocity
        Pixels per frame period.
    score : float
        Correlation of the overlap with the frame that this one was linked to.
    sigma : float
        Larger axis of the position's uncertainty, one standard deviation: while frames come relative to the frame that
        this one was linked to, in a finished track to the one of its segment that was tracked before.
    state : TrackingState
        Tracked, predicted or lost.
    angle : float
        Of the probe against the segment's first frame, radians, from rows towards columns.
    """

    segment: int
    row: float
    col: float
    velocity: Velocity
    score: float
    sigma: float
    state: TrackingState
    angle: float = 0.0

    @property
    def at(self) -> complex:
        """Position as a complex number, row + i col: a factor exp(i angle) turns it from rows towards columns."""
        return complex(self.row, self.col)

    def placed(self, at: complex, angle: float, segment: int) -> Pose:
        """Return the same frame elsewhere.

        Parameters
        ----------
        at : complex
            Position, row + i col, pixels.
        angle : float
            Radians.
        segment : int
            In which these are.
        """
        return self._replace(segment=segment, row=at.real, col=at.imag, angle=angle)

    @property
    def lost(self) -> Pose:
        """The same frame without a position."""
        return self._replace(row=nan, col=nan, velocity=Velocity(nan, nan), state=TrackingState.LOST)


def frame_periods(frames: int, lost: Mapping[int, int]) -> NDArray[np.int64]:
    """Return when frames were taken, counted in frame periods, (frames,).

    Parameters
    ----------
    frames : int
        How many were added.
    lost : mapping of int to int
        How many frames were lost before some, by their index.
    """
    return np.cumsum([1 + lost.get(index, 0) for index in range(frames)], dtype=np.int64)


def tracked_frames(poses: Sequence[Pose]) -> list[int]:
    """Return the indices of the frames whose `poses` are tracked."""
    return [index for index, pose in enumerate(poses) if pose.state is TrackingState.TRACKED]
