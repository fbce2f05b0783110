"""Work on two threads: images are computed while others are written, or while the frames before are registered."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice, starmap
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, Self

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from types import TracebackType

    from numpy.typing import NDArray

    from napari_elsplus.workflows.tracking import Pipeline

BATCH: Final = 8
"""Frames handed over at once; chosen: handing over costs a tenth of what a frame does."""
IMAGES_AHEAD: Final = 4
"""Images computed before they are asked for; chosen: the time that the disk takes for a block of them."""
AHEAD: Final = 3 * BATCH
"""Frames in progress at once; chosen so that neither thread waits for the other's slowest frame."""


class ComputedAhead:
    """Images (n, n), the next of which a second thread computes while the caller writes one; can be iterated once.

    Parameters
    ----------
    make : callable
        Makes an image, in an array of its own, of raw frames; called by the second thread alone.
    frames : iterable of tuple
        Arguments of `make` for each image; read by the caller's thread, some images ahead.
    count : int
        Number of images.
    threads : int
        1 to compute each image when the caller asks for it.
    """

    def __init__(
        self,
        make: Callable[..., NDArray[np.float32]],
        frames: Iterable[tuple[Any, ...]],
        count: int,
        *,
        threads: Literal[1, 2] = 2,
    ) -> None:
        self._make, self._frames, self._count, self._threads = make, frames, count, threads

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[NDArray[np.float32]]:
        if self._threads == 1:
            yield from starmap(self._make, self._frames)
            return
        frames = iter(self._frames)
        with ThreadPoolExecutor(1, thread_name_prefix="images") as thread:
            coming = deque(thread.submit(self._make, *each) for each in islice(frames, IMAGES_AHEAD))
            while coming:
                image = coming.popleft().result()
                coming.extend(thread.submit(self._make, *each) for each in islice(frames, 1))
                yield image


class Pipelined:
    """Adds frames to a pipeline on two threads; the track and the mosaics are the same, bit for bit, as on one.

    The caller's thread prepares the images; a second one registers and inserts them, some frames at a time, so that the
    threads seldom wait for each other and an image passes between two cores once. Kernels release the interpreter's
    lock. A context manager: on exit all frames are in the track, and the second thread has ended.

    Parameters
    ----------
    pipeline : Pipeline
        Receives the frames; nothing else may be added to it meanwhile, any thread may read it.
    insert : bool
        True to insert frames as they arrive, False to leave that to :meth:`Pipeline.finish`.
    """

    def __init__(self, pipeline: Pipeline, *, insert: bool = True) -> None:
        self._pipeline, self._insert = pipeline, insert
        self._linker = ThreadPoolExecutor(1, thread_name_prefix="link")
        self._images = deque(np.zeros((pipeline.grid.side,) * 2, np.float32) for _ in range(AHEAD))
        self._batch: list[_Prepared] = []
        self._under_way: deque[Future[None]] = deque()
        self._lost = 0
        self._broken = False

    def skip(self, frames: int) -> None:
        """Take note that images were lost before the next one, as :meth:`Pipeline.skip` does."""
        self._lost += frames

    def add(
        self, raw: NDArray[Any], frame: int, time_s: float = np.nan, raw_residual: NDArray[Any] | None = None
    ) -> None:
        """Add a raw frame, which may be overwritten on return; wait while too many are in progress.

        Parameters are those of :meth:`Pipeline.add`. An error in an earlier frame's registration is raised here, or on
        leaving the context; that frame and those after it are then not in the track.
        """
        while self._under_way and (len(self._under_way) * BATCH == AHEAD or self._under_way[0].done()):
            self._under_way.popleft().result()
        image = self._images[0]
        self._pipeline.prepare_image(raw, image, raw_residual)
        self._images.rotate(-1)
        self._batch.append(_Prepared(image, frame, time_s, self._lost))
        self._lost = 0
        if len(self._batch) == BATCH:
            self._submit()

    def wait(self) -> None:
        """Wait until all frames that were added are in the track."""
        if self._batch:
            self._submit()
        while self._under_way:
            self._under_way.popleft().result()

    def _submit(self) -> None:
        self._under_way.append(self._linker.submit(self._register, self._batch))
        self._batch = []

    def _register(self, batch: list[_Prepared]) -> None:
        """Append some frames to the track, and insert them, on the second thread; none after one that failed."""
        if self._broken:
            return
        self._broken = True
        for image, frame, time_s, lost in batch:
            self._pipeline.skip(lost)
            pose = self._pipeline.estimate_pose(image)
            self._pipeline.append(image, pose, frame, time_s, insert=self._insert)
        self._broken = False

    def __enter__(self) -> Self:
        """Return this object."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for the second thread; frames added before an error are in the track."""
        try:
            self.wait()
        finally:
            self._linker.shutdown(cancel_futures=True)


class _Prepared(NamedTuple):
    """Tracking image of a frame, its number, its time, and how many were lost before it."""

    image: NDArray[np.float32]
    frame: int
    time_s: float
    lost: int
