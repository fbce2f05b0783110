"""Tracking of finished images of any microscope: soft texture, large moves, frames without contact, repeated frames.

Each image is registered to the last tracked one over all shifts and accepted by its odds
(:mod:`~napari_elsplus.processing.tracking.finished.shift_odds`); the accepted shift is refined by
Lucas-Kanade. No rolling shutter is corrected: how other microscopes scan is unknown.
"""

from __future__ import annotations

from collections import OrderedDict
from math import hypot, nan
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.processing.tracking.finished.registration import (
    FinishedFrame,
    FinishedLink,
    FinishedNodes,
    FinishedRegistration,
)
from napari_elsplus.processing.tracking.front_end.grid import FIELD, Grid
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
from napari_elsplus.processing.tracking.pose_graph.graph import PoseGraph
from napari_elsplus.processing.tracking.pose_graph.keyframes import KEY_SPACING, Node
from napari_elsplus.processing.tracking.pose_graph.least_squares import Edge, least_squares_positions
from napari_elsplus.processing.tracking.pose_graph.refinement import add_all
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel
from napari_elsplus.processing.tracking.tracker import KEY_FRAME_REACH

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.finished.field import FinishedField

MAX_GAP_FRAMES: Final = 5
"""Frames without a registration after which a segment is not continued, as in the tracker of raw frames; segments are
joined when the stack is finished."""
RIGID_CORRELATION: Final = 0.9
"""Correlation from which frames are registered to a keyframe as well; chosen, deforming tissue stays below it."""
REPEATED_NOISE: Final = 0.25
"""Difference of a repeated frame from its twin over the noise in either, standard deviations; chosen: two exposures
differ by 1.4, a recompressed copy by less than 0.1."""
_NODE_SIGMA: Final = 0.01
"""Standard deviation of the displacement between two nodes, fraction of the path; chosen, above the drift."""
_LAPLACIAN: Final = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
"""Filter whose response to white noise has its standard deviation (Immerkaer 1996, doi:10.1006/cviu.1996.0060)."""
_AT_REST: Final = Velocity(0.0, 0.0)
_UNKNOWN: Final = Velocity(nan, nan)
_MAX_HELD: Final = 64
"""Frames whose spectra are held while segments are joined, some 2 MB each; chosen, others are computed again."""


class FinishedTracking:
    """Tracks finished images; implements :class:`~.methods.TrackingMethod`.

    Parameters
    ----------
    field : FinishedField
        Field of view and static pattern of the stack.
    """

    scale = 1.0

    def __init__(self, field: FinishedField) -> None:
        self.grid = field.grid
        self._field = field
        self._registration = FinishedRegistration(field)
        self._image = np.zeros((self.grid.side,) * 2, np.float32)
        y, x = (np.arange(self.grid.side) - c for c in self.grid.centre)
        self._inside = np.hypot(y[:, None], x) < 0.5 * FIELD * self.grid.diameter - 1
        self._tracked: FinishedFrame | None = None
        self._keyframe: FinishedFrame | None = None
        self._rigid: list[Edge] = []
        self._previous: FinishedFrame | None = None
        self._previous_image = np.zeros_like(self._image)
        self._pose = Pose(0, nan, nan, _UNKNOWN, nan, nan, TrackingState.LOST)
        self._twins: list[int] = []
        self._links: list[FinishedLink] = []
        self._segment = -1
        self._untracked = 0

    def image(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> NDArray[np.float32]:
        """See :meth:`~.methods.TrackingMethod.image`."""
        self.prepare_image(raw, raw_residual, self._image)
        return self._image

    def prepare_image(self, raw: NDArray[Any], raw_residual: NDArray[Any], out: NDArray[np.float32]) -> None:
        """See :meth:`~.methods.TrackingMethod.prepare_image`."""
        out[:] = self._field.window(raw)

    def track(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> tuple[Pose, NDArray[np.float32]]:
        """See :meth:`~.methods.TrackingMethod.track`."""
        image = self.image(raw, raw_residual)
        return self.estimate_pose(image), image

    def estimate_pose(self, image: NDArray[np.float32]) -> Pose:
        """See :meth:`~.methods.TrackingMethod.estimate_pose`; a repeated frame has the pose of its twin."""
        index = len(self._twins)
        previous = self._previous
        if previous is not None and self._repeats(image, self._previous_image):
            self._twins.append(self._twins[-1])
            return self._pose
        self._twins.append(index)
        here = self._registration.prepared(index, image)
        self._pose = self._continue(here) or self._start_segment(here)
        self._untracked = 0 if self._pose.state is TrackingState.TRACKED else self._untracked + 1
        self._previous = here
        self._previous_image[:] = image
        return self._pose

    def refine(self, poses: list[Pose], image: Callable[[int], NDArray[np.float32]]) -> list[Pose]:
        """Return the poses with segments joined, and lost frames where nothing is registered, but for a lone first one.

        Parameters
        ----------
        poses : list of Pose
            One for each frame so far.
        image : callable
            As of :meth:`~.methods.TrackingMethod.refine`.
        """
        edges = [*(link.edge for link in self._links), *self._rigid]
        edges += self._closed(_positions(edges), image)
        found = _positions(edges)
        if not found and self._twins:
            found[0] = Pose(0, 0.0, 0.0, _AT_REST, nan, nan, TrackingState.TRACKED)
        for link in self._links:
            index = link.edge.later
            found[index] = found[index]._replace(score=link.score, sigma=link.sigma)
        refined: list[Pose] = []
        segment = 0
        for twin in self._twins[: len(poses)]:
            pose = found.get(twin)
            segment = segment if pose is None else pose.segment
            refined.append(pose or Pose(segment, nan, nan, _UNKNOWN, nan, nan, TrackingState.LOST))
        return refined

    def discard_registrations(self) -> None:
        """See :meth:`~.methods.TrackingMethod.discard_registrations`."""
        self._links.clear()
        self._rigid.clear()

    @property
    def newest_registration(self) -> None:
        """None: registrations of finished images do not carry live loop closure."""

    @property
    def motion_model(self) -> MotionModel:
        """Translation."""
        return MotionModel.TRANSLATION

    def _continue(self, here: FinishedFrame) -> Pose | None:
        """Register a frame to the newest tracked one of the segment."""
        last = self._tracked
        if last is None or self._untracked >= MAX_GAP_FRAMES:
            return None
        link = self._registration.register(last, here)
        if link is None:
            return None
        down, across = link.edge.displacement
        here.row, here.col = last.row + down, last.col + across
        self._links.append(link)
        self._register_to_keyframe(here, last)
        self._tracked = here
        return Pose(self._segment, here.row, here.col, _AT_REST, link.score, link.sigma, TrackingState.TRACKED)

    def _register_to_keyframe(self, here: FinishedFrame, last: FinishedFrame) -> None:
        """Register a frame to the keyframe too where the scene is rigid, and correct its position by that."""
        key = self._keyframe
        if key is None or hypot(here.row - key.row, here.col - key.col) > KEY_FRAME_REACH * self.grid.diameter:
            key = self._keyframe = last
        moved = here.row - key.row, here.col - key.col
        link = None if key is last else self._registration.refined(key, here, moved)
        if link is not None and link.score > RIGID_CORRELATION:
            self._rigid.append(link.edge)
            here.row, here.col = key.row + link.edge.displacement[0], key.col + link.edge.displacement[1]

    def _start_segment(self, here: FinishedFrame) -> Pose:
        """Start a segment with a frame that registers on the one before, which is lost itself, or with the first."""
        previous = self._previous
        link = None
        if previous is not None and np.isnan(previous.row):
            link = self._registration.register(previous, here)
        if link is None and previous is not None:
            return Pose(max(self._segment, 0), nan, nan, _UNKNOWN, nan, nan, TrackingState.LOST)
        self._segment += 1
        here.row = here.col = 0.0
        self._tracked = self._keyframe = here
        if link is not None:
            self._links.append(link)
        score, sigma = (nan, nan) if link is None else (link.score, link.sigma)
        return Pose(self._segment, 0.0, 0.0, _AT_REST, score, sigma, TrackingState.TRACKED)

    def _repeats(self, image: NDArray[np.float32], before: NDArray[np.float32]) -> bool:
        """Return True if an image differs from the one before by less than two exposures do."""
        inside = self._inside
        difference = float(np.sqrt(np.mean((image - before)[inside] ** 2)))
        response = np.abs(cv2.filter2D(before, -1, _LAPLACIAN)[inside])
        noise = float(np.median(response)) / 0.6745
        return difference <= max(REPEATED_NOISE * noise, 0.5 * self._field.quantum)

    def _closed(self, found: dict[int, Pose], image: Callable[[int], NDArray[np.float32]]) -> list[Edge]:
        """Return the edges of the pose graph that close loops or join segments."""
        q, held = self._registration.binning, OrderedDict[int, FinishedFrame]()

        def frame(number: int) -> FinishedFrame:
            index = graph.nodes[number].frame
            if index not in held:
                held[index] = self._registration.prepared(index, image(index))
            held.move_to_end(index)
            if len(held) > _MAX_HELD:
                held.popitem(last=False)
            return held[index]

        nodes = list(_nodes(found, self._registration.grid, q))
        registration = FinishedNodes(self._registration, frame, len(nodes) ** 2)
        graph = PoseGraph(self._registration.grid, registration, lambda number: frame(number).view)
        return [
            edge._replace(
                displacement=(q * edge.displacement[0], q * edge.displacement[1]), covariance=q**2 * edge.covariance
            )
            for edge in add_all(graph, nodes)
        ]


def _nodes(found: dict[int, Pose], grid: Grid, binning: int) -> Iterator[Node]:
    """Yield the nodes along a track of frames by their numbers, in pixels of the binned grid."""
    last: dict[int, Pose] = {}
    gone: dict[int, float] = {}
    before: dict[int, Pose] = {}
    for index, tracked in sorted(found.items()):
        pose = tracked._replace(row=tracked.row / binning, col=tracked.col / binning)
        segment = pose.segment
        previous = before.get(segment, pose)
        gone[segment] = gone.get(segment, 0.0) + hypot(pose.row - previous.row, pose.col - previous.col)
        before[segment] = pose
        if segment not in last or gone[segment] > KEY_SPACING * grid.diameter:
            covariance = (_NODE_SIGMA * max(gone[segment], 1.0)) ** 2 * np.eye(2)
            yield Node(index, pose, gone[segment], covariance, 1.0)
            last[segment], gone[segment] = pose, 0.0


def _positions(edges: Sequence[Edge]) -> dict[int, Pose]:
    """Return the poses of all frames with edges, each set of connected ones a segment."""
    found: dict[int, Pose] = {}
    for segment, members in enumerate(_components(edges)):
        own = [edge for edge in edges if edge.earlier in members]
        for index, (row, col) in least_squares_positions(own, min(members)).items():
            found[index] = Pose(segment, row, col, _AT_REST, nan, nan, TrackingState.TRACKED)
    return found


def _components(edges: Iterable[Edge]) -> list[set[int]]:
    """Return the frames that edges connect, each set by its first frame in order."""
    groups: list[set[int]] = []
    for edge in edges:
        touched = [group for group in groups if edge.earlier in group or edge.later in group]
        groups = [group for group in groups if all(group is not other for other in touched)]
        groups.append({edge.earlier, edge.later}.union(*touched))
    return sorted(groups, key=min)
