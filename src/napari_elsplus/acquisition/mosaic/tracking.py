"""The tracker among the engine's consumers: every frame to the track and into the mosaics, loops closed behind it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.acquisition.mosaic.insertion import AlternatingInsertion, LiveInsertion, TrackedFrame
from napari_elsplus.acquisition.mosaic.loop_closure import LoopClosureThread, Seen
from napari_elsplus.errors import InputError
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.tracking.front_end.grid import FIELD
from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.processing.tracking.pose_graph.correction import Corrections, Path
from napari_elsplus.processing.tracking.pose_graph.keyframes import KeyframeSelector
from napari_elsplus.processing.tracking.registry import tracking_method
from napari_elsplus.workflows.mosaic_plan import MosaicPlan
from napari_elsplus.workflows.tracking import Pipeline

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.acquisition.mosaic.board import MosaicBoard
    from napari_elsplus.acquisition.streaming.ring import Stamp
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.io import TrackPoint
    from napari_elsplus.processing.mosaicing.keyframe_store import Keyframe

REMEMBERED_FRAMES: Final = 2400
"""Rows of the track that are kept here, where a board has them all: ten seconds."""
KEPT_BYTES: Final = 512 << 20
"""Memory for the frames from which the mosaics can be laid anew, of all images together."""


@dataclass(frozen=True, slots=True)
class TrackState:
    """The live track at one moment.

    Parameters
    ----------
    plan : MosaicPlan
        How it is made.
    board : str
        Name of the board in shared memory that holds track and mosaics; empty if they are on the heap.
    camera_px_per_pixel : float
        Camera pixels per pixel of the mosaic.
    radius_px : float
        Of what is used of a frame, pixels of the mosaic.
    counts : mapping of str to int
        Frames by their state.
    newest : TrackPoint or None
        Where the probe was last.
    loops : int
        Links by which places were recognised.
    lays_anew : bool
        Whether there is still memory for frames from which the mosaics can be laid anew.
    running : bool
        Whether frames are still laid down.
    """

    plan: MosaicPlan
    board: str
    camera_px_per_pixel: float
    radius_px: float
    counts: Mapping[str, int]
    newest: TrackPoint | None
    loops: int = 0
    lays_anew: bool = True
    running: bool = True


class LiveTrack:
    """Tracks live frames by the camera's numbers and times; compiled and touched before the first one comes.

    Parameters
    ----------
    calibration : Calibration
        Needs the bundle section.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    plan : MosaicPlan
        Which images, and how. ELSA is laid beside another one, which is tracked: it takes two frames for each image.
    board : MosaicBoard, optional
        Where track and tiles are kept for other processes to see.

    Attributes
    ----------
    pipeline : Pipeline
        The track, and the mosaics of the image that is tracked.

    Raises
    ------
    CalibrationError
        If the bundle was not located, or does not fit the frames.
    InputError
        If ELSA alone is asked for, or nothing.
    """

    def __init__(
        self,
        calibration: Calibration,
        frame_shape: tuple[int, int],
        plan: MosaicPlan | None = None,
        board: MosaicBoard | None = None,
    ) -> None:
        self._plan = plan = plan or MosaicPlan()
        if plan.tracked is Mode.ELSA:
            raise InputError("ELSA takes two frames for each image", "choose LS or ELS+ beside it for the live mosaic")
        self._board = board
        self._lock = Lock()
        self._origin: tuple[int, float] | None = None
        self._before: Stamp | None = None
        self._counts: dict[int, Counter[str]] = {}
        self._closed = False
        self._um_per_px = np.nan if calibration.um_per_px is None else calibration.um_per_px
        how = {"method": plan.method, "insertion": plan.insertion}
        rehearse(Pipeline(calibration, frame_shape, plan.tracked, **how), frame_shape)  # type: ignore[arg-type]
        self._layings = {
            mode: self._laying(calibration, frame_shape, mode, image) for image, mode in enumerate(plan.modes)
        }
        self.pipeline = self._layings[plan.tracked].pipeline
        self._path = Path()
        self._corrections = Corrections()
        self._forgotten = 0
        self._trail = KeyframeSelector(self.pipeline.grid)
        closes_loops = tracking_method(plan.method).closes_loops
        self._closing = LoopClosureThread(self.pipeline.grid, self) if closes_loops else None

    def add(self, raw: NDArray[np.uint8], stamp: Stamp) -> None:
        """Track a frame and lay it into the mosaics."""
        with self._lock:
            if self._closed:
                return
            if self._closing is not None and self._closing.failed is not None:
                raise self._closing.failed
            number, time_s = self._since_the_first(stamp)
            pose, image = self.pipeline.locate(raw)
            place = self._corrections.newest(pose.segment).of(pose)
            self.pipeline.append(image, place, number, time_s, insert=False)
            self._counts.setdefault(place.segment, Counter())[place.state] += 1
            found = TrackedFrame(self._path.add(pose.segment, pose.row, pose.col), number, pose, place)
            self._lay(found, raw, image)
            if self._board is not None:
                self._board.append(self.pipeline.rows[-1])
                if len(self.pipeline.rows) > REMEMBERED_FRAMES:
                    self.pipeline.discard_history()  # the board has it all

    def settle(self) -> None:
        """Return once all loops are closed and all frames lie where they belong."""
        if self._closing is not None and self._closing.ident is not None:
            self._closing.settle()
        with self._lock:
            if self._board is None:
                self.pipeline.relocate(*self._places(slice(0, len(self._path))))

    def undo(self) -> bool:
        """Forget the last segment, and call its frames lost; whether there was one. Tracking goes on."""
        with self._lock:
            if not self.pipeline.mosaics:
                return False
            last = max(self.pipeline.mosaics)
            segments = {s for s in self._path.segments if self._corrections.newest(s).segment == last}
            self.pipeline.discard_segment(last)
            for laying in self._layings.values():
                laying.forget(last, segments)
            self._path.forget(segments)
            self._corrections = self._corrections.without(segments)
            self._forgotten += 1
            if self._closing is not None:
                self._closing.forget(last)
            if self._board is not None:
                self._board.drop(last)
            frames = self._counts.pop(last, Counter()).total()
            self._counts.setdefault(last - 1, Counter())[TrackingState.LOST.value] += frames
            return True

    @property
    def state(self) -> TrackState:
        """How it goes."""
        pipeline = self.pipeline
        with self._lock:
            board = "" if self._board is None else self._board.name
            counts = dict(sum(self._counts.values(), Counter()))
            newest = pipeline.rows[-1] if pipeline.rows else None
            loops = 0 if self._closing is None else self._closing.closed
            lays_anew = not any(laying.kept.full for laying in self._layings.values())
        radius_px = 0.5 * FIELD * pipeline.grid.diameter
        return TrackState(
            self._plan, board, pipeline.camera_px_per_pixel, radius_px, counts, newest, loops, lays_anew
        )  # fmt: skip

    def close(self) -> None:
        """End, and give the board's memory back."""
        if self._closing is not None:
            self._closing.stop()
        with self._lock:
            self._closed, self._closing = True, None  # the two hold each other, and the frames that are kept
            board, self._board = self._board, None
            for laying in self._layings.values():
                laying.pipeline.mosaics.clear()
            if board is not None:
                board.close()

    # what LoopClosureThread asks for

    @property
    def crowded(self) -> bool:
        """Whether more frames are kept than there is room for."""
        return any(laying.kept.needs_thinning for laying in self._layings.values())

    def thin(self, corrections: Corrections) -> Sequence[Keyframe]:
        """Let go of kept frames where there are too many; return those of the tracked image that are left."""
        for laying in self._layings.values():
            laying.thin(corrections, self._lock)
        return self._layings[self._plan.tracked].kept.frames[:]

    def correct(self, corrections: Corrections, limit_px: float, forgotten: int) -> None:
        """Put frames where they belong, unless that was said before the last segment was forgotten."""
        with self._lock:
            if forgotten != self._forgotten or self._closed:
                return
            self._corrections = corrections
        moved = [laying.lay_anew(corrections, limit_px, self._lock) for laying in self._layings.values()]
        with self._lock:
            if forgotten != self._forgotten or self._closed or not any(moved):
                return
            self._leave_what_was_joined()
            blocks = [] if self._board is None else self._board.blocks
        for block in blocks:
            self._relocate(block, forgotten)

    # inside

    def _laying(self, calibration: Calibration, frame_shape: tuple[int, int], mode: Mode, image: int) -> LiveInsertion:
        plan, board = self._plan, self._board
        new_store = None if board is None else partial(board.new_store, image=image)
        pipeline = Pipeline(
            calibration, frame_shape, mode, method=plan.method, insertion=plan.insertion, new_store=new_store
        )  # fmt: skip
        frame_bytes = np.dtype(np.int16).itemsize * pipeline.grid.side**2
        most = KEPT_BYTES // len(plan.modes) // frame_bytes if tracking_method(plan.method).closes_loops else 0
        return (AlternatingInsertion if mode is Mode.ELSA else LiveInsertion)(pipeline, most, board, image)

    def _lay(self, found: TrackedFrame, raw: NDArray[np.uint8], image: NDArray[np.float32]) -> None:
        node = None
        if found.pose.state is TrackingState.TRACKED and self._closing is not None:
            node = self._trail.add(found.frame, found.pose, self.pipeline.newest_registration)
        for mode, laying in self._layings.items():
            tracked = mode is self._plan.tracked
            laying.add(found, raw, image if tracked else None, keep=tracked and node is not None)
            if tracked and node is not None and self._closing is not None:
                self._hand_over(Seen(node, laying.kept.recent(node.frame), self.pipeline.motion_model))

    def _hand_over(self, seen: Seen) -> None:
        assert self._closing is not None
        if self._closing.ident is None:
            self._closing.start()
        self._closing.add(seen)

    def _places(self, those: slice) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Segments, rows and columns of some frames, where they belong."""
        path = self._path
        frames = np.arange(those.start, those.stop)
        return self._corrections.of_frames(frames, path.segment[those], path.row[those], path.col[those])[:3]

    def _relocate(self, block: slice, forgotten: int) -> None:
        """Write a block of rows on the board anew; the lock is held for no longer than that takes."""
        segment, row, col = self._places(block)
        scale = self.pipeline.camera_px_per_pixel
        with self._lock:
            if forgotten == self._forgotten and self._board is not None:
                self._board.relocate(block, segment, row * scale, col * scale, self._um_per_px)

    def _leave_what_was_joined(self) -> None:
        """Forget the mosaics of segments whose frames belong to others now."""
        there = {self._corrections.newest(segment).segment for segment in self._path.segments}
        for group in [group for group in self.pipeline.mosaics if group not in there]:
            for laying in self._layings.values():
                laying.pipeline.mosaics.pop(group, None)
            if self._board is not None:
                self._board.release(group)

    def _since_the_first(self, stamp: Stamp) -> tuple[int, float]:
        """Frames and seconds since the first frame; a stream that was started again goes on where it was."""
        before, self._before = self._before, stamp
        if self._origin is None:
            self._origin = stamp.frame_number, stamp.readout_start_s
        elif before is not None and stamp.frame_number <= before.frame_number:
            number, time_s = self.pipeline.rows[-1].frame + 1, self.pipeline.rows[-1].time_s
            pause_s = stamp.received_s - before.received_s
            self._origin = stamp.frame_number - number, stamp.readout_start_s - time_s - pause_s
        return stamp.frame_number - self._origin[0], stamp.readout_start_s - self._origin[1]


def rehearse(pipeline: Pipeline, frame_shape: tuple[int, int]) -> None:
    """Let a pipeline go once through all that may happen to it: motion, a jump, darkness, light again, a lone fibre.

    What is compiled when it is needed first is compiled here, before frames come.
    """
    rows, cols = frame_shape
    random = np.random.default_rng(0)
    texture = random.integers(0, 255, (rows + 200, cols), np.uint8)
    texture = cv2.normalize(cv2.GaussianBlur(texture, (0, 0), 6), None, 0, 200, cv2.NORM_MINMAX)
    dark = np.zeros(frame_shape, np.uint8)
    moving = [texture[top : top + rows] for top in (0, 3, 7, 12, 120, 124, 128)]
    half = cols // 2
    noise = [random.integers(0, 9, frame_shape, np.uint8) for _ in range(4)]
    fibres = [cv2.line(noise[k], (0, 4 * k), (cols, 4 * k + rows), 200, 7) for k in range(4)]
    for number, raw in enumerate((*moving, *[dark] * 8, *moving, *[dark] * 8, *fibres)):
        frame = raw.copy()
        frame[:, half:] //= 2  # so that the two views differ, and something is left of their difference
        pipeline.add(frame, number, number / 240)
