"""Frames brought to the brightness of what they overlap, so that a flickering laser leaves no seams.

The factor is the ratio of the mean grey levels in the overlap: noise does not bias it, as it would a regression, so
that brightness does not fade along a path of many frames.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

MIN_OVERLAP: Final = 0.1
"""Part of a frame's weight that must fall on what is there."""
GAIN_LIMITS: Final = (0.5, 2.0)
_FOLLOWED: Final = 0.9
"""Part of the logarithm that is compensated: what is left keeps errors from adding up without bound."""
ROW_STEP: Final = 2
"""Every how many rows are compared."""


class Overlap(NamedTuple):
    """Sums over the pixels that a frame shares with the canvas, each weighted alike for both."""

    canvas: float
    frame: float
    weight: float


def exposure_gain(overlap: Overlap, whole_weight: float) -> float:
    """Return the factor that brings a frame to the brightness of what it overlaps.

    Parameters
    ----------
    overlap : Overlap
        What it shares with the canvas.
    whole_weight : float
        Weight of the whole frame.

    Examples
    --------
    >>> round(exposure_gain(Overlap(canvas=100.0, frame=80.0, weight=1.0), 2.0), 3)
    1.222
    >>> exposure_gain(Overlap(canvas=100.0, frame=80.0, weight=0.1), 2.0)  # too little to tell
    1.0
    """
    if overlap.weight < MIN_OVERLAP * whole_weight or not (overlap.canvas > 0 and overlap.frame > 0):
        return 1.0
    return float(np.clip(overlap.canvas / overlap.frame, *GAIN_LIMITS) ** _FOLLOWED)


@kernel
def overlap_sums(
    value: NDArray[np.float32],
    weight: NDArray[np.float32],
    tile_top: int,
    tile_left: int,
    image: NDArray[np.float32],
    image_weight: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    centre_row: float,
    centre_col: float,
    row: float,
    col: float,
    stretch: float,
    shear: float,
) -> tuple[float, float, float]:
    """Sum canvas and frame over their common pixels on one tile; every other row, nearest pixels.

    The arguments are those of :func:`napari_elsplus.processing.mosaicing.mosaic.insert_rows`.
    """
    height, width = value.shape
    side = image.shape[0]
    radius = stretch * side
    canvas, frame, both = 0.0, 0.0, 0.0
    for r in range(
        max(0, int(np.floor(row - radius)) - tile_top), min(height, int(np.ceil(row + radius)) + 1 - tile_top), ROW_STEP
    ):
        y = (r + tile_top - row) / stretch
        at = int(np.floor(y + centre_row + 0.5))
        if at < 0 or at >= side:
            continue
        shift = int(np.floor(tile_left + centre_col - col - shear * y + 0.5))
        for k in range(max(0, first[at] - shift), min(width, last[at] - shift)):
            had = weight[r, k]
            if had > 0:
                w = image_weight[at, k + shift] * min(had, np.float32(1))
                canvas += w * value[r, k] / had
                frame += w * image[at, k + shift]
                both += w
    return canvas, frame, both
