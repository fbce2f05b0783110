"""Track and mosaics of several modes from a stack, which may be displayed while they grow."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.processing.mosaicing.coverage import Coverage
from napari_elsplus.processing.tracking.front_end.grid import FIELD
from napari_elsplus.viewing.mosaic.growing import GrowingImage
from napari_elsplus.viewing.mosaic.mosaics import MosaicScale, without_last_segment
from napari_elsplus.viewing.mosaic.track import max_trackable_px_per_frame
from napari_elsplus.viewing.mosaic.trackable import TrackableFrames
from napari_elsplus.workflows.tracked_stack import TrackedStack

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.sectioning import Frames
    from napari_elsplus.workflows.mosaic_plan import MosaicPlan


class StackMosaics(TrackedStack):
    """A stack whose mosaics are displayed while they grow: one thread runs it, others read `rows` and `canvases`.

    Parameters
    ----------
    frames, calibration, plan, times_s, frame_numbers, finished
        As of :class:`TrackedStack`.
    checkpoint : callable
        Called whenever a frame is read; an exception raised in it ends the run.

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
        times_s: Sequence[float] | NDArray[np.float64] | None = None,
        frame_numbers: Sequence[int] | NDArray[np.int64] | None = None,
        *,
        finished: bool = False,
        checkpoint: Callable[[], None] = lambda: None,
    ) -> None:
        trackable = TrackableFrames(frames, checkpoint)
        trackable.require_contrast()
        super().__init__(trackable, calibration, plan, times_s, frame_numbers, finished=finished)

    @property
    def scale(self) -> MosaicScale:
        """Pixel sizes and limits."""
        grid, per_pixel = self.lead.grid, self.lead.camera_px_per_pixel
        per_grid_px = self.lead.camera_px_per_grid_px
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

    def undo(self) -> bool:
        """Remove the last segment, mark its frames as lost, and return True if there was one."""
        left = without_last_segment(self.canvases, self.rows)
        if left is None:
            return False
        self._shown = left
        self.revision += 1
        return True
