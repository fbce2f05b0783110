"""Track and mosaics of several modes from a stack, which may be read while they grow."""

from __future__ import annotations

from contextlib import nullcontext
from math import nan
from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.io import TrackTable
from napari_elsplus.processing.images.modes import elsa_pair
from napari_elsplus.processing.images.sectioning import Frames, Mode
from napari_elsplus.processing.mosaicing.coverage import Coverage
from napari_elsplus.processing.tracking.finished.field import FinishedField
from napari_elsplus.processing.tracking.front_end.grid import FIELD
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.viewing.mosaic.growing import GrowingImage
from napari_elsplus.viewing.mosaic.mosaics import MosaicScale, without_last_segment
from napari_elsplus.viewing.mosaic.track import max_trackable_px_per_frame
from napari_elsplus.viewing.mosaic.trackable import TrackableFrames
from napari_elsplus.workflows.core_mosaicing.pipeline import new_finished_pipeline, new_pipeline
from napari_elsplus.workflows.mosaicing import calibration_to_track_by, notes_on
from napari_elsplus.workflows.sectioning import RawPairs

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.mosaicing.tiles import Canvas
    from napari_elsplus.processing.progress import ProgressWrapper
    from napari_elsplus.workflows.mosaic_plan import MosaicPlan
    from napari_elsplus.workflows.tracking import Pipeline


class StackMosaics:
    """Tracks a stack and inserts its frames into mosaics, one for each mode and segment.

    One thread runs it; others may read :attr:`rows` and :attr:`canvases` meanwhile.

    Parameters
    ----------
    frames : Frames
        (T, rows, cols), raw, or finished images.
    calibration : Calibration
        Contains the bundle section; nominal for finished images.
    plan : MosaicPlan
        Modes, method and insertion.
    times_s : sequence of float, optional
        Acquisition time of each frame; by default from the calibration's frame period, where known.
    frame_numbers : sequence of int, optional
        The camera's number of each frame, where gaps are lost frames; none were lost by default.
    finished : bool
        True for finished images, which are tracked at their own resolution; the plan then has one mode, LS.

    Attributes
    ----------
    rows : TrackTable
        Track so far, a row for every frame; another object after loop closure.
    notes : list of str
        Messages for the user.

    Raises
    ------
    InputError
        If there are fewer than two frames, they are constant, or contain NaN.
    CalibrationError
        If the calibration does not fit.
    """

    def __init__(
        self,
        frames: Frames,
        calibration: Calibration,
        plan: MosaicPlan,
        times_s: Sequence[float] | None = None,
        frame_numbers: Sequence[int] | None = None,
        *,
        finished: bool = False,
    ) -> None:
        self.plan, self.calibration = plan, calibration
        self.rows = TrackTable()
        self.notes: list[str] = []
        self.revision = 0
        self._frames = TrackableFrames(frames)
        self._pairs = RawPairs(self._frames, plan.tracked, frame_numbers)
        self._frames.require_contrast()
        self._times_s = times_s
        self._field = FinishedField.of_stack(self._frames) if finished else None
        self._lead = self._pipeline(plan.tracked)
        self._followers = {mode: self._pipeline(mode) for mode in plan.modes if mode is not plan.tracked}
        self._shown: Mapping[Mode, Mapping[int, Canvas]] | None = None

    @property
    def steps(self) -> int:
        """Largest number of steps of :meth:`run`."""
        return (3 if self._followers else 2) * len(self._pairs)

    @property
    def canvases(self) -> Mapping[Mode, Mapping[int, Canvas]]:
        """Segments of each mode, in the order of the plan."""
        if self._shown is not None:
            return self._shown
        makers = {self.plan.tracked: self._lead, **self._followers}
        return {mode: dict(makers[mode].mosaics) for mode in self.plan.modes}

    @property
    def scale(self) -> MosaicScale:
        """Pixel sizes and limits."""
        grid, per_pixel = self._lead.grid, self._lead.camera_px_per_pixel
        per_grid_px = self._lead.camera_px_per_grid_px
        return MosaicScale(
            per_pixel,
            self.calibration.um_per_px,
            0.5 * FIELD * grid.diameter * per_grid_px / per_pixel,
            max_trackable_px_per_frame(grid.diameter, per_grid_px, self.plan.method),
        )

    def compile_kernels(self) -> None:
        """Process two frames and discard the result, so that all kernels are compiled before the viewer needs them."""
        pipeline = self._pipeline(self.plan.tracked)
        for index in range(min(2, len(self._pairs))):
            raw, raw_residual = self._pairs(index)
            pipeline.add(raw, index, raw_residual=raw_residual)
        image = GrowingImage()
        image.update(pipeline.mosaics)
        Coverage(image.frame, self.scale.radius_px).add(np.zeros((1, 2)), np.ones(1))

    def run(self, progress: ProgressWrapper = iter, checkpoint: Callable[[], None] | None = None) -> None:
        """Track and insert all frames, then close loops, join segments, and re-render the mosaics.

        Parameters
        ----------
        progress : callable
            Wraps an iterable of steps; an exception raised in it ends the run, and the mosaics so far remain.
        checkpoint : callable
            Called whenever a frame is read; an exception raised in it ends the run, too.
        """
        with nullcontext() if checkpoint is None else self._frames.with_checkpoint(checkpoint):
            self._run(progress)

    def undo(self) -> bool:
        """Remove the last segment, mark its frames as lost, and return True if there was one."""
        left = without_last_segment(self.canvases, self.rows)
        if left is None:
            return False
        self._shown = left
        self.revision += 1
        return True

    def _run(self, progress: ProgressWrapper) -> None:
        if self._field is None:
            given, plan = self.calibration, self.plan
            self.calibration, self.notes = calibration_to_track_by(
                self._frames, given, self._pairs, plan.tracked, plan.method, self._times_s
            )
            if self.calibration is not given:
                self._lead = self._pipeline(plan.tracked)
                self._followers = {mode: self._pipeline(mode) for mode in self._followers}
        for index in progress(range(len(self._pairs))):
            frame = self._pairs.frame(index)
            raw, raw_residual = self._pairs(index)
            self._lead.skip(self._pairs.lost_before(index))
            self.rows.append(self._lead.add(raw, frame, self._time_s(frame), raw_residual))
            self._follow(self._followers, self._lead.poses[-1], frame)
        self._refine(progress)
        self.notes += notes_on(self._lead)

    def _refine(self, progress: ProgressWrapper) -> None:
        self._shown = self.canvases  # displayed until the re-rendered ones are complete
        self._lead.finish(self._pairs, progress)
        fresh = {mode: self._pipeline(mode) for mode in self._followers}
        if fresh:
            for index in progress(range(len(self._pairs))):
                self._follow(fresh, self._lead.poses[index], self._pairs.frame(index))
        for follower in fresh.values():
            follower.complete()
        self._followers = fresh
        self.rows, self._shown = TrackTable(self._lead.rows), None
        self.revision += 1

    def _follow(self, followers: Mapping[Mode, Pipeline], pose: Pose, frame: int) -> None:
        if pose.state is not TrackingState.TRACKED:
            return
        confocal, residual = elsa_pair(frame)
        for mode, follower in followers.items():
            if mode is not Mode.ELSA:
                follower.insert_raw(pose, self._frames[frame])
            elif frame == confocal and residual < len(self._frames):
                follower.insert_raw(pose, self._frames[confocal], self._frames[residual])

    def _pipeline(self, mode: Mode) -> Pipeline:
        if self._field is not None:
            return new_finished_pipeline(
                self._frames, self.calibration, self.plan.method, self.plan.insertion, field=self._field
            )
        rows, cols = self._frames[0].shape
        return new_pipeline(self.calibration, (rows, cols), mode, self.plan.method, self.plan.insertion)

    def _time_s(self, frame: int) -> float:
        if self._times_s is not None:
            return float(self._times_s[frame])
        period_s = self.calibration.frame_period_s
        return nan if period_s is None else frame * period_s
