"""The mosaic of a running engine: copied incrementally from shared memory, and kept after the engine has ended."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.acquisition.mosaic.feed import MosaicFeed
from napari_elsplus.processing.mosaicing.mosaic import Insertion
from napari_elsplus.processing.tracking.front_end.grid import FIELD
from napari_elsplus.viewing.mosaic.mosaics import MosaicScale, without_last_segment
from napari_elsplus.viewing.mosaic.track import max_trackable_px_per_frame

if TYPE_CHECKING:
    from collections.abc import Mapping

    from napari_elsplus.acquisition.mosaic.tracking import TrackState
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.sectioning import Mode
    from napari_elsplus.processing.mosaicing.tiles import Canvas


class LiveMosaicView:
    """A copy of the mosaic in an engine's shared memory, updated on demand.

    Parameters
    ----------
    state : TrackState
        State of the track, from the engine's status.
    calibration : Calibration, optional
        Active in the engine.

    Raises
    ------
    FileNotFoundError
        If the shared memory is gone.
    """

    def __init__(self, state: TrackState, calibration: Calibration | None) -> None:
        self.board, self.calibration = state.board, calibration
        self.plan = plan = state.plan
        diameter = 2 * state.radius_px / FIELD
        self.scale = MosaicScale(
            state.camera_px_per_pixel,
            None if calibration is None else calibration.um_per_px,
            state.radius_px,
            max_trackable_px_per_frame(diameter, state.camera_px_per_pixel, plan.method),
        )
        self._feed: MosaicFeed | None = MosaicFeed(state.board, blended=plan.insertion is Insertion.FEATHERED)
        self.rows = self._feed.rows
        self.canvases: Mapping[Mode, Mapping[int, Canvas]] = {mode: {} for mode in plan.modes}
        self.revision = 0

    @property
    def follows(self) -> bool:
        """True until :meth:`close`."""
        return self._feed is not None

    def update(self, *, all_rows: bool = False) -> bool:
        """Copy what is new, and return True if there was anything; after the engine's end the copy remains.

        Parameters
        ----------
        all_rows : bool
            Copy all new rows of the track; by default a limited number per call.
        """
        feed = self._feed
        try:
            if feed is None or not feed.update(all_rows=all_rows):
                return False
        except FileNotFoundError:  # a part that was never opened
            return False
        self.canvases = {mode: dict(feed.canvases.get(image, {})) for image, mode in enumerate(self.plan.modes)}
        self.revision = feed.revision
        return True

    def undo(self) -> bool:
        """Remove the last segment of a closed copy, and return True if there was one."""
        left = without_last_segment(self.canvases, self.rows)
        if left is None:
            return False
        self.canvases = left
        self.revision += 1
        return True

    def close(self) -> None:
        """Detach from the shared memory; the copy remains."""
        feed, self._feed = self._feed, None
        if feed is not None:
            feed.close()
