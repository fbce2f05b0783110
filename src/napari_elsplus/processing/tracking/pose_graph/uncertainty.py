"""Uncertainties of a finished track: of each position relative to that of the frame tracked before it.

While frames come, a registration is accepted by how uncertain it may be, whatever the probe does next. When the track
is finished the motion before and after each frame is known, and so is the way that connects two frames: one
registration, two with a key frame, or, across a jolt, those to and from an edge that joined their segments. Along it

- the noise of the frames in between cancels, since their neighbours on either side are registered to the same image;
- the later velocity of each registration adds what it displaces the rows by;
- uneven motion within the two frames displaces the middle of each. Under an acceleration a, rows that are read t frame
  periods from the middle are a t^2 / 2 off, in the mean over a disc that is read in r frame periods a r^2 / 32, and a
  turn by w radians a frame period shifts a disc of diameter d by w / R (d / 4)^2 along the columns, R rows being that
  period. What is alike in both frames cancels: they are uncertain by how these change about them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order

from napari_elsplus.processing.tracking.front_end.grid import FIELD
from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.processing.tracking.motion.prediction import LEFT_UNEVEN
from napari_elsplus.processing.tracking.pose_graph.edge import UNKNOWN_TURN
from napari_elsplus.processing.tracking.pose_graph.nodes import FLOOR_PX

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.pose_graph.graph import PoseGraph
    from napari_elsplus.processing.tracking.registration.pair_registration import TrackedPair

_BEND: Final = 1 / 32
"""Shift of a frame's middle by a unit acceleration, per squared time in which the disc is read; derived, see above."""


class _Step(NamedTuple):
    """Registration, or edge, between two frames: (2, 2) covariance by noise, variance by velocity, part left bent."""

    ends: tuple[int, int]
    noise: NDArray[np.float64]
    by_velocity: float
    bent: float


def with_uncertainties(
    poses: Sequence[Pose], periods: NDArray[np.int64], links: Sequence[TrackedPair], graph: PoseGraph
) -> list[Pose]:
    """Return the poses of a finished track with their uncertainties; that of the first of a segment is NaN.

    Parameters
    ----------
    poses : sequence of Pose
        Solved for, one for every frame.
    periods : numpy.ndarray
        (n,) frame periods in which the frames were taken.
    links : sequence of TrackedPair
        Registrations along the track, each within a segment.
    graph : PoseGraph
        With the edges that close loops or join segments.
    """
    at, angle = np.array([(pose.at, pose.angle) for pose in poses]).T
    segment = np.array([pose.segment if pose.state is TrackingState.TRACKED else -1 for pose in poses])
    rows, field = graph.grid.shutter.line_periods_per_frame, FIELD * graph.grid.diameter
    bend, turned = _BEND * min(field / rows, 1.0) ** 2, (field / 4) ** 2 / rows
    acceleration, uneven = np.zeros(len(poses), complex), np.zeros(len(poses))
    for number in np.unique(segment[segment >= 0]):
        own = np.flatnonzero(segment == number)
        if len(own) > 1:
            acceleration[own[1:-1]] = np.diff(np.diff(at[own]) / np.diff(periods[own]))
            middle = bend * acceleration[own] + 1j * turned * np.gradient(angle[own].real, periods[own])
            changed = np.pad(abs(np.diff(middle)) ** 2, 1)
            uneven[own[1:]] = (changed[:-2] + 2 * changed[1:-1] + changed[2:]) / 4
    of_angle = np.zeros(len(poses))
    for link in links:
        if link.registration.turn_sigma < UNKNOWN_TURN:
            of_angle[link.later] = of_angle[link.earlier] + graph.noise_share * link.registration.turn_sigma**2
    ways = _Ways(_steps(links, graph), len(poses))
    result, last = [pose._replace(sigma=np.nan) for pose in poses], dict[int, int]()
    for k in np.flatnonzero(segment >= 0).tolist():
        j = last.get(segment[k], k)
        last[segment[k]] = k
        way = ways(j, k)
        if not way:
            continue
        variance = float(np.linalg.eigvalsh(way[0].noise + way[-1].noise)[-1]) / 2
        variance += sum(step.by_velocity for step in way)
        variance += max(way[0].bent, way[-1].bent) * uneven[k] + of_angle[k] * abs(at[k] - at[j]) ** 2
        result[k] = result[k]._replace(sigma=float(variance) ** 0.5)
        # between the two the velocity may have changed evenly, or at once, by a jolt at any time
        gap = periods[k] - periods[j]
        curved, jump = (gap / 2 * abs(acceleration[k] + sign * acceleration[j]) for sign in (1, -1))
        for n in range(j + 1, k):
            if poses[n].state is TrackingState.PREDICTED:
                done = (periods[n] - periods[j]) / gap
                apart = done * (1 - done)
                result[n] = result[n]._replace(sigma=float(variance + jump**2 * apart + (curved * apart) ** 2) ** 0.5)
    return result


def _steps(links: Sequence[TrackedPair], graph: PoseGraph) -> list[_Step]:
    """Return the steps between frames: the registrations along the track, then edges, the most certain first."""
    floor, share, rows = FLOOR_PX**2 * np.eye(2), graph.noise_share, graph.grid.shutter.line_periods_per_frame
    steps = []
    for a, b, moved, link, _ in links:
        by_velocity = (moved.row / rows) ** 2 * link.velocity_variance
        times = 2 if link.turn_sigma < UNKNOWN_TURN else 1  # with a rotation the shift is estimated once more
        noise = times * share * link.covariance + floor
        steps.append(_Step((a, b), noise, by_velocity, LEFT_UNEVEN if link.evened else 1.0))
    edges = sorted(graph.loops, key=lambda edge: float(np.trace(edge.covariance)))  # of which velocities are part
    return [*steps, *(_Step((edge.earlier, edge.later), share * edge.covariance, 0.0, 1.0) for edge in edges)]


class _Ways:
    """The ways between frames along a spanning tree of steps, of which the first ones are preferred."""

    def __init__(self, steps: Sequence[_Step], frames: int) -> None:
        joined = DisjointSet(range(frames))
        self._step = {step.ends: step for step in steps if joined.merge(*step.ends)}
        ends = [*self._step, *((frames, min(connected)) for connected in joined.subsets())]  # of one root beyond them
        tree = coo_array((np.ones(len(ends)), np.transpose(ends)), (frames + 1, frames + 1)).tocsr()
        order, before = breadth_first_order(tree, frames, directed=False)
        self._before, self._rank = before.tolist(), np.argsort(order).tolist()
        self._step |= {(later, earlier): step for (earlier, later), step in self._step.items()}

    def __call__(self, earlier: int, later: int) -> list[_Step]:
        """Return the steps from one frame to another; none where they are not connected."""
        ends = [earlier, later]
        ways: tuple[list[_Step], list[_Step]] = [], []
        while ends[0] != ends[1]:
            farther = int(self._rank[ends[1]] > self._rank[ends[0]])
            end = ends[farther]
            ends[farther] = self._before[end]
            if (end, ends[farther]) not in self._step:
                return []
            ways[farther].append(self._step[end, ends[farther]])
        return [*ways[0], *reversed(ways[1])]
