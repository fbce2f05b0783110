"""The image that the virtual camera takes in the rig: every frame another one, in which no two rows are equal."""

from functools import cache

import numpy as np
from numpy.typing import NDArray


def image(frame: int, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the image of a frame by its number, uint8 of a shape of rows and columns."""
    return _pattern(shape) + np.uint8(frame % 256)


@cache
def _pattern(shape: tuple[int, int]) -> NDArray[np.uint8]:
    rows, cols = np.indices(shape)
    return np.asarray((7 * rows + 3 * cols) % 256, np.uint8)
