"""Loops closed behind the live track: a thread that never keeps it waiting.

The thread that tracks hands over nodes (``pose_graph.keyframes``) and goes on. Here they are
compared with earlier ones; once one shows a place again, all nodes are solved for, the newest frames are corrected at
once, and the tiles on which frames lie wrong are laid anew, one by one.
"""

from __future__ import annotations

import time
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from napari_elsplus.errors import ElsPlusError
from napari_elsplus.processing.tracking.pose_graph.live_graph import LiveGraph
from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame, Registrar
from napari_elsplus.processing.tracking.registration.prepared_frames import RecentFrames

if TYPE_CHECKING:
    from collections.abc import Sequence

    from napari_elsplus.processing.mosaicing.keyframe_store import Keyframe
    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.pose_graph.correction import Corrections
    from napari_elsplus.processing.tracking.pose_graph.keyframes import Node
    from napari_elsplus.processing.tracking.registration.motion_models import MotionModel

OFF_PX: Final = 0.5
"""Frames further than this from where they belong are laid anew while the probe moves; pixels of the mosaic."""
OFF_AT_REST_PX: Final = 0.1
"""The same when it has come to rest, or the stream has ended."""
RESTING_S: Final = 1.0
SHARE: Final = 0.02
"""Part of the time that is spent on solving and laying anew, at most."""
SHORT_OF_TIME: Final = 4
"""With more nodes waiting than this, other segments are not searched."""
_ASKED_AT_REST: Final = 100
"""Links that are asked again in a second, once a turn was noticed: a fifth of a second's work."""
_VIEWS: Final = 64
_PATIENCE_S: Final = 0.1


class Seen(NamedTuple):
    """A node, as it is handed over.

    Parameters
    ----------
    node : Node
        Where the tracker has it.
    kept : Keyframe or None
        Its image, if there was room to keep it.
    rung : MotionModel
        What is modelled beside translations.
    """

    node: Node
    kept: Keyframe | None
    rung: MotionModel


class Correctable(Protocol):
    """The live track, as far as it can be corrected; called from the thread of :class:`LoopClosureThread`."""

    @property
    def crowded(self) -> bool:
        """Whether more frames are kept than there is room for."""

    def thin(self, corrections: Corrections) -> Sequence[Keyframe]:
        """Let go of kept frames; return those of the tracked image that are left."""

    def correct(self, corrections: Corrections, limit_px: float, forgotten: int) -> None:
        """Put frames where they belong: those to come at once, those so far if any lies further from there than that.

        Corrections that do not know yet of the last of so many segments that were forgotten are to be ignored.
        """


class LoopClosureThread(Thread):
    """Closes loops.

    Parameters
    ----------
    grid : Grid
        On which frames are tracked.
    track : Correctable
        What is corrected.

    Attributes
    ----------
    closed : int
        Links that close a loop or join segments, so far.
    failed : ElsPlusError or None
        Why it ended, if not because it was told to.
    """

    def __init__(self, grid: Grid, track: Correctable) -> None:
        super().__init__(name="loops", daemon=True)
        self._track = track
        self._registrar = Registrar(grid)
        self._graph = LiveGraph(self._registrar, self._view)
        self._kept: dict[int, Keyframe] = {}
        self._views = RecentFrames(self._registrar, _VIEWS)
        self._todo: SimpleQueue[Seen | Event | int | None] = SimpleQueue()
        self._due_s = 0.0
        self._news = False
        self._settled = True
        self._forgotten = 0
        self._stopped = False
        self.closed = 0
        self.failed: ElsPlusError | None = None

    def add(self, seen: Seen) -> None:
        """Hand over a node."""
        self._todo.put(seen)

    def forget(self, group: int) -> None:
        """Forget all that lies in a segment."""
        self._todo.put(group)

    def settle(self) -> None:
        """Return once everything that was handed over lies where it belongs."""
        done = Event()
        self._todo.put(done)
        while self.is_alive() and not done.wait(_PATIENCE_S):
            pass

    def stop(self) -> None:
        """End with what is being done."""
        self._stopped = True
        self._todo.put(None)
        if self.is_alive():
            self.join()

    def run(self) -> None:
        """Work until told to stop, or until something fails."""
        try:
            self._work()
        except ElsPlusError as error:
            self.failed = error

    def _work(self) -> None:
        while not self._stopped:
            try:
                item = self._todo.get(timeout=RESTING_S)
            except Empty:
                self._news |= self._graph.ask_again(_ASKED_AT_REST)
                self._correct(OFF_AT_REST_PX)
                continue
            if isinstance(item, Event):
                self._news |= self._graph.ask_again()
                self._correct(OFF_AT_REST_PX)
                item.set()
            elif isinstance(item, int):
                self._graph.forget(item)
                self._forgotten += 1
                self._news = True
            elif item is not None:
                self._take(item)
            if self._news and time.perf_counter() >= self._due_s:
                self._correct(OFF_PX)

    def _take(self, seen: Seen) -> None:
        """Look whether a node shows a place again."""
        if seen.kept is not None:
            self._kept[seen.node.frame] = seen.kept
        self._news |= self._graph.add(seen.node, seen.rung, everywhere=self._todo.qsize() <= SHORT_OF_TIME)
        self.closed = self._graph.closed
        if self._track.crowded:
            self._kept = {one.frame: one for one in self._track.thin(self._graph.corrections)}
        self._graph.thin(lambda node: node.frame in self._kept)

    def _correct(self, limit_px: float) -> None:
        """Solve for all nodes, and put frames where they belong."""
        if self._settled and not self._news:
            return
        begin_s = time.perf_counter()
        self._graph.solve()
        self._track.correct(self._graph.corrections, limit_px, self._forgotten)
        self._news, self._settled = False, limit_px == OFF_AT_REST_PX
        end_s = time.perf_counter()
        self._due_s = end_s + (end_s - begin_s) * (1 - SHARE) / SHARE

    def _view(self, number: int) -> PreparedFrame | None:
        """Return the prepared view of a node, if its frame is still kept."""
        frame = self._graph.nodes[number].frame
        view, kept = self._views.get(frame), self._kept.get(frame)
        return view if view is not None or kept is None else self._views.add(frame, kept.image)
