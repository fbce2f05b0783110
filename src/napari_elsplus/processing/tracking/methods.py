"""Tracking methods: the protocol, and sub-pixel registration with a pose graph.

:mod:`~napari_elsplus.processing.tracking.registry` lists them by name; any pairwise registration becomes a registrar by
:class:`~napari_elsplus.processing.tracking.pairwise_tracking.PairwiseRegistrar`.
"""

from __future__ import annotations

from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from napari_elsplus.processing.progress import Progress, without_display
from napari_elsplus.processing.tracking.backward_tracking import completed
from napari_elsplus.processing.tracking.front_end.front_end import FrontEnd
from napari_elsplus.processing.tracking.middle_rows import at_middle_rows, of_mean_places
from napari_elsplus.processing.tracking.pose_graph.graph import PoseGraph
from napari_elsplus.processing.tracking.pose_graph.nodes import NodeRegistration
from napari_elsplus.processing.tracking.pose_graph.refinement import refine
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel, selected_model
from napari_elsplus.processing.tracking.registration.pair_registration import Registrar
from napari_elsplus.processing.tracking.registration.shutter_timing import (
    LinePeriodsPerFrame,
    estimate_line_periods_per_frame,
)
from napari_elsplus.processing.tracking.registration.strain_test import probe_turns
from napari_elsplus.processing.tracking.standing_pattern import WITHOUT_PATTERN, tracked_without_pattern
from napari_elsplus.processing.tracking.tracker import Tracker

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.sectioning import Mode
    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame, TrackedPair

_MAX_PREPARED_FRAMES: Final = 300
"""Prepared frames kept in memory during refinement, frames of some 0.3 MB each; chosen, others are computed again."""
_MAX_TESTED: Final = 600
"""Registrations of a finished track that are tested for rotation; chosen: some 0.2 s."""
_LOOSE: Final = 0.01
"""Standard deviation of stretch and shear in this test; chosen, above what velocities leave open."""

_WITH_ROTATION: Final = "Tracking again, with rotation"
_WITHOUT_ROTATION: Final = "Tracking again, without rotation"
"""Names of the steps in which a finished recording is tracked once more."""


class TrackingMethod(Protocol):
    """Estimates the pose of the probe for each frame of a sequence.

    Frames are (rows, cols) as the camera delivers them. `raw_residual` is the frame of which the residual view is used:
    the same as `raw` except in ELSA. Images are (n, n) float32 on `grid`; poses are in pixels of `grid`. A method that
    derives from this class has to add :meth:`prepare_image` and :meth:`estimate_pose`; the other members are those of a
    method without a pose graph.

    Attributes
    ----------
    grid : Grid
        The grid of the tracked images and of the mosaic.
    scale : float
        Camera pixels per pixel of the grid.
    """

    grid: Grid
    scale: float

    def prepare_image(self, raw: NDArray[Any], raw_residual: NDArray[Any], out: NDArray[np.float32]) -> None:
        """Write the image of a raw frame into `out`, (n, n); may run while another thread is in `estimate_pose`.

        Parameters
        ----------
        raw : numpy.ndarray
            (rows, cols) frame with the confocal view.
        raw_residual : numpy.ndarray
            Frame with the residual view: the same one, but for ELSA.
        out : numpy.ndarray
            (side, side) float32, filled.
        """

    def estimate_pose(self, image: NDArray[np.float32]) -> Pose:
        """Return the pose of the next frame from its prepared image."""

    def skip(self, frames: int) -> None:
        """Take note that frames were lost before the next one; methods without a model of the motion need not.

        Parameters
        ----------
        frames : int
            Frame periods that passed without a frame while the probe went on moving; 0 if none was lost.
        """
        del frames

    def image(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> NDArray[np.float32]:
        """Return the image of a raw frame.

        Parameters
        ----------
        raw, raw_residual : numpy.ndarray
            As in :meth:`prepare_image`.
        """
        image = np.empty((self.grid.side, self.grid.side), np.float32)
        self.prepare_image(raw, raw_residual, image)
        return image

    def track(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> tuple[Pose, NDArray[np.float32]]:
        """Return the pose of the next raw frame, and its image, which is valid until the next call.

        Parameters
        ----------
        raw, raw_residual : numpy.ndarray
            As in :meth:`prepare_image`.
        """
        image = self.image(raw, raw_residual)
        return self.estimate_pose(image), image

    def refine(
        self, poses: list[Pose], image: Callable[[int], NDArray[np.float32]], *, progress: Progress = without_display
    ) -> list[Pose]:
        """Return the poses refined over the whole sequence.

        Parameters
        ----------
        poses : list of Pose
            As estimated, one for every frame.
        image : callable
            Returns a frame's image by its index.
        progress : Progress
            Wraps the frames' numbers where all are tracked once more; an exception raised in it ends that.
        """
        del image, progress
        return poses

    def at_middle_rows(self, poses: list[Pose]) -> list[Pose]:
        """Return refined poses, by which frames are inserted, at the times at which the frames' middle rows are read.

        Parameters
        ----------
        poses : list of Pose
            One for every frame.
        """
        return poses

    def discard_registrations(self) -> None:
        """Free what only :meth:`refine` uses: for sequences without end."""
        return

    @property
    def newest_registration(self) -> TrackedPair | None:
        """The newest registration that was accepted; None if there is none."""
        return None

    @property
    def motion_model(self) -> MotionModel:
        """The motion model in use: translation or rigid."""
        return MotionModel.TRANSLATION


class FrontEndImages(TrackingMethod):
    """Images of the front end: split, subtracted, flat-fielded and binned near one pixel per core.

    Parameters
    ----------
    calibration : Calibration
        Needs the bundle section.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    mode : Mode
        Image type to track.
    """

    def __init__(self, calibration: Calibration, frame_shape: tuple[int, int], mode: Mode) -> None:
        self._front_end = FrontEnd(calibration, frame_shape, mode)
        self.grid = self._front_end.grid
        self.scale = float(self.grid.binning)

    def prepare_image(self, raw: NDArray[Any], raw_residual: NDArray[Any], out: NDArray[np.float32]) -> None:
        """See :meth:`TrackingMethod.prepare_image`; the image of a frame that shows nothing is zero."""
        self._front_end.image(raw, out, raw_residual)


class _WithoutRotation(Registrar):
    """Registers frames of a probe that does not turn: nothing is tested for rotation."""

    def remainder(self, *_: Any, **__: Any) -> None:
        """Return None."""


class RegistrationTracking(FrontEndImages):
    """Sub-pixel registration to keyframes with rolling-shutter correction, acceptance tests, and loop closure.

    Parameters
    ----------
    calibration, frame_shape, mode
        As of :class:`FrontEndImages`.
    registrar : callable
        Makes the registrar of a grid.
    """

    def __init__(
        self, calibration: Calibration, frame_shape: tuple[int, int], mode: Mode,
        registrar: Callable[[Grid], Registrar] = Registrar,
    ) -> None:  # fmt: skip
        super().__init__(calibration, frame_shape, mode)
        self._tracker = Tracker(registrar(self._front_end.sectioned))

    def track(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> tuple[Pose, NDArray[np.float32]]:
        """See :meth:`TrackingMethod.track`."""
        image = self._tracker.slot()
        self.prepare_image(raw, raw_residual, image)
        return self._tracker.add(), image

    def skip(self, frames: int) -> None:
        """See :meth:`TrackingMethod.skip`."""
        self._tracker.skip(frames)

    def estimate_pose(self, image: NDArray[np.float32]) -> Pose:
        """See :meth:`TrackingMethod.estimate_pose`."""
        self._tracker.slot()[:] = image
        return self._tracker.add()

    def line_periods_per_frame(self) -> LinePeriodsPerFrame | None:
        """Return the frame period in camera line periods, estimated from the motion so far; None if unconstrained."""
        found = estimate_line_periods_per_frame(self._tracker.links, self.grid.shutter)
        return None if found is None else LinePeriodsPerFrame(found.rows * self.scale, found.sigma * self.scale)

    def discard_registrations(self) -> None:
        """See :meth:`TrackingMethod.discard_registrations`."""
        self._tracker.links.clear()
        self._tracker.lost.clear()

    @property
    def newest_registration(self) -> TrackedPair | None:
        """See :class:`TrackingMethod`."""
        return self._tracker.links[-1] if self._tracker.links else None

    @property
    def motion_model(self) -> MotionModel:
        """The motion model that the score tests have selected so far."""
        return self._tracker.model

    def refine(
        self, poses: list[Pose], image: Callable[[int], NDArray[np.float32]], *, progress: Progress = without_display
    ) -> list[Pose]:
        """Return the poses of the solved pose graph: loops closed, segments joined; see :class:`TrackingMethod`.

        Unchanged where shifts alone are registered, without odds by which a graph could weigh them.
        """
        tracker, registrar, lost = self._tracker, self._tracker.registrar, self._tracker.lost
        if not registrar.registers_warps:
            return poses

        def again(
            step: str, registrar: Registrar, image: Callable[[int], NDArray[np.float32]], turn_rate: float | None = None
        ) -> tuple[list[Pose], Tracker]:
            """Track all frames once more."""
            once_more = Tracker(registrar, turn_rate)
            tracked = []
            for index in progress(range(len(poses)), step):
                once_more.skip(lost.get(index, 0))
                once_more.slot()[:] = image(index)
                tracked.append(once_more.add())
            return tracked, once_more

        poses, tracker, image = tracked_without_pattern(
            poses, tracker, image, partial(again, WITHOUT_PATTERN, registrar)
        )
        frame, model = prepared_frames(registrar, image, _MAX_PREPARED_FRAMES), tracker.model
        if model is MotionModel.TRANSLATION:
            model = reviewed_model(tracker.links, registrar, frame)
        if model is not MotionModel.TRANSLATION:  # its angle is known from the first frame on then
            rates = (link.registration.turn / link.periods for link in tracker.links if link.registration.turn)
            turned, links = completed(*again(_WITH_ROTATION, registrar, image, next(rates, 0.0)), image)
            if probe_turns(turned, links, registrar.grid.shutter, lost):
                return refine(turned, links, PoseGraph(NodeRegistration(registrar), frame), model, lost)
        if tracker.model is not MotionModel.TRANSLATION:
            poses, tracker = again(_WITHOUT_ROTATION, _WithoutRotation(registrar.grid), image)
        poses, links = completed(poses, tracker, image)
        links = of_mean_places(links, poses, registrar.grid, lost)
        return refine(poses, links, PoseGraph(NodeRegistration(registrar), frame), lost=lost)

    def at_middle_rows(self, poses: list[Pose]) -> list[Pose]:
        """See :meth:`TrackingMethod.at_middle_rows`."""
        return at_middle_rows(poses, self.grid, self._tracker.lost)


def prepared_frames(
    registrar: Registrar, image: Callable[[int], NDArray[np.float32]], limit: int
) -> Callable[[int], PreparedFrame]:
    """Return a function that returns the prepared frame of an index.

    Parameters
    ----------
    registrar : Registrar
        Prepares it.
    image : callable
        Returns its image.
    limit : int
        Number of frames that are held; others are prepared again.
    """

    @lru_cache(limit)
    def frame(index: int) -> PreparedFrame:
        view = registrar.view()
        view.image[:] = image(index)
        return registrar.prepare(view)

    return frame


def reviewed_model(
    links: Sequence[TrackedPair], registrar: Registrar, view: Callable[[int], PreparedFrame]
) -> MotionModel:
    """Return the motion model that all registrations of a finished track together select.

    While frames come, rotation is tested for now and then and modelled from when it is found. At the end a rotation can
    be found that was too slow.

    Parameters
    ----------
    links : sequence of TrackedPair
        The tracker's registrations; at most :data:`_MAX_TESTED` of them are tested, evenly chosen.
    registrar : Registrar
        Of the same grid.
    view : callable
        Returns the prepared frame of an index.
    """
    keys = {link.earlier for link in links}
    between = [link for link in links if link.later in keys]  # others share a keyframe, and its errors
    chosen = between[:: -(-len(between) // _MAX_TESTED) or 1]
    asked = [(registrar.remainder(view(a), view(b), link.warp, _LOOSE), link) for a, b, _, link, _ in chosen]
    every = [found for found, _ in asked if found is not None]
    sure = [found for found, link in asked if found is not None and link.tells_turn]
    return min(selected_model(every), selected_model(sure))
