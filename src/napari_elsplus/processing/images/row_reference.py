"""Row noise of the camera, estimated from the dark pixels of each row and taken off the frame.

Each row of a rolling shutter is read with an offset of its own, common to all of its pixels. Where it fluctuates, a row
beside the laser line may be brighter than the line's rim, and a dark row longer than any line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    Image = NDArray[np.float32]
    Mask = NDArray[np.float32]

MIN_DARK_PIXELS: Final = 8
"""Dark pixels of a row below which there is no reference; chosen: fewer are noisier than what they correct."""
MIN_NOISE_SHARE: Final = 0.5
"""Share of the reference's variance that is row noise, below which frames are left alone; chosen: the reference would
add as much noise as it removes."""
RIM_MARGIN_PX: Final = 8.0
"""Around the bundle views, in pixels; chosen: two cores and the rim's blur."""
MIN_ROWS: Final = 16
"""Rows with a reference below which there is none; chosen: as few as a view of the bundle may have."""
SMOOTH_PX: Final = 5
"""Pixels over which the light is averaged before columns are compared; chosen: a core and its gap."""
DARK_LIGHT: Final = 0.1
"""Part of the brightest columns' light up to which a column counts as dark; chosen."""


def dark_pixels(
    shape: tuple[int, int], discs: Iterable[tuple[tuple[float, float], float]], margin_px: float = RIM_MARGIN_PX
) -> Mask:
    """Return 1 in the pixels outside of the discs, 0 inside, (rows, cols) float32.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the frame.
    discs : iterable of tuple
        Centre (row, col) and diameter in pixels of each.
    margin_px : float
        Around the discs, in pixels.
    """
    row, col = np.ogrid[: shape[0], : shape[1]]
    dark = np.ones(shape, np.float32)
    for centre, diameter_px in discs:
        dark[np.hypot(row - centre[0], col - centre[1]) <= diameter_px / 2 + margin_px] = 0
    return dark


def dark_columns(frame: Image) -> Mask:
    """Return 1 in the columns of a frame (rows, cols) that no light reaches, 0 elsewhere, as wide as the frame."""
    smooth = cv2.blur(frame, (SMOOTH_PX, SMOOTH_PX))
    # Row noise, which all columns share, cancels in the difference to the darkest columns.
    light = np.asarray((smooth - np.percentile(smooth, 2, axis=1, keepdims=True)).max(axis=0), np.float64)
    low, high = np.percentile(light, (1, 90))
    lit = ndimage.binary_dilation(light > low + DARK_LIGHT * (high - low), iterations=SMOOTH_PX)
    return np.broadcast_to((~lit).astype(np.float32), frame.shape)


def without_row_noise(frame: NDArray[np.generic], dark: Mask, background: Image | None = None) -> Image:
    """Return a frame without the row noise that its dark pixels show; unchanged where they show none.

    Parameters
    ----------
    frame : numpy.ndarray
        (rows, cols), any real dtype.
    dark : numpy.ndarray
        1 in dark pixels, 0 elsewhere, (rows, cols) float32.
    background : numpy.ndarray, optional
        Mean frame of the dark tube, (rows, cols), which will be taken off: what it contains is left in the frame.

    Notes
    -----
    Even and odd columns are averaged apart. Their covariance over the rows is the variance of the row noise, whatever
    the noise of the pixels; over the variance of their mean it is the factor by which the reference counts (Wiener).

    Examples
    --------
    >>> random = np.random.default_rng(0)
    >>> noise = random.normal(0, 2, (200, 1))
    >>> frame = 4 + noise + random.normal(0, 0.5, (200, 300))
    >>> left = without_row_noise(frame, np.ones(frame.shape, np.float32))
    >>> bool(left.mean(axis=1).std() < 0.1)
    True
    """
    image = np.asarray(frame, np.float32)
    seen = image if background is None else image - background
    halves, counts = [], []
    for first in (0, 1):
        part, mask = seen[:, first::2], dark[:, first::2]
        counts.append(mask.sum(axis=1))
        halves.append(np.einsum("ij,ij->i", part, mask, dtype=np.float32) / np.maximum(counts[-1], 1))
    known = np.minimum(*counts) >= MIN_DARK_PIXELS / 2
    if np.count_nonzero(known) < MIN_ROWS:
        return image
    even, odd = (np.asarray(half - np.median(half[known]), np.float64) for half in halves)
    mean = (even + odd) / 2
    covariance, variance = float(np.mean(even[known] * odd[known])), float(np.mean(np.square(mean[known])))
    trust = covariance / variance if variance > 0 else 0.0
    if trust < MIN_NOISE_SHARE:
        return image
    return np.asarray(image - np.where(known, trust * mean, 0.0)[:, None], np.float32)
