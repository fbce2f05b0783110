"""The mosaic of a running engine in shared memory: begun, ended, undone, cleared."""

from __future__ import annotations

from dataclasses import replace
from threading import Lock
from typing import TYPE_CHECKING

from napari_elsplus.acquisition.mosaic.board import MosaicBoard
from napari_elsplus.acquisition.mosaic.tracking import LiveTrack, TrackState
from napari_elsplus.errors import CalibrationError

if TYPE_CHECKING:
    from napari_elsplus.acquisition.engine.engine import Engine
    from napari_elsplus.workflows.mosaic_plan import MosaicPlan


class LiveMosaic:
    """At most one track of an engine, on a board in shared memory.

    Parameters
    ----------
    engine : Engine
        Source of the frames.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._lock = Lock()
        self._track: LiveTrack | None = None
        self._runs = False

    @property
    def state(self) -> TrackState | None:
        """The track at this moment; None while there is none."""
        track = self._track
        return None if track is None else replace(track.state, running=self._runs)

    def track(self, plan: MosaicPlan | None) -> None:
        """Begin a new mosaic by a plan; None ends tracking, all loops closed, and keeps the mosaic.

        Raises
        ------
        CalibrationError
            If the bundle was not located.
        InputError
            If the images cannot be made live.
        DeviceError
            If there is no shared memory left.
        """
        with self._lock:
            if plan is None:
                self._engine.track(None)
                self._runs = False
                if self._track is not None:
                    self._track.settle()
                return
            calibration = self._engine.calibration
            if calibration is None:
                raise CalibrationError("there is no calibration to track by", "calibrate, or load a calibration")
            board = MosaicBoard()
            try:
                track = LiveTrack(calibration, self._engine.setup.frame_shape, plan, board)
            except BaseException:
                board.close()
                raise
            self._engine.track(track)
            before, self._track, self._runs = self._track, track, True
            if before is not None:
                before.close()

    def undo(self) -> bool:
        """Remove the last segment; return True if there was one."""
        track = self._track
        return track is not None and track.undo()

    def clear(self) -> None:
        """End tracking, and release its memory."""
        with self._lock:
            self._engine.track(None)
            track, self._track, self._runs = self._track, None, False
            if track is not None:
                track.close()
