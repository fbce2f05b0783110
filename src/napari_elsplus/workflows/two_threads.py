"""Work on two threads: images are computed while others are written, or while the frames before are registered."""

from __future__ import annotations

from itertools import chain, cycle, repeat, starmap
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from napari_elsplus.closing import ClosedOnExit

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator

    from numpy.typing import NDArray

    from napari_elsplus.workflows.tracking import Pipeline

IMAGES_AHEAD: Final = 4
"""Images computed before they are asked for; chosen: the time that the disk takes for a block of them."""


class ComputedAhead(ClosedOnExit):
    """Images (n, n), the next of which a second thread computes while the caller writes one; can be iterated once.

    A context manager: leaving it ends the thread, whoever still holds the iterator.

    Parameters
    ----------
    make : callable
        Makes an image of raw frames, in an array that it leaves alone while `IMAGES_AHEAD` others are made; called by
        the second thread alone.
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
        self._make, self._count = make, count
        self._images = self._generate(frames, threads)

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[NDArray[np.float32]]:
        return self._images

    def close(self) -> None:
        """End the second thread."""
        self._images.close()

    def _generate(self, frames: Iterable[tuple[Any, ...]], threads: int) -> Generator[NDArray[np.float32]]:
        if threads == 1:
            yield from starmap(self._make, frames)
            return
        asked: SimpleQueue[tuple[Any, ...] | None] = SimpleQueue()
        made: SimpleQueue[NDArray[np.float32] | BaseException] = SimpleQueue()
        thread = Thread(target=self._compute, args=(asked, made), name="images")
        thread.start()
        try:
            for number, each in enumerate(chain(frames, repeat(None, IMAGES_AHEAD)), -IMAGES_AHEAD):
                asked.put(each)
                if number >= 0:
                    image = made.get()
                    if isinstance(image, BaseException):
                        raise image
                    yield image
        finally:
            asked.put(None)
            thread.join()

    def _compute(
        self, asked: SimpleQueue[tuple[Any, ...] | None], made: SimpleQueue[NDArray[np.float32] | BaseException]
    ) -> None:
        """Make images, or what goes wrong with one, until there are no frames left."""
        for each in iter(asked.get, None):
            try:
                made.put(self._make(*each))
            except BaseException as error:  # noqa: BLE001 - raised in its place by the caller
                made.put(error)


def tracking_images(
    pipeline: Pipeline, frames: Iterable[tuple[NDArray[Any], NDArray[Any]]], count: int, *, threads: Literal[1, 2] = 2
) -> ComputedAhead:
    """Compute the images by which a pipeline tracks, the next ones while the caller registers one.

    Parameters
    ----------
    pipeline : Pipeline
        Prepares the images; the caller may register them meanwhile.
    frames : iterable of tuple
        Raw frames (rows, cols) of the confocal and of the residual view; read by the caller's thread, some frames
        ahead.
    count : int
        Number of images.
    threads : int
        1 to compute each image when the caller asks for it.

    Returns
    -------
    ComputedAhead
        Images (side, side), each valid until the next one.
    """
    images = cycle(np.zeros((IMAGES_AHEAD + 2, pipeline.grid.side, pipeline.grid.side), np.float32))

    def prepare(raw: NDArray[Any], raw_residual: NDArray[Any]) -> NDArray[np.float32]:
        image: NDArray[np.float32] = next(images)
        pipeline.tracking.prepare_image(raw, raw_residual, image)
        return image

    return ComputedAhead(prepare, frames, count, threads=threads)
