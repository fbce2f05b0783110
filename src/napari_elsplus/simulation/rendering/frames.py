"""Raw frames that are rendered when they are read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True)
class RenderedFrames:
    """Raw frames (rows, cols) uint8 that are rendered when they are read: a sequence, for one thread at a time.

    Parameters
    ----------
    render : callable
        Returns the frame of an index.
    count : int
        Number of frames.
    """

    render: Callable[[int], NDArray[np.uint8]]
    count: int

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> NDArray[np.uint8]:
        return self.render(range(self.count)[index])

    def __iter__(self) -> Iterator[NDArray[np.uint8]]:
        return (self[index] for index in range(self.count))
