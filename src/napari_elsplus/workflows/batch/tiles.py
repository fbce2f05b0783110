"""Small pictures of recordings for the contact sheet of a batch, each made by the worker that has the image."""

from __future__ import annotations

from math import ceil
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.io import replacing

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

MAX_SIDE: Final = 256
"""Pixels of a tile's longer side at most; chosen: a sheet of a hundred is then 3000 pixels wide."""
TILE_UM: Final = "tile_um_per_px"
"""Key of a tile's micrometres per pixel in the values of a stage."""


def write_tile(path: Path, image: NDArray[np.float32], um_per_px: float | None) -> float | None:
    """Write an image (rows, cols), reduced and between its own dark and bright levels, to a PNG of 8 bit.

    Parameters
    ----------
    path : pathlib.Path
        The file, replaced if it exists.
    image : numpy.ndarray
        (rows, cols) float32; pixels that are 0 or NaN show nothing and are black.
    um_per_px : float, optional
        Micrometres per pixel of the image.

    Returns
    -------
    float or None
        Micrometres per pixel of the tile.
    """
    step = max(1, ceil(max(image.shape) / MAX_SIDE))
    rows, cols = (max(1, side // step) for side in image.shape)
    seen = np.isfinite(image) & (image != 0)
    low, high = np.quantile(image[seen], (0.01, 0.995)) if seen.any() else (0.0, 1.0)
    grey = np.where(seen, np.clip((image - low) / max(high - low, np.finfo(np.float32).tiny), 0, 1), 0)
    blocks = grey[: rows * step, : cols * step].reshape(rows, min(step, image.shape[0]), cols, -1)
    tile = np.rint(255 * blocks.mean(axis=(1, 3))).astype(np.uint8)
    with replacing(path, force=True) as unfinished:
        unfinished.write_bytes(cv2.imencode(".png", tile)[1].tobytes())
    return None if um_per_px is None else step * um_per_px


def read_tile(path: Path) -> NDArray[np.uint8]:
    """Return a tile, (rows, cols), from the path of its PNG."""
    found: Any = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
    return np.asarray(found, np.uint8)
