"""The tracker among the engine's consumers: every frame to the track and into the mosaic."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from napari_elsplus.tracking_pipeline import Pipeline

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.acquisition.ring import Stamp
    from napari_elsplus.calibration import Calibration


class LiveTrack:
    """Tracks live frames by the camera's numbers and times; compiled and touched before the first one comes.

    Parameters
    ----------
    calibration : Calibration
        Needs the bundle section.
    frame_shape : tuple of int
        Rows and columns of the raw frames.

    Attributes
    ----------
    pipeline : Pipeline
        The track, and the mosaics of its segments.

    Raises
    ------
    CalibrationError
        If the bundle was not located, or does not fit the frames.
    """

    def __init__(self, calibration: Calibration, frame_shape: tuple[int, int]) -> None:
        self.pipeline = Pipeline(calibration, frame_shape)
        self._first: Stamp | None = None
        rehearse(Pipeline(calibration, frame_shape), frame_shape)

    def add(self, raw: NDArray[np.uint8], stamp: Stamp) -> None:
        """Track a frame and lay it into the mosaic."""
        self._first = self._first or stamp
        self.pipeline.add(raw, stamp.frame_number - self._first.frame_number, stamp.exposed_s - self._first.exposed_s)


def rehearse(pipeline: Pipeline, frame_shape: tuple[int, int]) -> None:
    """Let a pipeline go once through all that may happen to it: motion, a jump, darkness, and light again."""
    rows, cols = frame_shape
    texture = np.random.default_rng(0).integers(0, 255, (rows + 200, cols), np.uint8)
    texture = cv2.normalize(cv2.GaussianBlur(texture, (0, 0), 6), None, 0, 200, cv2.NORM_MINMAX)
    dark = np.zeros(frame_shape, np.uint8)
    moving = [texture[top : top + rows] for top in (0, 3, 7, 12, 120, 124, 128)]
    half = cols // 2
    for number, raw in enumerate((*moving, *[dark] * 8, *moving)):
        frame = raw.copy()
        frame[:, half:] //= 2  # so that the two views differ, and something is left of their difference
        pipeline.add(frame, number, number / 240)
