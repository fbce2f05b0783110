"""The ways in which raw frames are tracked, behind one protocol: ours, and the paper's."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from napari_elsplus.processing.images.sectioning import Mode, Sectioner
from napari_elsplus.processing.tracking.front_end.front_end import FrontEnd
from napari_elsplus.processing.tracking.pose_graph.refinement import refine
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel
from napari_elsplus.processing.tracking.registration.prepared_frames import RecentFrames
from napari_elsplus.processing.tracking.registration.shutter_timing import (
    LinePeriodsPerFrame,
    estimate_line_periods_per_frame,
)
from napari_elsplus.processing.tracking.template_tracking import TemplateTracker
from napari_elsplus.processing.tracking.tracker import Tracker

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, PreparedFrame

_KEPT_VIEWS: Final = 300
"""Views of frames that are kept while a track is finished; others are made anew when they are needed."""


class TrackingMethod(Protocol):
    """What a method does with raw frames; `raw_residual` is the frame that the residual is taken from."""

    grid: Grid
    scale: float

    def track(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> tuple[Pose, NDArray[np.float32]]:
        """Return where a frame lies, and its image, which is good until the next call."""

    def image(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> NDArray[np.float32]:
        """Return a frame's image, which is good until the next call."""

    def look(self, raw: NDArray[Any], raw_residual: NDArray[Any], out: NDArray[np.float32]) -> None:
        """Make the image of a frame that is to be placed."""

    def place(self, image: NDArray[np.float32]) -> Pose:
        """Return where the frame of such an image lies."""

    def refine(self, poses: list[Pose], image: Callable[[int], NDArray[np.float32]]) -> list[Pose]:
        """Return better poses, once all frames are there."""

    def forget_links(self) -> None:
        """Let go of what only :meth:`refine` needs."""

    @property
    def newest_link(self) -> tuple[int, int, PairRegistration] | None:
        """The link by which a frame was tracked last, if it is kept."""

    @property
    def rung(self) -> MotionModel:
        """What is modelled beside translations."""


class RegistrationTracking:
    """Sub-pixel, rolling shutter undone, gated.

    Parameters
    ----------
    calibration : Calibration
        Needs the bundle section.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    mode : Mode
        Which image is tracked.
    """

    def __init__(self, calibration: Calibration, frame_shape: tuple[int, int], mode: Mode) -> None:
        self._front_end = FrontEnd(calibration, frame_shape, mode)
        self.grid = self._front_end.grid
        self.scale = float(self.grid.binning)
        self._tracker = Tracker(self.grid)
        self._image = np.zeros((self.grid.side, self.grid.side), np.float32)

    def track(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> tuple[Pose, NDArray[np.float32]]:
        """Return where a frame lies, and its image, which is good until the next call."""
        image = self._tracker.slot()
        self.look(raw, raw_residual, image)
        return self._tracker.add(), image

    def look(self, raw: NDArray[Any], raw_residual: NDArray[Any], out: NDArray[np.float32]) -> None:
        """Make the image of a frame that is to be placed."""
        self._front_end.image(raw, out, raw_residual)
        if self._front_end.blank(raw):
            out[:] = 0

    def place(self, image: NDArray[np.float32]) -> Pose:
        """Return where the frame of such an image lies."""
        self._tracker.slot()[:] = image
        return self._tracker.add()

    def image(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> NDArray[np.float32]:
        """Return a frame's image, which is good until the next call."""
        return self._front_end.image(raw, self._image, raw_residual)

    def line_periods_per_frame(self) -> LinePeriodsPerFrame | None:
        """Return what the motion so far tells of the timing, in camera rows."""
        found = estimate_line_periods_per_frame(self._tracker.links, self.grid.shutter)
        return None if found is None else LinePeriodsPerFrame(found.rows * self.scale, found.sigma * self.scale)

    def forget_links(self) -> None:
        """Let go of what only :meth:`refine` needs."""
        self._tracker.links.clear()

    @property
    def newest_link(self) -> tuple[int, int, PairRegistration] | None:
        """The link by which a frame was tracked last, if it is kept."""
        if not self._tracker.links:
            return None
        earlier, later, _, link = self._tracker.links[-1]
        return earlier, later, link

    @property
    def rung(self) -> MotionModel:
        """What is modelled beside translations."""
        return self._tracker.rung

    def refine(self, poses: list[Pose], image: Callable[[int], NDArray[np.float32]]) -> list[Pose]:
        """Return better poses, once all frames are there."""
        registrar = self._tracker.registrar
        views = RecentFrames(registrar, _KEPT_VIEWS)

        def view(index: int) -> PreparedFrame:
            return views.get(index) or views.add(index, lambda out: np.copyto(out, image(index)))

        return refine(poses, self._tracker.links, registrar, view, self._tracker.rung)


class TemplateTracking:
    """Whole-pixel template matching (Thrapp and Hughes 2021); parameters as of :class:`RegistrationTracking`."""

    def __init__(self, calibration: Calibration, frame_shape: tuple[int, int], mode: Mode) -> None:
        self._sectioner, self._mode = Sectioner(calibration, frame_shape), mode
        self._tracker = TemplateTracker(self._sectioner.diameter_px, self._sectioner.side)
        self.grid, self.scale = self._tracker.grid, self._tracker.scale

    def track(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> tuple[Pose, NDArray[np.float32]]:
        """Return where a frame lies, and its image, which is good until the next call."""
        image = self.image(raw, raw_residual)
        return self._tracker.add(image), image

    def look(self, raw: NDArray[Any], raw_residual: NDArray[Any], out: NDArray[np.float32]) -> None:
        """Make the image of a frame that is to be placed."""
        out[:] = self.image(raw, raw_residual)

    def place(self, image: NDArray[np.float32]) -> Pose:
        """Return where the frame of such an image lies."""
        return self._tracker.add(image)

    def image(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> NDArray[np.float32]:
        """Return a frame's image, which is good until the next call."""
        frames = [raw] if self._mode is not Mode.ELSA else [raw, raw_residual]
        return self._tracker.prepare(self._sectioner.image(frames, 0, self._mode))

    def refine(self, poses: list[Pose], image: Callable[[int], NDArray[np.float32]]) -> list[Pose]:
        """Return the poses as they are: the paper closes no loops."""
        return poses

    def forget_links(self) -> None:
        """Keep nothing: there is nothing to refine."""

    @property
    def newest_link(self) -> None:
        """None: whole-pixel matches have no covariance."""

    @property
    def rung(self) -> MotionModel:
        """Translations alone."""
        return MotionModel.TRANSLATION
