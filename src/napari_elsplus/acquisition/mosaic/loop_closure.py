"""Loop closure beside the live track, in a thread that never blocks it.

The tracking thread passes nodes of the pose graph on and continues. Here they are registered with earlier ones; once a
loop is closed, the graph is solved, the newest frames are corrected at once, and the tiles with displaced frames are
re-rendered one by one.
"""

from __future__ import annotations

import time
from contextlib import suppress
from functools import lru_cache
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from napari_elsplus.hardware.priority import leave_frame_core
from napari_elsplus.processing.tracking.pose_graph.graph import MAX_NODES, PoseGraph
from napari_elsplus.processing.tracking.pose_graph.nodes import NodeRegistration
from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame, Registrar

if TYPE_CHECKING:
    from collections.abc import Sequence

    from napari_elsplus.processing.mosaicing.keyframe_store import Keyframe
    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.pose_graph.correction import Corrections
    from napari_elsplus.processing.tracking.pose_graph.nodes import Node
    from napari_elsplus.processing.tracking.registration.motion_models import MotionModel

DISPLACEMENT_LIMIT_PX: Final = 0.5
"""Tiles with a frame displaced by more are re-rendered while the probe moves, mosaic pixels; chosen: half a pixel."""
DISPLACEMENT_LIMIT_AT_REST_PX: Final = 0.1
"""The same when the probe rests or the stream has ended; chosen: several times the accuracy of registration."""
RESTING_S: Final = 1.0
"""The probe counts as at rest after this time without a node; chosen: longer than between nodes in motion."""
TIME_SHARE: Final = 0.02
"""Largest share of the time that is spent on solving and re-rendering; chosen: leaves the cores to the stream."""
QUEUE_LIMIT: Final = 4
"""With more nodes waiting than this, the search in other segments is deferred; chosen: less than a second behind."""
_REGISTRATIONS_AT_REST: Final = 100
"""Deferred registrations of each kind in a second at rest; chosen: a few tenths of a second's work."""
_MAX_PREPARED: Final = 64
"""Frames kept prepared for registration; chosen: the neighbours of a node."""
_POLL_S: Final = 0.1
"""Chosen: how often the end of the thread is tested while waiting for it."""


class NewNode(NamedTuple):
    """A new node of the pose graph.

    Parameters
    ----------
    node : Node
        Its pose, as tracked.
    kept : Keyframe or None
        Its image, if there was room for it.
    motion_model : MotionModel
        As selected by the tracker.
    """

    node: Node
    kept: Keyframe | None
    motion_model: MotionModel


class Correctable(Protocol):
    """The live track, as the thread of :class:`LoopClosureThread` corrects it."""

    @property
    def crowded(self) -> bool:
        """True if there are more keyframes than there is room for."""

    def thin(self, corrections: Corrections) -> Sequence[Keyframe]:
        """Discard keyframes by their corrected poses; return those of the tracked image that are left.

        Parameters
        ----------
        corrections : Corrections
            Of the poses.
        """

    def correct(self, corrections: Corrections, limit_px: float, removals: int) -> None:
        """Apply corrections: to frames to come at once, to those so far where any is displaced by more than a limit.

        Parameters
        ----------
        corrections : Corrections
            Of the poses.
        limit_px : float
            Largest displacement that is left, mosaic pixels.
        removals : int
            Segments that were removed before the graph was solved; ignored if there were more since.
        """


class LoopClosureThread(Thread):
    """Registers new nodes of the pose graph with earlier ones, solves it, and corrects the track.

    Parameters
    ----------
    grid : Grid
        Of the tracker.
    track : Correctable
        The track to correct.

    Attributes
    ----------
    count : int
        Edges that close a loop or join segments, so far.
    failed : Exception or None
        Why it ended without :meth:`stop`.
    """

    def __init__(self, grid: Grid, track: Correctable) -> None:
        super().__init__(name="loops", daemon=True)
        self._track = track
        self._registrar = Registrar(grid)
        self._graph = PoseGraph(NodeRegistration(self._registrar), self._view)
        self._kept: dict[int, Keyframe] = {}
        self._prepared = lru_cache(_MAX_PREPARED)(self._prepare)
        self._queue: SimpleQueue[NewNode | Event | int | None] = SimpleQueue()
        self._due_s = 0.0
        self._settled = True
        self._removals = 0
        self._stopped = False
        self.count = 0
        self.failed: Exception | None = None

    def add(self, new: NewNode) -> None:
        """Queue a new node."""
        self._queue.put(new)

    def remove(self, group: int) -> None:
        """Remove a group of nodes: a segment."""
        self._queue.put(group)

    def settle(self) -> None:
        """Return once all nodes queued so far are registered and the track is corrected."""
        done = Event()
        self._queue.put(done)
        while self.is_alive() and not done.wait(_POLL_S):
            pass

    def stop(self) -> None:
        """End after the current node."""
        self._stopped = True
        self._queue.put(None)
        if self.is_alive():
            self.join()

    def run(self) -> None:
        """Work until :meth:`stop`, or a failure."""
        leave_frame_core()  # processing has started it
        try:
            self._work()
        except Exception as error:  # noqa: BLE001 - raised in the tracking thread, which reports it
            self.failed = error

    def _work(self) -> None:
        while not self._stopped:
            try:
                item = self._queue.get(timeout=RESTING_S)
            except Empty:
                self._graph.register_deferred(_REGISTRATIONS_AT_REST)
                self._correct(DISPLACEMENT_LIMIT_AT_REST_PX)
                continue
            if isinstance(item, Event):
                self._graph.register_deferred()
                self._correct(DISPLACEMENT_LIMIT_AT_REST_PX)
                item.set()
            elif isinstance(item, int):
                self._graph.remove(item)
                self._removals += 1
            elif item is not None:
                self._add(item)
            if self._graph.unsolved and time.perf_counter() >= self._due_s:
                self._correct(DISPLACEMENT_LIMIT_PX)

    def _add(self, new: NewNode) -> None:
        """Search for loop closures of a new node."""
        if new.kept is not None:
            self._kept[new.node.frame] = new.kept
        self._graph.add(new.node, new.motion_model, everywhere=self._queue.qsize() <= QUEUE_LIMIT)
        self.count = self._graph.closed
        if self._track.crowded:
            self._kept = {one.frame: one for one in self._track.thin(self._graph.corrections)}
        self._graph.thin(lambda node: node.frame in self._kept)

    def _correct(self, limit_px: float) -> None:
        """Solve the pose graph, and correct the track."""
        if self._settled and not self._graph.unsolved:
            return
        begin_s = time.perf_counter()
        self._graph.solve(MAX_NODES)
        self._track.correct(self._graph.corrections, limit_px, self._removals)
        self._settled = limit_px == DISPLACEMENT_LIMIT_AT_REST_PX
        end_s = time.perf_counter()
        self._due_s = end_s + (end_s - begin_s) * (1 - TIME_SHARE) / TIME_SHARE

    def _view(self, frame: int) -> PreparedFrame | None:
        """Return the prepared frame of a node, if it is still held or its keyframe is."""
        with suppress(KeyError):
            return self._prepared(frame)
        return None

    def _prepare(self, frame: int) -> PreparedFrame:
        kept, view = self._kept[frame], self._registrar.view()
        kept.image(view.image)
        return self._registrar.prepare(view)
