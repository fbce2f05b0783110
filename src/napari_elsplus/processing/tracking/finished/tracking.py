"""Tracking of finished images of any microscope: soft texture, large moves, frames without contact, repeated frames.

Each image is registered to the last tracked one over all shifts and accepted by its odds
(:mod:`~napari_elsplus.processing.tracking.finished.shift_odds`); the accepted shift is refined by
Lucas-Kanade. No rolling shutter is corrected: how other microscopes scan is unknown.
"""

from __future__ import annotations

from functools import lru_cache
from math import hypot, nan
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.processing.tracking.finished.registration import FinishedFrame, FinishedRegistration
from napari_elsplus.processing.tracking.front_end.grid import FIELD
from napari_elsplus.processing.tracking.methods import TrackingMethod
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity, Warp
from napari_elsplus.processing.tracking.pose_graph.graph import PoseGraph
from napari_elsplus.processing.tracking.pose_graph.refinement import refine
from napari_elsplus.processing.tracking.tracker import KEY_FRAME_REACH

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.finished.field import FinishedField
    from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration

MAX_GAP_FRAMES: Final = 5
"""Frames without a registration after which a segment is not continued, as in the tracker of raw frames; segments are
joined when the stack is finished."""
RIGID_CORRELATION: Final = 0.9
"""Correlation from which frames are registered to a keyframe; chosen, deforming tissue stays below it."""
REPEATED_NOISE: Final = 0.25
"""Difference of a repeated frame from its twin over the noise in either, standard deviations; chosen: two exposures
differ by 1.4, a recompressed copy by less than 0.1."""
_LAPLACIAN: Final = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
"""Filter whose response to white noise has its standard deviation (Immerkaer 1996, doi:10.1006/cviu.1996.0060)."""
_AT_REST: Final = Velocity(0.0, 0.0)
_UNKNOWN: Final = Velocity(nan, nan)
_MAX_HELD: Final = 64
"""Frames whose spectra are held while segments are joined, some 2 MB each; chosen, others are computed again."""


class FinishedTracking(TrackingMethod):
    """Tracks finished images.

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
        y, x = (np.arange(self.grid.side) - c for c in self.grid.centre)
        self._inside = np.hypot(y[:, None], x) < 0.5 * FIELD * self.grid.diameter - 1
        self._tracked: FinishedFrame | None = None
        self._keyframe: FinishedFrame | None = None
        self._previous: FinishedFrame | None = None
        self._previous_image = np.zeros((self.grid.side,) * 2, np.float32)
        self._poses: list[Pose] = []
        self._image_of_frame: list[int] = []
        self._links: dict[int, tuple[int, int, Displacement, PairRegistration]] = {}
        self._segment = -1

    def prepare_image(self, raw: NDArray[Any], raw_residual: NDArray[Any], out: NDArray[np.float32]) -> None:
        """See :meth:`~.methods.TrackingMethod.prepare_image`."""
        out[:] = self._field.window(raw)

    def estimate_pose(self, image: NDArray[np.float32]) -> Pose:
        """See :meth:`~.methods.TrackingMethod.estimate_pose`; a repeated frame has the pose of its twin."""
        repeated = self._previous is not None and self._repeats(image, self._previous_image)
        if not repeated:
            here = self._registration.prepared(len(self._poses), image)
            self._poses.append(self._continue(here) or self._start_segment(here))
            self._previous = here
            self._previous_image[:] = image
        self._image_of_frame.append(len(self._poses) - 1)
        return _in_pixels_of(1 / self._registration.binning, self._poses[-1])

    def refine(self, poses: list[Pose], image: Callable[[int], NDArray[np.float32]]) -> list[Pose]:
        """See :meth:`~.methods.TrackingMethod.refine`."""
        frames = np.unique(self._image_of_frame, return_index=True)[1].tolist()
        frame = lru_cache(_MAX_HELD)(lambda index: self._registration.prepared(index, image(frames[index])))
        graph = PoseGraph(self._registration.grid, self._registration, frame)
        refined = refine(self._poses, [*self._links.values()], graph)
        return [_in_pixels_of(1 / self._registration.binning, refined[k]) for k in self._image_of_frame]

    def discard_registrations(self) -> None:
        """See :meth:`~.methods.TrackingMethod.discard_registrations`."""
        self._links.clear()

    def _continue(self, here: FinishedFrame) -> Pose | None:
        """Register a frame to the newest tracked one, and where the scene is rigid to the keyframe instead."""
        last = self._tracked
        if last is None or here.index - last.index > MAX_GAP_FRAMES:
            return None
        link = self._registration.link(last, here)
        if link is None:
            return None
        self._place(last, here, link)
        key = self._keyframe
        moved = Warp(b=key.row - here.row, d=key.col - here.col) if key is not None else Warp()
        if key is None or hypot(moved.b, moved.d) > KEY_FRAME_REACH * self._registration.grid.diameter:
            self._keyframe = last
        elif key is not last:
            rigid = self._registration.refined(key, here, moved)
            if rigid is not None and rigid.correlation > RIGID_CORRELATION:
                self._place(key, here, rigid)
        return self._tracked_pose(here, link)

    def _start_segment(self, here: FinishedFrame) -> Pose:
        """Start a segment with a frame that registers on the one before, which is lost itself, or with the first."""
        previous = self._previous
        link = None
        if previous is not None and np.isnan(previous.row):
            link = self._registration.link(previous, here)
        if link is None and previous is not None:
            return Pose(max(self._segment, 0), nan, nan, _UNKNOWN, nan, nan, TrackingState.LOST)
        self._segment += 1
        if previous is not None and link is not None:
            previous.row = previous.col = 0.0
            self._poses[previous.index] = self._tracked_pose(previous, None)
            self._place(previous, here, link)
        else:
            here.row = here.col = 0.0
        self._keyframe = here
        return self._tracked_pose(here, link)

    def _place(self, earlier: FinishedFrame, here: FinishedFrame, link: PairRegistration) -> None:
        moved = Displacement(-link.warp.b, -link.warp.d)
        here.row, here.col = earlier.row + moved.row, earlier.col + moved.col
        self._links[here.index] = (earlier.index, here.index, moved, link)

    def _tracked_pose(self, here: FinishedFrame, link: PairRegistration | None) -> Pose:
        self._tracked = here
        score, sigma = (nan, nan) if link is None else (link.correlation, link.sigma)
        return Pose(self._segment, here.row, here.col, _AT_REST, score, sigma, TrackingState.TRACKED)

    def _repeats(self, image: NDArray[np.float32], before: NDArray[np.float32]) -> bool:
        """Return True if an image differs from the one before by less than two exposures do."""
        inside = self._inside
        difference = float(np.sqrt(np.mean((image - before)[inside] ** 2)))
        response = np.abs(cv2.filter2D(before, -1, _LAPLACIAN)[inside])
        noise = float(np.median(response)) / 0.6745
        return difference <= max(REPEATED_NOISE * noise, 0.5 * self._field.quantum)


def _in_pixels_of(px: float, pose: Pose) -> Pose:
    """Return a pose in pixels of another size."""
    return pose._replace(row=pose.row / px, col=pose.col / px, sigma=pose.sigma / px)
