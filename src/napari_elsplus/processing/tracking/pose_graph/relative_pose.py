"""Relative poses of nodes: displacement between two, the pose that an edge predicts, and agreement of two edges."""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING, Final

from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement
from napari_elsplus.processing.tracking.pose_graph.correction import Correction
from napari_elsplus.processing.tracking.registration.motion_models import turned_by

if TYPE_CHECKING:
    from collections.abc import Sequence

    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.pose_graph.least_squares import Edge

AGREEMENT_PX: Final = 3.0
"""Distance of two edges' predictions up to which they agree, and of a loop's edge from the track; chosen, far above the
scatter of edges in dim light (0.3 px)."""
_AGREEMENT_RAD: Final = 0.02
"""The same of angles, radians; derived: 2 px at the rim."""


def displacement_between(a: Pose, b: Pose) -> Displacement:
    """Return the displacement of pose `b` from pose `a` in the orientation of `b`, pixels."""
    row, col = turned_by(-b.angle) @ (b.row - a.row, b.col - a.col)
    return Displacement(float(row), float(col))


def predicted(edge: Edge, places: Sequence[Pose]) -> Pose:
    """Return the pose of an edge's later node that follows from the pose of the earlier one, in its segment.

    Parameters
    ----------
    edge : Edge
        Between two of the nodes.
    places : sequence of Pose
        Poses of all nodes.
    """
    a, b = places[edge.earlier], places[edge.later]
    angle = a.angle + edge.turn
    row, col = turned_by(angle) @ edge.displacement
    return b._replace(segment=a.segment, row=a.row + float(row), col=a.col + float(col), angle=angle)


def joining(edge: Edge, places: Sequence[Pose], segment: int) -> Correction:
    """Return the correction that takes one of the two segments of an edge, given by its number, into the other.

    Parameters
    ----------
    edge : Edge
        Between two of the nodes.
    places : sequence of Pose
        Poses of all nodes.
    segment : int
        Number of the segment that is moved.
    """
    here, there = places[edge.later], predicted(edge, places)
    return Correction.between(here, there) if here.segment == segment else Correction.between(there, here)


def agree(one: Edge, other: Edge, places: Sequence[Pose]) -> bool:
    """Return True if two edges between the same two segments predict the same pose of a node.

    Parameters
    ----------
    one, other : Edge
        Between nodes of the two segments.
    places : sequence of Pose
        Poses of all nodes.
    """
    pose, seen = places[other.later], predicted(other, places)
    expected = joining(one, places, pose.segment).of(pose)
    near = hypot(seen.row - expected.row, seen.col - expected.col) < AGREEMENT_PX
    return near and abs(seen.angle - expected.angle) < _AGREEMENT_RAD
