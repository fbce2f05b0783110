"""Light along the laser line, estimated from tissue that several frames show at different columns.

Uneven light moves with the probe: in a mosaic it leaves ramps and edges. The overlap of two tracked frames is the same
tissue under the light of different columns, so that the ratios of its contrast, the standard deviation of its grey
levels by columns, contain the light alone; mean grey levels would contain haze that does not move with the tissue.
Logarithms of the ratios are linear in the light's logarithm, a cosine series along the line, and in the brightness of
each frame, which scatters about a mean: without that a ramp of the light would be one of the tissue.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from napari_elsplus.processing.analysis.uncertainty import estimator_influence
from napari_elsplus.processing.compiled import lean_kernel
from napari_elsplus.processing.mosaicing.exposure import ROW_STEP
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid

    Floats = NDArray[np.float64]

Item = TypeVar("Item")

FRAMES_AND_PAIRS: Final = ((12, 24), (40, 96))
"""Frames that are compared at most, spread evenly over the track, and pairs of them: at first, and where the light may
be uneven; chosen: their ratios determine the light to 1 %, and to a few tenths."""
DISTANCES: Final = (0.1, 0.6)
"""Of the frames of a pair, diameters: along the line at least, and in all at most; chosen: ratios that are off by 2 %
alike give a ramp of 20 % across the field, and of pairs closer to each other more."""
MAX_TURN_RAD: Final = 0.05
"""Between the frames of a pair; chosen: at the rim the tissue is then displaced by six columns."""
COLUMNS: Final = 8
"""Columns whose contrast is compared as one; chosen: several cores."""
MIN_PIXELS: Final = 20
"""From which a contrast is estimated; chosen."""
MAX_LOG_RATIO: Final = 0.7
"""Chosen: beyond a factor of two the overlap is not of the same tissue."""
TERMS: Final = 16
"""Cosines; derived: the shortest half wave is a sixteenth of the field."""
LIGHT_PRIOR: Final = 0.3
"""Standard deviation of each cosine's amplitude, relative; chosen."""
BRIGHTNESS_PRIOR: Final = 0.03
"""Standard deviation of the frames' brightness, relative; chosen, that of an unsteady laser."""
MIN_DEPARTURE: Final = 0.02
"""Root mean square of the light's departure from its mean that is taken out; chosen: less is not visible."""
MIN_SIGMAS: Final = 6.0
"""Of that departure over its uncertainty; chosen."""
OUTLIER_SIGMAS: Final = 4.0
"""Chosen: tissue that moves by itself, and what registration has missed."""


@dataclass(frozen=True, slots=True)
class LineLight:
    """Light along the laser line.

    Parameters
    ----------
    relative : numpy.ndarray
        (side,) float32: light at each column of the grid over its mean in the field.
    departure : float
        Root mean square of its departure from 1.
    uncertainty : float
        One standard deviation of the light, root mean square over the columns.
    """

    relative: NDArray[np.float32]
    departure: float
    uncertainty: float

    @property
    def uneven(self) -> bool:
        """True if the light departs from even light significantly and visibly."""
        return self.departure > max(MIN_DEPARTURE, MIN_SIGMAS * self.uncertainty)


def estimate_line_light(
    image: Callable[[int], NDArray[np.float32]], poses: Sequence[Pose], grid: Grid
) -> LineLight | None:
    """Estimate the light along the line from the overlaps of tracked frames.

    Parameters
    ----------
    image : callable
        Returns the image (side, side) of a frame by its index; it may reuse its memory.
    poses : sequence of Pose
        Of all frames.
    grid : Grid
        Of the images.

    Returns
    -------
    LineLight or None
        None where no frames overlap at different columns.
    """
    light = None
    for frames, pairs in FRAMES_AND_PAIRS:
        light = _compare(_pairs(poses, grid, frames, pairs), image, poses, grid)
        if light is not None and np.hypot(light.departure, light.uncertainty) < MIN_DEPARTURE:
            break
    return light


def _compare(
    pairs: list[tuple[int, int]], image: Callable[[int], NDArray[np.float32]], poses: Sequence[Pose], grid: Grid
) -> LineLight | None:
    """Estimate the light from the overlaps of pairs of frames; None without any."""
    if not pairs:
        return None
    frames, members = np.unique(pairs, return_inverse=True)
    members = members.reshape(-1, 2)
    images = np.empty((len(frames), grid.side, grid.side), np.float32)
    for place, index in zip(images, frames.tolist(), strict=True):
        place[:] = image(index)
    places = np.array([[pose.row, pose.col] for pose in (poses[index] for index in frames)])
    moves = np.rint(places[members[:, 1]] - places[members[:, 0]]).astype(np.int64)
    first, last = grid.spans()
    by_column = np.zeros((len(pairs), 5, -(-grid.side // COLUMNS), COLUMNS))
    _sum_columns(images, members, moves, first, last, by_column.reshape(len(pairs), 5, -1))
    sums = by_column.sum(axis=-1)
    pair, columns = np.nonzero(sums[:, 0] >= MIN_PIXELS)
    pixels, *moments = sums[pair, :, columns].T
    one, two = (_contrast(pixels, *moments[k : k + 2]) for k in (0, 2))
    at = COLUMNS * (columns + 0.5) - 0.5
    terms = np.arange(1, TERMS + 1)
    field = last - first

    def cosines(column: NDArray[np.floating]) -> Floats:
        at_line = np.clip((column[:, None] - grid.centre[1]) / field.max() + 0.5, 0, 1)
        return np.asarray(np.cos(np.pi * terms * at_line), np.float64)

    design = np.zeros((len(pair), TERMS + len(frames)))
    design[:, :TERMS] = cosines(at) - cosines(at - moves[pair, 1])
    design[np.arange(len(pair)), TERMS + members[pair, 0]] = 1
    design[np.arange(len(pair)), TERMS + members[pair, 1]] = -1
    return _fit(design, np.log(one / two), pixels, pair, cosines(np.arange(float(grid.side))), field)


def _pairs(poses: Sequence[Pose], grid: Grid, max_frames: int, max_pairs: int) -> list[tuple[int, int]]:
    """Return indices of tracked frames that overlap at different columns, the earlier one first."""
    tracked = [k for k, pose in enumerate(poses) if pose.state is TrackingState.TRACKED]
    pairs = []
    for a, b in combinations(_spread(tracked, max_frames), 2):
        one, two = poses[a], poses[b]
        along = abs(two.col - one.col) / grid.diameter
        away = np.hypot(two.row - one.row, two.col - one.col) / grid.diameter
        upright = abs(two.angle - one.angle) < MAX_TURN_RAD
        if one.segment == two.segment and upright and along > DISTANCES[0] and away < DISTANCES[1]:
            pairs.append((a, b))
    return _spread(pairs, max_pairs)


def _spread(items: list[Item], count: int) -> list[Item]:
    """Return at most `count` items, spread evenly over the list."""
    return [items[k] for k in np.unique(np.linspace(0, len(items) - 1, count).astype(int))] if items else []


def _contrast(pixels: Floats, total: Floats, squares: Floats) -> Floats:
    """Return the standard deviation of grey levels from their number, their sum and that of their squares."""
    return np.sqrt(np.maximum(squares / pixels - np.square(total / pixels), 1e-6))


def _fit(
    design: Floats,
    values: Floats,
    weights: Floats,
    pair: NDArray[np.intp],
    cosines: Floats,
    field: NDArray[np.int32],
) -> LineLight | None:
    """Solve for the light and the frames' brightness by weighted least squares with their priors.

    Parameters
    ----------
    design, values, weights : numpy.ndarray
        Of the logarithm of each ratio of contrasts: its derivatives by the unknowns, itself, and its weight.
    pair : numpy.ndarray
        Number of its pair, the clusters of the uncertainty.
    cosines : numpy.ndarray
        (side, TERMS).
    field : numpy.ndarray
        (side,) length of each line of the field, by which columns are weighted too: the field is round.
    """
    precision = np.full(design.shape[1], BRIGHTNESS_PRIOR**-2)
    precision[:TERMS] = LIGHT_PRIOR**-2
    used = np.abs(values) < MAX_LOG_RATIO
    noise = MAX_LOG_RATIO
    for _ in range(3):
        if used.sum() <= TERMS:
            return None
        weighted = design * (weights * used / (weights[used].mean() * noise**2))[:, None]
        curvature = weighted.T @ design + np.diag(precision)
        solution = np.linalg.solve(curvature, weighted.T @ values)
        misses = values - design @ solution
        noise = float(np.sqrt(np.average(np.square(misses[used]), weights=weights[used])))
        used = np.abs(misses) < OUTLIER_SIGMAS * noise
    influence = estimator_influence(weighted * misses[:, None], curvature, pair, int(pair.max()) + 1)[:, :TERMS]
    errors = influence @ cosines.T
    light = np.exp(cosines @ solution[:TERMS])
    relative = light / np.average(light, weights=field)
    return LineLight(
        relative.astype(np.float32),
        departure=float(np.sqrt(np.average(np.square(relative - 1), weights=field))),
        uncertainty=float(np.sqrt(np.average(np.square(errors).sum(axis=0), weights=field))),
    )


@lean_kernel
def _sum_columns(
    images: NDArray[np.float32],
    members: NDArray[np.int64],
    moves: NDArray[np.int64],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    sums: Floats,
) -> None:
    """Sum pixels, grey levels and their squares over what the images of each pair share, by columns of the first.

    Parameters
    ----------
    images : numpy.ndarray
        (frames, side, side) float32.
    members, moves : numpy.ndarray
        (pairs, 2): numbers of the images; rows and columns by which the second one's frame lies further.
    first, last : numpy.ndarray
        Of :meth:`Grid.spans`.
    sums : numpy.ndarray
        (pairs, 5, columns) zeros: filled with pixels, grey levels and squares of the first, of the second.
    """
    side = len(first)
    for pair in range(len(members)):
        one, two, down, across = members[pair, 0], members[pair, 1], moves[pair, 0], moves[pair, 1]
        for r in range(max(0, down), min(side, side + down), ROW_STEP):
            begin, end = max(first[r], first[r - down] + across), min(last[r], last[r - down] + across)
            here, there = images[one, r, begin:end], images[two, r - down, begin - across : end - across]
            pixels, light, squares = sums[pair, 0, begin:end], sums[pair, 1, begin:end], sums[pair, 2, begin:end]
            other_light, other_squares = sums[pair, 3, begin:end], sums[pair, 4, begin:end]
            for c in range(end - begin):
                pixels[c] += 1
                light[c] += here[c]
                squares[c] += here[c] * here[c]
                other_light[c] += there[c]
                other_squares[c] += there[c] * there[c]
