"""The tracker among the engine's consumers: every frame to the track and into the mosaic."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.acquisition.ring import Stamp
    from napari_elsplus.tracking_pipeline import Pipeline


class LiveTrack:
    """Feeds live frames to a pipeline, by the camera's numbers and times.

    Parameters
    ----------
    pipeline : Pipeline
        Tracks, and lays the mosaic.
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline = pipeline
        self._first: Stamp | None = None

    def add(self, raw: NDArray[np.uint8], stamp: Stamp) -> None:
        """Track a frame and lay it into the mosaic."""
        self._first = self._first or stamp
        self.pipeline.add(raw, stamp.frame_number - self._first.frame_number, stamp.exposed_s - self._first.exposed_s)
