"""The tracker among the engine's consumers: every frame to the track and into the mosaic."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.processing.mosaicing.mosaic import Insertion
from napari_elsplus.processing.sectioning import Mode
from napari_elsplus.processing.tracking.grid import FIELD
from napari_elsplus.processing.tracking.tracker import State
from napari_elsplus.tracking_pipeline import Method, Pipeline

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from napari_elsplus.acquisition.mosaic_board import MosaicBoard
    from napari_elsplus.acquisition.ring import Stamp
    from napari_elsplus.calibration import Calibration
    from napari_elsplus.io import TrackPoint

REMEMBERED_FRAMES: Final = 2400
"""Rows of the track that are kept here, where a board has them all: ten seconds."""


@dataclass(frozen=True, slots=True)
class TrackPlan:
    """How the live stream is tracked.

    Parameters
    ----------
    mode : Mode
        Which image is tracked and laid into the mosaic; ELSA, which needs frames by twos, is not made live.
    method : Method
        How the probe is tracked.
    insertion : Insertion
        How frames are laid over one another.
    """

    mode: Mode = Mode.ELS
    method: Method = Method.ELSPLUS
    insertion: Insertion = Insertion.DEAD_LEAF


@dataclass(frozen=True, slots=True)
class TrackState:
    """The live track at one moment.

    Parameters
    ----------
    plan : TrackPlan
        How it is made.
    board : str
        Name of the board in shared memory that holds track and mosaic; empty if they are on the heap.
    camera_px_per_pixel : float
        Camera pixels per pixel of the mosaic.
    radius_px : float
        Of what is used of a frame, pixels of the mosaic.
    counts : mapping of str to int
        Frames by their state.
    newest : TrackPoint or None
        Where the probe was last.
    running : bool
        Whether frames are still laid down.
    """

    plan: TrackPlan
    board: str
    camera_px_per_pixel: float
    radius_px: float
    counts: Mapping[str, int]
    newest: TrackPoint | None
    running: bool = True


class LiveTrack:
    """Tracks live frames by the camera's numbers and times; compiled and touched before the first one comes.

    Parameters
    ----------
    calibration : Calibration
        Needs the bundle section.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    plan : TrackPlan
        How.
    board : MosaicBoard, optional
        Where track and tiles are kept for other processes to see.

    Attributes
    ----------
    pipeline : Pipeline
        The track, and the mosaics of its segments.

    Raises
    ------
    CalibrationError
        If the bundle was not located, or does not fit the frames.
    """

    def __init__(
        self,
        calibration: Calibration,
        frame_shape: tuple[int, int],
        plan: TrackPlan | None = None,
        board: MosaicBoard | None = None,
    ) -> None:
        self._plan = plan = plan or TrackPlan()
        self._board = board
        self._lock = Lock()
        self._origin: tuple[int, float] | None = None
        self._before: Stamp | None = None
        self._counts: dict[int, Counter[str]] = {}
        self._closed = False
        how = {"method": plan.method, "insertion": plan.insertion}
        rehearse(Pipeline(calibration, frame_shape, plan.mode, **how), frame_shape)  # type: ignore[arg-type]
        self.pipeline = Pipeline(
            calibration, frame_shape, plan.mode, method=plan.method, insertion=plan.insertion,
            new_store=None if board is None else board.new_store,
        )  # fmt: skip

    def add(self, raw: NDArray[np.uint8], stamp: Stamp) -> None:
        """Track a frame and lay it into the mosaic."""
        with self._lock:
            if self._closed:
                return
            number, time_s = self._since_the_first(stamp)
            point = self.pipeline.add(raw, number, time_s)
            self._counts.setdefault(point.segment, Counter())[point.state] += 1
            if self._board is None:
                return
            mosaic = self.pipeline.mosaics.get(point.segment)
            dirty = None if mosaic is None else mosaic.take_dirty()
            if dirty is not None:
                self._board.changed(point.segment, dirty)
            self._board.append(point)
            if len(self.pipeline.rows) > REMEMBERED_FRAMES:
                self.pipeline.forget_the_past()  # the board has it all

    def undo(self) -> bool:
        """Forget the last segment, and call its frames lost; whether there was one. Tracking goes on."""
        with self._lock:
            if not self.pipeline.mosaics:
                return False
            last = max(self.pipeline.mosaics)
            self.pipeline.forget(last)
            if self._board is not None:
                self._board.drop(last)
            frames = self._counts.pop(last, Counter()).total()
            self._counts.setdefault(last - 1, Counter())[State.LOST.value] += frames
            return True

    @property
    def state(self) -> TrackState:
        """How it goes."""
        pipeline, plan = self.pipeline, self._plan
        with self._lock:
            board = "" if self._board is None else self._board.name
            counts = dict(sum(self._counts.values(), Counter()))
            newest = pipeline.rows[-1] if pipeline.rows else None
        radius_px = 0.5 * FIELD * pipeline.grid.diameter
        return TrackState(plan, board, pipeline.camera_px_per_pixel, radius_px, counts, newest)

    def close(self) -> None:
        """End, and give the board's memory back."""
        with self._lock:
            self._closed = True
            board, self._board = self._board, None
            self.pipeline.mosaics.clear()
            if board is not None:
                board.close()

    def _since_the_first(self, stamp: Stamp) -> tuple[int, float]:
        """Frames and seconds since the first frame; a stream that was started again goes on where it was."""
        before, self._before = self._before, stamp
        if self._origin is None:
            self._origin = stamp.frame_number, stamp.exposed_s
        elif before is not None and stamp.frame_number <= before.frame_number:
            number, time_s = self.pipeline.rows[-1].frame + 1, self.pipeline.rows[-1].time_s
            pause_s = stamp.time_s - before.time_s
            self._origin = stamp.frame_number - number, stamp.exposed_s - time_s - pause_s
        return stamp.frame_number - self._origin[0], stamp.exposed_s - self._origin[1]


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
