"""The mosaic of a running engine, for other processes to see: begun, left at rest, undone, cleared."""

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
        Whose frames are tracked.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._lock = Lock()
        self._track: LiveTrack | None = None
        self._runs = False

    @property
    def state(self) -> TrackState | None:
        """How it goes; None while there is no track."""
        track = self._track
        return None if track is None else replace(track.state, running=self._runs)

    def track(self, plan: MosaicPlan | None) -> None:
        """Begin a new mosaic; None lets the one there is rest, all loops closed.

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
        """Forget the last segment; whether there was one."""
        track = self._track
        return track is not None and track.undo()

    def clear(self) -> None:
        """End tracking, and give its memory back."""
        with self._lock:
            self._engine.track(None)
            track, self._track, self._runs = self._track, None, False
            if track is not None:
                track.close()
