"""Track and mosaics of several modes from a stack, which may be displayed while they grow."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.processing.analysis.saturation import saturated_part, saturation_note
from napari_elsplus.processing.mosaicing.coverage import Coverage
from napari_elsplus.processing.tracking.front_end.grid import FIELD
from napari_elsplus.viewing.mosaic.growing import GrowingImage
from napari_elsplus.viewing.mosaic.mosaics import MosaicScale, without_last_segment
from napari_elsplus.viewing.mosaic.track import max_trackable_px_per_frame
from napari_elsplus.workflows.tracked_stack import TrackedStack

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.sectioning import Frames
    from napari_elsplus.workflows.mosaic_plan import MosaicPlan


class TrackableFrames:
    """Frames checked when they are read; unusable ones raise an error with their index.

    Parameters
    ----------
    frames : Frames
        (T, rows, cols), raw, or finished images.
    checkpoint : callable
        Called whenever a frame is read; an exception raised in it ends the reading.

    Raises
    ------
    InputError
        If there are fewer than two frames, or a frame is not a finite 2D image.
    """

    def __init__(self, frames: Frames, checkpoint: Callable[[], None]) -> None:
        self._frames, self._checkpoint = frames, checkpoint
        if len(frames) < 2:
            raise InputError(
                f"the stack has {len(frames)} frame{'s' * (len(frames) != 1)}", "choose one of at least two"
            )

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> NDArray[Any]:
        self._checkpoint()
        frame = np.asarray(self._frames[index])
        if frame.ndim != 2:
            raise InputError(f"a frame has shape {frame.shape}", "choose a stack (T, rows, cols) of grey levels")
        if frame.dtype.kind == "f" and not np.isfinite(frame).all():
            raise InputError(f"frame {index} contains NaN or infinity", "replace these values, or choose another stack")
        return frame

    def require_contrast(self) -> None:
        """Raise an error if the first, middle and last frames are constant.

        Raises
        ------
        InputError
            If so.
        """
        chosen = [self[index] for index in sorted({0, len(self) // 2, len(self) - 1})]
        if all(frame.min() == frame.max() for frame in chosen):
            saturated = saturation_note(max(map(saturated_part, chosen)))
            raise InputError(
                f"the frames are constant (grey level {chosen[0].flat[0]:g})",
                saturated or "is the laser on, and the probe on tissue?",
            )


class StackMosaics(TrackedStack):
    """A stack whose mosaics are displayed while they grow: one thread runs it, others read `rows` and `canvases`.

    Parameters
    ----------
    frames, calibration, plan, times_s, frame_numbers, finished
        As of :class:`TrackedStack`; times are by default those of the calibration's frame period, where it is known.
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
        if times_s is None and calibration.frame_period_s is not None:
            times_s = calibration.frame_period_s * np.arange(len(frames), dtype=np.float64)
        super().__init__(trackable, calibration, plan, times_s, frame_numbers, finished=finished)

    @property
    def scale(self) -> MosaicScale:
        """Pixel sizes and limits."""
        grid, per_pixel = self.lead.grid, self.lead.camera_px_per_pixel
        per_grid_px = self.lead.tracking.scale
        return MosaicScale(
            per_pixel,
            self.calibration.um_per_px,
            0.5 * FIELD * grid.diameter * per_grid_px / per_pixel,
            max_trackable_px_per_frame(grid.diameter, per_grid_px, self.plan.method),
        )

    @property
    def untracked(self) -> int:
        """Number of images that were not tracked yet."""
        return len(self._pairs) - len(self.rows)

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
