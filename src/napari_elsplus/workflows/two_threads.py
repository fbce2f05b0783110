"""Tracking on two threads: while one frame is linked and laid down, the next one's image is made."""

from __future__ import annotations

from collections import deque
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

if TYPE_CHECKING:
    from concurrent.futures import Future
    from types import TracebackType

    from numpy.typing import NDArray

    from napari_elsplus.workflows.tracking import Pipeline

AHEAD: Final = 4
"""Frames that are under way at once: enough that neither thread waits for the other's slowest frame."""


class Pipelined:
    """Adds frames to a pipeline on two threads; the track and the mosaics are the same, bit for bit, as on one.

    The caller's thread makes the images, another one links them and lays them down: the first does little in Python, so
    that the two seldom wait for each other's lock; the kernels hold none while they work. A context manager: on
    leaving it all frames are in the track, and the other thread has ended.

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
        self._images = deque(np.zeros((pipeline.grid.side,) * 2, np.float32) for _ in range(AHEAD))
        self._under_way: deque[Future[None]] = deque()
        self._broken = False

    def add(
        self, raw: NDArray[Any], frame: int, time_s: float = np.nan, raw_residual: NDArray[Any] | None = None
    ) -> None:
        """Take a raw frame, which is free again on return; wait while too many are under way.

        Parameters are those of :meth:`Pipeline.add`. What went wrong in linking an earlier frame is raised here, or on
        leaving the context; frames from that one on are then not in the track.
        """
        while self._under_way and (len(self._under_way) == AHEAD or self._under_way[0].done()):
            self._under_way.popleft().result()
        image = self._images[0]
        self._pipeline.look(raw, image, raw_residual)
        self._images.rotate(-1)
        self._under_way.append(self._linker.submit(self._link, image, frame, time_s))

    def wait(self) -> None:
        """Return when all frames that were added are in the track."""
        while self._under_way:
            self._under_way.popleft().result()

    def _link(self, image: NDArray[np.float32], frame: int, time_s: float) -> None:
        """Put a frame into the track, on the other thread; none after one with which something went wrong."""
        if self._broken:
            return
        self._broken = True
        pose = self._pipeline.place(image)
        self._pipeline.keep(image, pose, frame, time_s, lay=self._lay)
        self._broken = False

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
