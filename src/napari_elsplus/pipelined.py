"""Tracking on two threads: while one frame is linked, the next one's image is made and the last one is laid down."""

from __future__ import annotations

from collections import deque
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

import numpy as np

if TYPE_CHECKING:
    from concurrent.futures import Future
    from types import TracebackType

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking import Pose
    from napari_elsplus.tracking_pipeline import Pipeline

AHEAD: Final = 4
"""Frames that are under way at once: enough that neither thread waits for the other's slowest frame."""


class _UnderWay(NamedTuple):
    pose: Future[Pose]
    image: NDArray[np.float32]
    frame: int
    time_s: float


class Pipelined:
    """Adds frames to a pipeline on two threads; the track and the mosaics are the same, bit for bit, as on one.

    The caller's thread makes the images and lays them down, another one links them; the kernels hold no lock while
    they work. A context manager: on leaving it all frames are in the track, and the other thread has ended.

    Parameters
    ----------
    pipeline : Pipeline
        What the frames are added to; nothing else may be added to it meanwhile, any thread may read it.
    lay : bool
        Whether frames are laid into mosaics as they come, or left to :meth:`Pipeline.finish`.
    """

    def __init__(self, pipeline: Pipeline, *, lay: bool = True) -> None:
        self._pipeline, self._lay = pipeline, lay
        self._linker = ThreadPoolExecutor(1, thread_name_prefix="link")
        self._free = [np.zeros((pipeline.grid.side,) * 2, np.float32) for _ in range(AHEAD)]
        self._under_way: deque[_UnderWay] = deque()

    def add(
        self, raw: NDArray[Any], frame: int, time_s: float = np.nan, raw_residual: NDArray[Any] | None = None
    ) -> None:
        """Take a raw frame, which is free again on return; wait while too many are under way.

        Parameters are those of :meth:`Pipeline.add`. What went wrong in linking an earlier frame is raised here, or on
        leaving the context; frames from that one on are then not in the track.
        """
        while self._under_way and (not self._free or self._under_way[0].pose.done()):
            self._settle()
        image = self._free.pop()
        try:
            self._pipeline.look(raw, image, raw_residual)
        except BaseException:
            self._free.append(image)
            raise
        self._under_way.append(_UnderWay(self._linker.submit(self._pipeline.place, image), image, frame, time_s))

    def wait(self) -> None:
        """Return when all frames that were added are in the track."""
        while self._under_way:
            self._settle()

    def _settle(self) -> None:
        """Put the oldest frame under way into the track."""
        oldest = self._under_way.popleft()
        try:
            pose = oldest.pose.result()
        except BaseException:
            for later in self._under_way:
                later.pose.cancel()
            self._under_way.clear()
            raise
        self._pipeline.keep(oldest.image, pose, oldest.frame, oldest.time_s, lay=self._lay)
        self._free.append(oldest.image)

    def __enter__(self) -> Self:
        """Begin."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End: frames added before something went wrong are in the track, as they would be on one thread."""
        try:
            self.wait()
        finally:
            self._linker.shutdown(cancel_futures=True)
