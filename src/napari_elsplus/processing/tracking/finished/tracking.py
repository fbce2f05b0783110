"""Tracking of finished images of any microscope: soft texture, large moves, frames without contact, repeated frames.

The tracker of raw frames with another registrar: each image is searched for over all shifts and accepted by its odds
(:mod:`~napari_elsplus.processing.tracking.finished.shift_odds`); the accepted shift is refined by
Lucas-Kanade. No rolling shutter is corrected: how other microscopes scan is unknown. Frames without a registration are
lost: their motion is not predicted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.processing.progress import Progress, without_display
from napari_elsplus.processing.tracking.finished.registration import FinishedNodeRegistration, FinishedRegistrar
from napari_elsplus.processing.tracking.front_end.grid import FIELD, lit_pixels
from napari_elsplus.processing.tracking.methods import TrackingMethod, prepared_frames
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.pose_graph.graph import PoseGraph
from napari_elsplus.processing.tracking.pose_graph.refinement import located, refine
from napari_elsplus.processing.tracking.standing_pattern import WITHOUT_PATTERN, tracked_without_pattern
from napari_elsplus.processing.tracking.tracker import Tracker

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.finished.field import FinishedField

REPEATED_NOISE: Final = 0.25
"""Difference of a repeated frame from its twin over the noise in either, standard deviations; chosen: two exposures
differ by 1.4, a recompressed copy by less than 0.1."""
_LAPLACIAN: Final = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
"""Filter whose response to white noise has its standard deviation (Immerkaer 1996, doi:10.1006/cviu.1996.0060)."""
_MAX_HELD: Final = 64
"""Frames whose spectra are held while segments are joined, some 4 MB each; chosen, others are computed again."""


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
        self._registrar = FinishedRegistrar(field)
        self._tracker = Tracker(self._registrar)
        self._inside = lit_pixels(*self.grid.spans(FIELD - 2 / self.grid.diameter))
        self._previous = np.zeros((self.grid.side,) * 2, np.float32)
        self._poses: list[Pose] = []
        self._image_of_frame: list[int] = []

    def prepare_image(self, raw: NDArray[Any], raw_residual: NDArray[Any], out: NDArray[np.float32]) -> None:
        """See :meth:`~.methods.TrackingMethod.prepare_image`."""
        out[:] = self._field.window(raw)

    def estimate_pose(self, image: NDArray[np.float32]) -> Pose:
        """See :meth:`~.methods.TrackingMethod.estimate_pose`; a repeated frame has the pose of its twin."""
        if not self._poses or not self._repeats(image, self._previous):
            self._add(self._tracker, self._poses, image)
            self._previous[:] = image
        self._image_of_frame.append(len(self._poses) - 1)
        return _in_pixels_of(1 / self._registrar.binning, self._poses[-1])

    @staticmethod
    def _add(tracker: Tracker, poses: list[Pose], image: NDArray[np.float32]) -> None:
        """Track an image; frames without a registration are lost."""
        tracker.slot()[:] = image
        pose = tracker.add()
        if poses and pose.segment > poses[-1].segment:  # the frame before was registered, too
            poses[-1] = poses[-1]._replace(segment=pose.segment, state=TrackingState.TRACKED)
        poses.append(pose if pose.state is TrackingState.TRACKED else pose.lost)

    def refine(
        self, poses: list[Pose], image: Callable[[int], NDArray[np.float32]], *, progress: Progress = without_display
    ) -> list[Pose]:
        """See :meth:`~.methods.TrackingMethod.refine`."""
        frames = np.unique(self._image_of_frame, return_index=True)[1].tolist()
        registrar = self._registrar

        def one(index: int) -> NDArray[np.float32]:
            """Return the image of a frame that repeats no other."""
            return image(frames[index])

        def again(images: Callable[[int], NDArray[np.float32]]) -> tuple[list[Pose], Tracker]:
            """Track other images of these frames."""
            tracker, found = Tracker(registrar), list[Pose]()
            for index in progress(range(len(frames)), WITHOUT_PATTERN):
                self._add(tracker, found, images(index))
            return found, tracker

        poses, tracker, images = tracked_without_pattern(self._poses, self._tracker, one, again)
        graph = PoseGraph(FinishedNodeRegistration(registrar), prepared_frames(registrar, images, _MAX_HELD))
        refined = refine(located(poses, tracker.links, graph.grid.shutter), tracker.links, graph)
        return [_in_pixels_of(1 / registrar.binning, refined[k]) for k in self._image_of_frame]

    def discard_registrations(self) -> None:
        """See :meth:`~.methods.TrackingMethod.discard_registrations`."""
        self._tracker.links.clear()

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
