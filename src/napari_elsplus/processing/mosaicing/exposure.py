"""Exposure compensation: frames are scaled to the brightness of what they overlap, so that light leaves no seams.

The gain is the ratio of the mean grey levels in the overlap. Noise biases a regression but not this ratio, so that
brightness does not fade along a path of many frames. Of a finished recording the gains of all frames are solved for at
once, over frames that follow one another and those that show a place again, which bounds the drift along the path: of
tissue that bleaches, early and late frames lie side by side.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from napari_elsplus.processing.compiled import kernel
from napari_elsplus.processing.mosaicing.deformation import revisits
from napari_elsplus.processing.mosaicing.footprint import rows_on_tile
from napari_elsplus.processing.tracking.front_end.grid import lit_pixels
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.mosaicing.footprint import Arguments
    from napari_elsplus.processing.tracking.front_end.grid import Grid

    Floats = NDArray[np.float64]

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
MIN_DEPARTURE: Final = 0.05
"""Standard deviation of the logarithms of the gains from which they are made up for; chosen: less is hardly visible."""
MIN_SIGMAS: Final = 6.0
"""Of that over its uncertainty; chosen."""
_REDUCED: Final = 2
"""Pixels of a frame, in either direction, that are compared as one; chosen, as only means count."""
_OUTLIER_SIGMAS, _ROUNDS = 3.0, 4
"""Scale of Cauchy's weights, in robust standard deviations, and how often they are renewed; chosen."""


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


def estimate_frame_gains(
    image: Callable[[int], NDArray[np.float32]], poses: Sequence[Pose], grid: Grid
) -> dict[int, float] | None:
    """Return the factors that bring tracked frames to the light of the first of their segment; None of even light.

    Parameters
    ----------
    image : callable
        Returns the image (side, side) of a frame by its index, valid until the next call.
    poses : sequence of Pose
        Final poses of all frames.
    grid : Grid
        The frames' grid.
    """
    tracked = [k for k, pose in enumerate(poses) if pose.state is TrackingState.TRACKED]
    if len(tracked) <= max(NEIGHBOURS):
        return None
    along = [(a, b) for step in NEIGHBOURS for a, b in zip(tracked, tracked[step:], strict=False)]
    pairs = [(a, b) for a, b in along if poses[a].segment == poses[b].segment] + revisits(poses, tracked, grid.diameter)
    small = (-(-grid.side // _REDUCED),) * 2
    lit = cv2.resize(lit_pixels(*grid.spans()).astype(np.float32), small, interpolation=cv2.INTER_AREA) >= 1
    images = {k: cv2.resize(image(k), small, interpolation=cv2.INTER_AREA) for k in tracked}
    edges, ratios = [], []
    for a, b in pairs:
        apart = (poses[b].at - poses[a].at) * small[0] / grid.side
        here, there = _shared(lit, images[a], images[b], round(apart.real), round(apart.imag))
        if here.size > MIN_SHARED * lit.sum() and min(here.mean(), there.mean()) > 0:
            edges.append((a, b))
            ratios.append(float(np.log(here.mean(dtype=np.float64) / there.mean(dtype=np.float64))))
    number = {k: place for place, k in enumerate(tracked)}
    solved = _solved([(number[a], number[b]) for a, b in edges], np.array(ratios), len(tracked))
    if solved is None:
        return None
    light, sigma = solved
    first = {poses[k].segment: number[k] for k in reversed(tracked)}
    gains = np.array([light[number[k]] - light[first[poses[k].segment]] for k in tracked])
    if gains.std() < max(MIN_DEPARTURE, MIN_SIGMAS * sigma):
        return None
    return dict(zip(tracked, np.exp(gains).tolist(), strict=True))


def _shared(
    lit: NDArray[np.bool_], one: NDArray[np.float32], other: NDArray[np.float32], down: int, across: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the lit pixels that two frames share, of both; the other one lies some pixels further down and across."""
    rows, cols = lit.shape
    if abs(down) >= rows or abs(across) >= cols:
        return one[:0, 0], other[:0, 0]
    here = np.s_[max(0, down) : rows + min(0, down), max(0, across) : cols + min(0, across)]
    there = np.s_[max(0, -down) : rows - max(0, down), max(0, -across) : cols - max(0, across)]
    both = lit[here] & lit[there]
    return one[here][both], other[there][both]


def _solved(edges: list[tuple[int, int]], ratios: Floats, count: int) -> tuple[Floats, float] | None:
    """Return the logarithms of the gains, (count,), and their standard deviation, root mean square; None without edges.

    Parameters
    ----------
    edges : list of tuple of int
        Two frames each.
    ratios : numpy.ndarray
        Of each edge, logarithm of the light of the first over that of the second: gain of the second less the first's.
    count : int
        Of the frames.
    """
    if len(edges) <= count:
        return None
    first, second = np.transpose(edges)
    rows = np.arange(len(edges))
    design = sparse.csr_array((np.ones(len(edges)), (rows, second)), (len(edges), count))
    design = design - sparse.csr_array((np.ones(len(edges)), (rows, first)), (len(edges), count))
    weights, gains, noise = np.ones(len(edges)), np.zeros(count), 0.0
    for _ in range(_ROUNDS):
        normal = design.T @ sparse.diags_array(weights) @ design + 1e-6 * sparse.eye_array(count)
        solver = splu(normal.tocsc())
        gains = solver.solve(design.T @ (weights * ratios))
        left = ratios - design @ gains
        noise = float(np.sqrt(weights @ left**2 / max(len(edges) - count, 1)))
        weights = 1 / (1 + np.square(left / max(_OUTLIER_SIGMAS * noise, 1e-9)))
    ends = np.zeros(count)
    ends[[0, -1]] = -1, 1
    return np.asarray(gains, np.float64), noise * float(np.sqrt(max(ends @ solver.solve(ends), 0.0)))
