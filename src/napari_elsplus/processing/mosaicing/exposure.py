"""Exposure compensation: frames are scaled to the brightness of what they overlap, so that light leaves no seams.

The gain is the ratio of the mean grey levels in the overlap. Noise biases a regression but not this ratio, so that
brightness does not fade along a path of many frames. Of a finished recording of tissue that bleaches, early and late
frames lie side by side: the rate at which its light falls is found from all pairs of frames that overlap. Gains of each
frame would take light that rises across the frames, or haze at one rim, for light that falls along the path.
"""

from __future__ import annotations

from functools import lru_cache
from operator import itemgetter
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.processing.compiled import kernel
from napari_elsplus.processing.mosaicing.deformation.estimation import MAX_HELD, revisits
from napari_elsplus.processing.mosaicing.footprint import rows_on_tile
from napari_elsplus.processing.tracking.front_end.grid import lit_pixels
from napari_elsplus.processing.tracking.motion.pose import Pose, tracked_frames

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.mosaicing.footprint import Arguments
    from napari_elsplus.processing.tracking.front_end.grid import Grid

    Floats = NDArray[np.float64]
    Part = tuple[slice, slice]

MIN_OVERLAP: Final = 0.1
"""Fraction of a frame's weight that must overlap the mosaic for a gain to be estimated; chosen."""
GAIN_LIMITS: Final = (0.5, 2.0)
"""Smallest and largest gain; chosen: beyond a factor of two the overlap is not of the same tissue."""
_DAMPING: Final = 0.9
"""Exponent of the gain; chosen: below 1, so that errors along a path decay instead of adding up without bound."""
ROW_STEP: Final = 2
"""Step of the rows that are compared; chosen: every other row halves the time of a sum over thousands of pixels."""
MIN_SHARED: Final = 0.2
"""Part of the field that two frames have in common, from which they are compared; chosen."""
NEIGHBOURS: Final = (1, 3)
"""How many frames on a frame is compared; chosen: two chains show each other's scatter."""
MIN_FADING: Final = 0.2
"""Fall of the logarithm of the light in a recording from which it is made up for; chosen: less is hardly visible."""
MIN_SIGMAS: Final = 6.0
"""Of that over its uncertainty; chosen."""
_REDUCED: Final = 2
"""Pixels of a frame, in either direction, that are compared as one; chosen, as only means count."""
_OUTLIER_SIGMAS, _ROUNDS, _MIN_PAIRS = 3.0, 4, 10
"""Scale of Cauchy's weights in standard deviations, how often they are renewed, and pairs that are needed; chosen."""


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


def estimate_fading(image: Callable[[int], NDArray[np.float32]], poses: Sequence[Pose], grid: Grid) -> float | None:
    """Return by how much the logarithm of the light falls from frame to frame; None where that is not significant.

    Parameters
    ----------
    image : callable
        Returns the image (side, side) of a frame by its index, valid until the next call.
    poses : sequence of Pose
        Final poses of all frames.
    grid : Grid
        The frames' grid.
    """
    tracked = tracked_frames(poses)
    along = [(a, b) for step in NEIGHBOURS for a, b in zip(tracked, tracked[step:], strict=False)]
    pairs = [(a, b) for a, b in along if poses[a].segment == poses[b].segment] + revisits(poses, tracked, grid.diameter)
    small = (-(-grid.side // _REDUCED),) * 2
    lit = cv2.resize(lit_pixels(*grid.spans()).astype(np.float32), small, interpolation=cv2.INTER_AREA) >= 1

    @lru_cache(MAX_HELD)
    def reduced(index: int) -> NDArray[np.float32]:
        return np.asarray(cv2.resize(image(index), small, interpolation=cv2.INTER_AREA), np.float32)

    terms, ratios = [], []
    for a, b in sorted(pairs, key=itemgetter(1)):  # so that most frames are made once
        apart = (poses[b].at - poses[a].at) * small[0] / grid.side
        here, there = _shared(lit, reduced(a), reduced(b), round(apart.real), round(apart.imag))
        if here.size > MIN_SHARED * lit.sum() and min(here.mean(), there.mean()) > 0:
            terms.append((float(b - a), apart.real, apart.imag))
            ratios.append(float(np.log(here.mean(dtype=np.float64) / there.mean(dtype=np.float64))))
    if len(ratios) < _MIN_PAIRS:
        return None
    rate, sigma = _rate(np.array(terms), np.array(ratios))
    fallen = abs(rate) * (tracked[-1] - tracked[0])
    return rate if fallen > MIN_FADING and abs(rate) > MIN_SIGMAS * sigma else None


def _rate(terms: Floats, ratios: Floats) -> tuple[float, float]:
    """Return the fall of the light per frame, and its standard deviation, by robust least squares.

    Parameters
    ----------
    terms : numpy.ndarray
        (pairs, 3): frames from the first one of a pair to the second, and pixels down and across. Ratios are in
        proportion to these where light rises across the frames.
    ratios : numpy.ndarray
        (pairs,) logarithms of the light of the first one over that of the second.
    """
    weights, noise, rates, normal = np.ones(len(ratios)), 0.0, np.zeros(3), np.eye(3)
    for _ in range(_ROUNDS):
        normal = terms.T @ (weights[:, None] * terms) + 1e-9 * np.eye(3)
        rates = np.asarray(np.linalg.solve(normal, terms.T @ (weights * ratios)), np.float64)
        left = ratios - terms @ rates
        noise = float(np.sqrt(weights @ left**2 / weights.sum()))
        weights = 1 / (1 + np.square(left / max(_OUTLIER_SIGMAS * noise, 1e-9)))
    return float(rates[0]), noise * float(np.sqrt(np.linalg.inv(normal)[0, 0]))


def _shared(
    lit: NDArray[np.bool_], one: NDArray[np.float32], other: NDArray[np.float32], down: int, across: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the lit pixels that two frames share, of both; the other one lies some pixels further down and across."""
    here, there = shared_parts(len(lit), down, across)
    both = lit[here] & lit[there]
    return one[here][both], other[there][both]


def shared_parts(side: int, down: int, across: int) -> tuple[Part, Part]:
    """Return the slices of what two frames share, in the first one and in the second.

    Parameters
    ----------
    side : int
        Rows and columns of a frame.
    down, across : int
        Rows and columns by which the second one lies further.

    Examples
    --------
    >>> shared_parts(9, 2, -1)
    ((slice(2, 9, None), slice(0, 8, None)), (slice(0, 7, None), slice(1, 9, None)))
    """

    def kept(by: int) -> slice:
        return slice(max(0, by), max(0, side + min(0, by)))

    return (kept(down), kept(across)), (kept(-down), kept(-across))
