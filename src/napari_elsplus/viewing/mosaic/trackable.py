"""Checks of stacks before tracking."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.processing.analysis.saturation import saturated_part, saturation_note

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.processing.images.sectioning import Frames


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
