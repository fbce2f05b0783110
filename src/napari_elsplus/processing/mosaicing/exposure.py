"""Exposure compensation: frames are scaled to the brightness of what they overlap, so that flicker leaves no seams.

The gain is the ratio of the mean grey levels in the overlap. Noise biases a regression but not this ratio, so that
brightness does not fade along a path of many frames.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import kernel
from napari_elsplus.processing.mosaicing.footprint import rows_on_tile

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.mosaicing.footprint import Arguments

MIN_OVERLAP: Final = 0.1
"""Fraction of a frame's weight that must overlap the mosaic for a gain to be estimated; chosen."""
GAIN_LIMITS: Final = (0.5, 2.0)
"""Smallest and largest gain; chosen: beyond a factor of two the overlap is not of the same tissue."""
_DAMPING: Final = 0.9
"""Exponent of the gain; chosen: below 1, so that errors along a path decay instead of adding up without bound."""
ROW_STEP: Final = 2
"""Step of the rows that are compared; chosen: every other row halves the time of a sum over thousands of pixels."""


def exposure_gain(canvas: float, frame: float, weight: float, frame_weight: float) -> float:
    """Return the factor that scales a frame to the brightness of what it overlaps.

    Parameters
    ----------
    canvas, frame : float
        Sums of grey levels over the pixels that the frame shares with the canvas, with the same weights for both.
    weight : float
        Sum of these weights.
    frame_weight : float
        Sum of the weights of the whole frame, over the same rows.

    Returns
    -------
    float
        1 where the overlap is too small or dark.

    Examples
    --------
    >>> round(exposure_gain(canvas=100.0, frame=80.0, weight=1.0, frame_weight=2.0), 3)
    1.222
    >>> exposure_gain(canvas=100.0, frame=80.0, weight=0.1, frame_weight=2.0)  # too small an overlap
    1.0
    """
    if weight < MIN_OVERLAP * frame_weight or not (canvas > 0 and frame > 0):
        return 1.0
    return float(np.clip(canvas / frame, *GAIN_LIMITS) ** _DAMPING)


@kernel
def overlap_sums(
    value: NDArray[np.float32],
    weight: NDArray[np.float32],
    top: int,
    left: int,
    image: NDArray[np.float32],
    footprint: Arguments,
) -> tuple[float, float, float]:
    """Sum mosaic and frame over their common pixels on one tile: every other row, nearest pixels.

    Parameters
    ----------
    value, weight : numpy.ndarray
        The tile's arrays, float32.
    top, left : int
        Row and column of the mosaic of the tile's first pixel.
    image : numpy.ndarray
        (side, side) float32.
    footprint : tuple
        :attr:`Footprint.arguments` of the frame.

    Returns
    -------
    tuple of float
        `canvas`, `frame` and `weight` of :func:`exposure_gain`.
    """
    image_weight, first, last, centre_row, centre_col, row, col, stretch, shear = footprint
    height, width = value.shape
    side = image.shape[0]
    canvas, frame, both = 0.0, 0.0, 0.0
    begin_row, end_row = rows_on_tile(footprint, top, height)
    for r in range(begin_row, end_row, ROW_STEP):
        y = (r + top - row) / stretch
        at = int(np.floor(y + centre_row + 0.5))
        if at < 0 or at >= side:
            continue
        shift = int(np.floor(left + centre_col - col - shear * y + 0.5))
        for k in range(max(0, first[at] - shift), min(width, last[at] - shift)):
            had = weight[r, k]
            if had > 0:
                w = image_weight[at, k + shift] * min(had, np.float32(1))
                canvas += w * value[r, k] / had
                frame += w * image[at, k + shift]
                both += w
    return canvas, frame, both
