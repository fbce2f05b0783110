"""The live track: every frame of the engine is tracked and inserted into the mosaics, with loop closure beside."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.acquisition.mosaic.insertion import ElsaInsertion, LiveInsertion, TrackedFrame
from napari_elsplus.acquisition.mosaic.loop_closure import LoopClosureThread, NewNode
from napari_elsplus.acquisition.mosaic.tracked_path import TrackedPath
from napari_elsplus.errors import InputError
from napari_elsplus.hardware.priority import ordinary_priority
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.tracking.front_end.grid import FIELD
from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.processing.tracking.pose_graph.correction import Corrections
from napari_elsplus.processing.tracking.pose_graph.nodes import KeyframeSelector
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

LOCAL_ROWS: Final = 2400
"""Rows of the track that are kept here while a board has them all; chosen: ten seconds at 240 Hz."""
KEYFRAME_BYTES: Final = 512 << 20
"""Memory for the keyframes of all images; chosen: an eighth of 4 GB, minutes of motion."""


@dataclass(frozen=True, slots=True)
class TrackState:
    """The live track at one moment.

    Parameters
    ----------
    plan : MosaicPlan
        As given.
    board : str
        Name of the board in shared memory that holds track and mosaics; empty if they are on the heap.
    camera_px_per_pixel : float
        Camera pixels per pixel of the mosaic.
    radius_px : float
        Radius of the inserted part of a frame, mosaic pixels.
    counts : mapping of str to int
        Frames by their state.
    newest : TrackPoint or None
        Newest position of the probe.
    loop_closures : int
        Edges that close a loop or join segments.
    rerenders : bool
        True while there is memory for keyframes, from which mosaics can be re-rendered.
    running : bool
        True while frames are inserted.
    """

    plan: MosaicPlan
    board: str
    camera_px_per_pixel: float
    radius_px: float
    counts: Mapping[str, int]
    newest: TrackPoint | None
    loop_closures: int = 0
    rerenders: bool = True
    running: bool = True


class LiveTrack:
    """Tracks live frames by the camera's numbers and times; all kernels are compiled before the first frame.

    Parameters
    ----------
    calibration : Calibration
        Needs the bundle section.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    plan : MosaicPlan
        Image types and insertion. ELSA is inserted beside another one, which is tracked: it takes two frames per image.
    board : MosaicBoard, optional
        Holds track and tiles in shared memory.

    Attributes
    ----------
    pipeline : Pipeline
        The track, and the mosaics of the image that is tracked.

    Raises
    ------
    CalibrationError
        If the bundle was not located, or does not fit the frames.
    InputError
        If the plan has no image type, ELSA alone, or an insertion that needs all frames.
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
        if not plan.insertion.while_acquiring:
            raise InputError(
                f"the insertion {plan.insertion.value!r} needs all frames",
                "choose another one for the live mosaic, and this one for the recording",
            )
        self._board = board
        self._lock = Lock()
        self._origin = 0, 0.0
        self._before: Stamp | None = None
        self._counts: dict[int, Counter[str]] = {}
        self._closed = False
        self._um_per_px = np.nan if calibration.um_per_px is None else calibration.um_per_px
        how = {"method": plan.method, "insertion": plan.insertion}
        with ordinary_priority():
            warm_up(Pipeline(calibration, frame_shape, plan.tracked, **how), frame_shape)  # type: ignore[arg-type]
        self._insertions = {
            mode: self._new_insertion(calibration, frame_shape, mode, image) for image, mode in enumerate(plan.modes)
        }
        self.pipeline = self._insertions[plan.tracked].pipeline
        self._path = TrackedPath()
        self._corrections = Corrections()
        self._removals = 0
        self._selector = KeyframeSelector(self.pipeline.grid)
        closes_loops = tracking_method(plan.method).closes_loops
        self._loop_closure = LoopClosureThread(self.pipeline.grid, self) if closes_loops else None

    def add(self, raw: NDArray[np.uint8], stamp: Stamp) -> None:
        """Track a raw frame, and insert it into the mosaics by its stamp."""
        with self._lock:
            if self._closed:
                return
            if self._loop_closure is not None and self._loop_closure.failed is not None:
                raise self._loop_closure.failed
            number, time_s = self._since_first_frame(stamp)
            if self.pipeline.rows:
                self.pipeline.tracking.skip(number - self.pipeline.rows[-1].frame - 1)
            pose, image = self.pipeline.tracking.track(raw, raw)
            place = self._corrections.newest(pose.segment).of(pose)
            self.pipeline.note(place, number, time_s)
            self._counts.setdefault(place.segment, Counter())[place.state] += 1
            found = TrackedFrame(self._path.add(pose.segment, pose.row, pose.col), number, pose, place)
            self._insert(found, raw, image)
            self.pipeline.tracking.discard_registrations()  # the nodes of the pose graph have theirs
            if self._board is not None:
                self._board.append(self.pipeline.rows[-1])
                if len(self.pipeline.rows) > LOCAL_ROWS:
                    self.pipeline.discard_history()  # the board has it all

    def settle(self) -> None:
        """Return once all loops are closed and all frames corrected."""
        if self._loop_closure is not None and self._loop_closure.ident is not None:
            self._loop_closure.settle()
        with self._lock:
            if self._board is None:
                self.pipeline.relocate(*self._places(slice(0, len(self._path))))

    def undo(self) -> bool:
        """Remove the last segment, its frames lost; return True if there was one. Tracking goes on."""
        with self._lock:
            if not self.pipeline.mosaics:
                return False
            last = max(self.pipeline.mosaics)
            segments = {s for s in self._path.segments if self._corrections.newest(s).segment == last}
            self.pipeline.discard_segment(last)
            for insertion in self._insertions.values():
                insertion.remove(last, segments)
            self._path.forget(segments)
            self._corrections = self._corrections.without(segments)
            self._removals += 1
            if self._loop_closure is not None:
                self._loop_closure.remove(last)
            if self._board is not None:
                self._board.drop(last)
            frames = self._counts.pop(last, Counter()).total()
            self._counts.setdefault(last - 1, Counter())[TrackingState.LOST.value] += frames
            return True

    @property
    def state(self) -> TrackState:
        """The track at this moment."""
        pipeline = self.pipeline
        with self._lock:
            board = "" if self._board is None else self._board.name
            counts = dict(sum(self._counts.values(), Counter()))
            newest = pipeline.rows[-1] if pipeline.rows else None
            loop_closures = 0 if self._loop_closure is None else self._loop_closure.count
            rerenders = not any(insertion.kept.full for insertion in self._insertions.values())
        radius_px = 0.5 * FIELD * pipeline.grid.diameter
        return TrackState(
            self._plan, board, pipeline.camera_px_per_pixel, radius_px, counts, newest, loop_closures, rerenders
        )  # fmt: skip

    def close(self) -> None:
        """End, and release the board's memory."""
        if self._loop_closure is not None:
            self._loop_closure.stop()
        with self._lock:
            self._closed, self._loop_closure = True, None  # the two reference each other, and the keyframes
            board, self._board = self._board, None
            for insertion in self._insertions.values():
                insertion.pipeline.mosaics.clear()
            if board is not None:
                board.close()

    # Correctable, for LoopClosureThread

    @property
    def crowded(self) -> bool:
        """True if there are more keyframes than there is room for."""
        return any(insertion.kept.needs_thinning for insertion in self._insertions.values())

    def thin(self, corrections: Corrections) -> Sequence[Keyframe]:
        """Discard keyframes by corrected poses: :meth:`Correctable.thin`."""
        for insertion in self._insertions.values():
            insertion.thin(corrections, self._lock)
        return self._insertions[self._plan.tracked].kept.frames[:]

    def correct(self, corrections: Corrections, limit_px: float, removals: int) -> None:
        """Apply corrections: :meth:`Correctable.correct`."""
        with self._lock:
            if removals != self._removals or self._closed:
                return
            self._corrections = corrections
        moved = [insertion.rerender(corrections, limit_px, self._lock) for insertion in self._insertions.values()]
        with self._lock:
            if removals != self._removals or self._closed or not any(moved):
                return
            self._remove_joined_segments()
            blocks = [] if self._board is None else self._board.blocks
        for block in blocks:
            self._relocate(block, removals)

    # inside

    def _new_insertion(
        self, calibration: Calibration, frame_shape: tuple[int, int], mode: Mode, image: int
    ) -> LiveInsertion:
        plan, board = self._plan, self._board
        new_store = None if board is None else partial(board.new_store, image=image)
        pipeline = Pipeline(
            calibration, frame_shape, mode, method=plan.method, insertion=plan.insertion, new_store=new_store
        )  # fmt: skip
        frame_bytes = np.dtype(np.int16).itemsize * pipeline.grid.side**2
        max_keyframes = (
            KEYFRAME_BYTES // len(plan.modes) // frame_bytes if tracking_method(plan.method).closes_loops else 0
        )
        return (ElsaInsertion if mode is Mode.ELSA else LiveInsertion)(pipeline, max_keyframes, board, image)

    def _insert(self, found: TrackedFrame, raw: NDArray[np.uint8], image: NDArray[np.float32]) -> None:
        nodes = []
        if found.pose.state is TrackingState.TRACKED and self._loop_closure is not None:
            nodes = self._selector.add(found.frame, found.pose, self.pipeline.tracking.newest_registration)
        for mode, insertion in self._insertions.items():
            tracked = mode is self._plan.tracked
            insertion.add(found, raw, image if tracked else None, keep=tracked and bool(nodes))
            for node in nodes if tracked else ():
                self._queue_node(NewNode(node, insertion.kept.recent(node.frame), self.pipeline.tracking.motion_model))

    def _queue_node(self, new: NewNode) -> None:
        assert self._loop_closure is not None
        if self._loop_closure.ident is None:
            self._loop_closure.start()
        self._loop_closure.add(new)

    def _places(self, those: slice) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Return segments, rows and columns of some frames, corrected."""
        path = self._path
        frames = np.arange(those.start, those.stop)
        return self._corrections.of_frames(frames, path.segment[those], path.row[those], path.col[those])[:3]

    def _relocate(self, block: slice, removals: int) -> None:
        """Rewrite a block of rows on the board; the lock is held for that time."""
        segment, row, col = self._places(block)
        scale = self.pipeline.camera_px_per_pixel
        with self._lock:
            if removals == self._removals and self._board is not None:
                self._board.relocate(block, segment, row * scale, col * scale, self._um_per_px)

    def _remove_joined_segments(self) -> None:
        """Remove the mosaics of segments that were joined to others."""
        there = {self._corrections.newest(segment).segment for segment in self._path.segments}
        for group in [group for group in self.pipeline.mosaics if group not in there]:
            for insertion in self._insertions.values():
                insertion.pipeline.mosaics.pop(group, None)
            if self._board is not None:
                self._board.release(group)

    def _since_first_frame(self, stamp: Stamp) -> tuple[int, float]:
        """Return frames and seconds since the first frame; a stream that was started again continues them."""
        before, self._before = self._before, stamp
        rows = self.pipeline.rows
        if before is None or not rows:
            self._origin = stamp.frame_number, stamp.readout_start_s
        elif stamp.frame_number <= before.frame_number:
            number, time_s = rows[-1].frame + 1, rows[-1].time_s
            pause_s = stamp.received_s - before.received_s
            self._origin = stamp.frame_number - number, stamp.readout_start_s - time_s - pause_s
        return stamp.frame_number - self._origin[0], stamp.readout_start_s - self._origin[1]


def warm_up(pipeline: Pipeline, frame_shape: tuple[int, int]) -> None:
    """Process frames of motion, a jump, darkness, light again, too much of it and a lone fibre: compile all kernels.

    Parameters
    ----------
    pipeline : Pipeline
        Not used afterwards.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    """
    rows, cols = frame_shape
    random = np.random.default_rng(0)
    texture = random.integers(0, 255, (rows + 200, cols), np.uint8)
    texture = cv2.normalize(cv2.GaussianBlur(texture, (0, 0), 6), None, 0, 200, cv2.NORM_MINMAX)
    dark = np.zeros(frame_shape, np.uint8)
    moving = [texture[top : top + rows] for top in (0, 3, 7, 12, 120, 124, 128)]
    moving[-1] = np.where(moving[-1] > np.percentile(moving[-1], 95), np.uint8(255), moving[-1])
    half = cols // 2
    noise = [random.integers(0, 9, frame_shape, np.uint8) for _ in range(4)]
    fibres = [cv2.line(noise[k], (0, 4 * k), (cols, 4 * k + rows), 200, 7) for k in range(4)]
    for number, raw in enumerate((*moving, *[dark] * 8, *moving, *[dark] * 8, *fibres)):
        frame = raw.copy()
        frame[:, half:] //= 2  # so that the two views differ, and something is left of their difference
        pipeline.add(frame, number, number / 240)
