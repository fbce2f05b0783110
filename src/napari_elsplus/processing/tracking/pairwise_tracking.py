"""Tracking by any pairwise registration function: keyframes, rolling-shutter correction and segments around it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot, nan
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.processing.tracking.methods import FrontEndImages, WithoutPoseGraph
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity, Warp
from napari_elsplus.processing.tracking.tracker import KEY_FRAME_REACH, MAX_DISPLACEMENT_DIAMETERS, PATIENCE_FRAMES

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.sectioning import Mode

_AT_REST: Final = Velocity(0.0, 0.0)
_UNKNOWN: Final = Velocity(nan, nan)


class PairwiseShift(NamedTuple):
    """Result of a pairwise registration.

    Parameters
    ----------
    shift : tuple of float
        (rows, cols), pixels: ``moving[r, c]`` shows what ``fixed[r + rows, c + cols]`` shows, which is the sign of
        scikit-image's `phase_cross_correlation`.
    covariance : numpy.ndarray
        (2, 2) covariance of the shift, px squared.
    score : float
        Correlation of the overlap or the like, 0 to 1; written to the track.
    """

    shift: tuple[float, float]
    covariance: NDArray[np.float64]
    score: float = nan


class PairwiseRegistration(Protocol):
    """A function that registers two images."""

    def __call__(
        self, fixed: NDArray[np.float32], moving: NDArray[np.float32], expected: tuple[float, float]
    ) -> PairwiseShift | None:
        """Register an image on an earlier one.

        Parameters
        ----------
        fixed, moving : numpy.ndarray
            (n, n) float32, grey levels, zero outside of the bundle; not to be changed.
        expected : tuple of float
            Shift (rows, cols) predicted from the motion so far, pixels; (0, 0) where nothing is known.

        Returns
        -------
        PairwiseShift or None
            None where the images do not determine the shift.
        """


@dataclass(frozen=True, slots=True)
class _Placed:
    """A frame with its index and its position in the segment, pixels."""

    image: NDArray[np.float32]
    index: int
    row: float = 0.0
    col: float = 0.0


class PairwiseTracking(FrontEndImages, WithoutPoseGraph):
    """Tracking method around a pairwise registration function; implements `TrackingMethod`.

    Each frame is registered on a keyframe, which is renewed after 0.1 bundle diameters. The shift is corrected for the
    rolling shutter as that of a steady motion. Frames that are not registered are predicted at constant velocity, then
    lost; a new segment starts with the next two successive frames that register.

    Parameters
    ----------
    calibration : Calibration
        Needs the bundle section; the rolling shutter is corrected where the line periods per frame are known.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    mode : Mode
        Image type to track.
    register : PairwiseRegistration
        ``register(fixed, moving, expected)`` returns a `PairwiseShift`, or None.
    """

    def __init__(
        self, calibration: Calibration, frame_shape: tuple[int, int], mode: Mode, register: PairwiseRegistration
    ) -> None:
        super().__init__(calibration, frame_shape, mode)
        self._register = register
        self._keyframe: _Placed | None = None
        self._last: _Placed | None = None
        self._previous: _Placed | None = None
        self._velocity = _AT_REST
        self._segment = self._frames = 0

    def track(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> tuple[Pose, NDArray[np.float32]]:
        """See :meth:`TrackingMethod.track`."""
        self.prepare_image(raw, raw_residual, self._image)
        return self.estimate_pose(self._image), self._image

    def estimate_pose(self, image: NDArray[np.float32]) -> Pose:
        """See :meth:`TrackingMethod.estimate_pose`."""
        here = _Placed(image.copy(), self._frames)
        self._frames += 1
        if self._keyframe is None:
            self._keyframe = self._last = here
            pose = Pose(0, 0.0, 0.0, _AT_REST, nan, nan, TrackingState.TRACKED)
        else:
            pose = self._continue(here) or self._start_segment(here) or self._predict(here)
        self._previous = here
        return pose

    def _continue(self, here: _Placed) -> Pose | None:
        """Register a frame on the keyframe, which is renewed first if the overlap has shrunk."""
        keyframe, last = self._keyframe, self._last
        assert keyframe is not None
        assert last is not None
        ahead = self._predicted(here, last)
        if hypot(ahead[0] - keyframe.row, ahead[1] - keyframe.col) > KEY_FRAME_REACH * self.grid.diameter:
            keyframe = self._keyframe = last
        return self._registered(keyframe, here, (ahead[0] - keyframe.row, ahead[1] - keyframe.col))

    def _start_segment(self, here: _Placed) -> Pose | None:
        """Start a segment with a frame that registers on the one before, which itself has no position."""
        previous = self._previous
        if previous is None or previous is self._last:
            return None
        pose = self._registered(previous, here, (0.0, 0.0))
        if pose is None:
            return None
        self._segment += 1
        self._keyframe = self._last = here
        return pose._replace(segment=self._segment, row=0.0, col=0.0)

    def _registered(self, fixed: _Placed, here: _Placed, expected: tuple[float, float]) -> Pose | None:
        """Return the pose of a frame from its registration on another; None if it was not registered."""
        if hypot(*expected) > MAX_DISPLACEMENT_DIAMETERS * self.grid.diameter:
            return None
        found = self._register(fixed.image, here.image, expected)
        if found is None:
            return None
        covariance = np.asarray(found.covariance, np.float64)
        if covariance.shape != (2, 2) or not np.isfinite([*found.shift, *covariance.ravel()]).all():
            raise InputError(
                f"the registration returned the shift {found.shift} with covariance {found.covariance}",
                "return finite numbers and a (2, 2) covariance, or None where the images do not determine the shift",
            )
        shutter = self.grid.shutter
        warp = Warp(b=-found.shift[0], d=-found.shift[1])
        self._velocity = velocity = shutter.steady(warp, here.index - fixed.index)
        moved = shutter.displacement(warp, velocity)
        row, col = fixed.row + moved.row, fixed.col + moved.col
        self._last = replace(here, row=row, col=col)
        sigma = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
        return Pose(self._segment, row, col, velocity, found.score, sigma, TrackingState.TRACKED)

    def _predict(self, here: _Placed) -> Pose:
        """Return the pose at constant velocity, or a lost one after too many frames without a registration."""
        last = self._last
        assert last is not None
        if here.index - last.index > PATIENCE_FRAMES:
            return Pose(self._segment, nan, nan, _UNKNOWN, nan, nan, TrackingState.LOST)
        row, col = self._predicted(here, last)
        return Pose(self._segment, row, col, self._velocity, nan, nan, TrackingState.PREDICTED)

    def _predicted(self, here: _Placed, last: _Placed) -> tuple[float, float]:
        gap = here.index - last.index
        return last.row + gap * self._velocity.row, last.col + gap * self._velocity.col
