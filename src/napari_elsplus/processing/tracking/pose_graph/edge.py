"""Edges of the pose graph: displacement and turn of one node relative to another."""

from __future__ import annotations

from cmath import rect
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.pose import Pose

UNKNOWN_TURN: Final = 1.0
"""Standard deviation of an angle that was not estimated, radians, and the largest that is distinguished."""


class Edge(NamedTuple):
    """Displacement and turn between two nodes.

    Parameters
    ----------
    earlier, later : int
        The nodes.
    displacement : complex
        Of the later node from the earlier one, row + i col, in the later one's orientation, pixels.
    covariance : numpy.ndarray
        (2, 2) of (row, col), pixels squared.
    turn : float
        Angle of the later node less that of the earlier one, radians.
    turn_sigma : float
        One standard deviation of the angle.
    sure : bool
        True if this edge alone joins two segments.

    Examples
    --------
    >>> from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
    >>> from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
    >>> first = Pose(3, 10.0, 20.0, Velocity(1.0, 0.0), 0.9, 0.1, TrackingState.TRACKED)
    >>> quarter = Edge(0, 1, 10j, np.eye(2), turn=np.pi / 2)
    >>> complex(np.round(quarter.from_pose(first, first).at, 6))
    20j
    """

    earlier: int
    later: int
    displacement: complex
    covariance: NDArray[np.float64]
    turn: float = 0.0
    turn_sigma: float = UNKNOWN_TURN
    sure: bool = False

    @classmethod
    def between(cls, earlier: int, later: int, a: Pose, b: Pose) -> Edge:
        """Return the edge, without uncertainty, that the poses of two nodes imply.

        Parameters
        ----------
        earlier, later : int
            The nodes.
        a, b : Pose
            Of the earlier and the later one.
        """
        return cls(earlier, later, rect(1, -b.angle) * (b.at - a.at), np.zeros((2, 2)), b.angle - a.angle)

    def from_pose(self, a: Pose, b: Pose) -> Pose:
        """Return the pose of the later node that follows from that of the earlier one, in its segment.

        Parameters
        ----------
        a, b : Pose
            Of the earlier and the later node.
        """
        angle = a.angle + self.turn
        return b.placed(a.at + rect(1, angle) * self.displacement, angle, a.segment)
