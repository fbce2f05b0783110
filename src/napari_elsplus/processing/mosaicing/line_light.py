"""Light along the laser line and over its scan, estimated from tissue that several frames show at different places.

Uneven light moves with the probe: in a mosaic it leaves ramps and edges. The overlap of two tracked frames is the same
tissue under the light of different columns and rows, so that the ratios of its contrast, the standard deviation of its
grey levels by columns and by rows, contain the light alone; mean grey levels would contain haze that does not move with
the tissue. Logarithms of the ratios are linear in the light's logarithm, a cosine series along the line plus one over
the scan, and in the brightness of each frame, which scatters about a trend: without that a ramp of the light would be
one of the tissue. Where the probe moves one way while the laser loses power, a ramp and a trend give the same ratios;
the contrast of whole frames tells them apart, as well as fields of tissue are alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Final, NamedTuple, TypeVar

import numpy as np

from napari_elsplus.processing.analysis.uncertainty import estimator_influence
from napari_elsplus.processing.mosaicing.exposure import ROW_STEP, shared_parts
from napari_elsplus.processing.tracking.motion.pose import Pose, tracked_frames

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
"""Of the frames of a pair, diameters: along the line or the scan at least, and in all at most; chosen: ratios that are
off by 2 % alike give a ramp of 20 % across the field, and of pairs closer to each other more."""
MAX_TURN_RAD: Final = 0.05
"""Between the frames of a pair; chosen: at the rim the tissue is then displaced by six columns."""
BLOCK_PX: Final = 8
"""Columns, and rows, whose contrast is compared as one; chosen: several cores."""
MIN_PIXELS: Final = 20
"""From which a contrast is estimated; chosen."""
MAX_LOG_RATIO: Final = 0.7
"""Chosen: beyond a factor of two the overlap is not of the same tissue."""
TERMS: Final = 16
"""Cosines along the line; derived: the shortest half wave is a sixteenth of the field."""
SCAN_TERMS: Final = 6
"""Cosines over the scan; chosen: mirrors and lenses let light fall smoothly, while a line has ripples; with four a ramp
of 80 % is left by 1.6 %, with six by 0.6 % (four scenes of the tests)."""
LIGHT_PRIOR: Final = 0.3
"""Standard deviation of each cosine's amplitude, relative; chosen."""
BRIGHTNESS_PRIOR: Final = 0.03
"""Standard deviation of the frames' brightness, relative, at least; chosen, that of an unsteady laser. That found is
taken where it is larger, as where contact or focus changes."""
TISSUE_CONTRAST: Final = 0.2
"""Relative standard deviation of the contrast of fields of tissue that do not overlap, at least; chosen."""
MIN_DEPARTURE: Final = 0.02
"""Root mean square of the light's departure from its mean that is taken out; chosen: less is not visible."""
MIN_SIGMAS: Final = 6.0
"""Of that departure over its uncertainty; chosen."""
OUTLIER_SIGMAS: Final = 4.0
"""Chosen: tissue that moves by itself, and what registration has missed."""
_PARTS: Final = slice(TERMS), slice(TERMS, TERMS + SCAN_TERMS)
"""The solution's cosines along the line, and those over the scan."""


@dataclass(frozen=True, slots=True)
class LineLight:
    """Light of the laser line where it stands while each pixel is read.

    Parameters
    ----------
    relative : numpy.ndarray
        (side, side) float32: light at each pixel of the grid over its mean in the field, a product of one factor for
        each column and one for each row; 1 beyond the field.
    departure : float
        Root mean square of its departure from 1 in the field.
    uncertainty : float
        One standard deviation of the light, root mean square over the field.
    spread : tuple of float
        Fifth and ninety-fifth percentile of the light over its mean in the field.
    even_parts : tuple of slice
        Cosines of the factors, of columns or of rows, that do not depart from even light by themselves.
    """

    relative: NDArray[np.float32]
    departure: float
    uncertainty: float
    spread: tuple[float, float]
    even_parts: tuple[slice, ...] = ()

    @property
    def uneven(self) -> bool:
        """True if the light departs from even light significantly and visibly."""
        return _departs(self.departure, self.uncertainty)


def _departs(departure: float, uncertainty: float) -> bool:
    """Return True if light departs from even light significantly and visibly."""
    return departure > max(MIN_DEPARTURE, MIN_SIGMAS * uncertainty)


def estimate_line_light(
    image: Callable[[int], NDArray[np.float32]], poses: Sequence[Pose], grid: Grid
) -> LineLight | None:
    """Estimate the light of the line from the overlaps of tracked frames.

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
        None where no frames overlap at different columns or rows.
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
    columns = np.arange(float(grid.side))
    lit = (columns >= first[:, None]) & (columns < last[:, None])
    extent = float((last - first).max())
    waves = [_cosines(columns, grid.centre[1], extent, TERMS), _cosines(columns, grid.centre[0], extent, SCAN_TERMS)]
    blocks = -(-grid.side // BLOCK_PX)
    sums = np.zeros((2, len(pairs), 5, blocks * BLOCK_PX))
    for k, move in enumerate(moves):
        sums[:, k, :, : grid.side] = _overlap_sums(images[members[k]], lit, move)
    sums = sums.reshape(2, len(pairs), 5, blocks, BLOCK_PX).sum(axis=-1)
    parts = [_ratios(each) for each in sums]
    designs = [
        np.concatenate([_changes(waves, lit, move, axis) for move in moves]).reshape(len(pairs), blocks, -1)[
            pair, block
        ]
        for axis, (pair, block, _, _) in enumerate(parts)
    ]
    pair, _, pixels, values = (np.concatenate(each) for each in zip(*parts, strict=True))
    trend = _trend(frames, np.log(images[:, lit].std(axis=1) + 1e-6), places, grid.diameter)
    light_terms = TERMS + SCAN_TERMS
    design = np.zeros((len(pair), light_terms + len(frames) + 1))
    design[:, -1] = frames[members[pair, 0]] - frames[members[pair, 1]]
    values = values - design[:, -1] * trend.expected
    design[:, :light_terms] = np.concatenate(designs)
    design[np.arange(len(pair)), light_terms + members[pair, 0]] = 1
    design[np.arange(len(pair)), light_terms + members[pair, 1]] = -1
    apart = (np.abs(moves) / grid.diameter > DISTANCES[0]).any(axis=0)
    for part, known in zip(_PARTS, apart[::-1], strict=True):
        design[:, part] *= known
    light = _fit(design, values, pixels, pair, waves, lit, trend)
    if light is not None and light.uneven and len(light.even_parts) == 1:
        design[:, light.even_parts[0]] = 0
        return _fit(design, values, pixels, pair, waves, lit, trend)
    return light


class _Trend(NamedTuple):
    """Logarithm of the brightness per frame: its expected value, and one standard deviation."""

    expected: float
    sigma: float


def _trend(frames: NDArray[np.intp], contrast: Floats, places: Floats, diameter: float) -> _Trend:
    """Return the trend of the contrast of whole frames, of which those that overlap show the same tissue.

    Parameters
    ----------
    frames : numpy.ndarray
        Indices of the frames, ascending.
    contrast : numpy.ndarray
        Logarithm of the standard deviation of the grey levels of each.
    places : numpy.ndarray
        (frames, 2) where they lie.
    diameter : float
        Of a frame.
    """
    from_middle = frames - frames.mean()
    slope = float(from_middle @ contrast / (from_middle @ from_middle))
    scatter = max(float(np.std(contrast - slope * from_middle)), TISSUE_CONTRAST)
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    fields = np.sum(1 / (apart < diameter).sum(axis=1))
    return _Trend(slope, float(scatter / from_middle.std() / np.sqrt(fields)))


def _cosines(at: Floats, centre: float, extent: float, terms: int) -> Floats:
    """Return the cosines of a series at places along one axis of the field, (places, terms)."""
    along = np.clip((at[:, None] - centre) / extent + 0.5, 0, 1)
    return np.asarray(np.cos(np.pi * np.arange(1, terms + 1) * along), np.float64)


def _ratios(sums: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats, Floats]:
    """Return pair, block, pixels and logarithm of the ratio of contrasts, of each block of an overlap that has enough.

    Parameters
    ----------
    sums : numpy.ndarray
        (pairs, 5, blocks), of :func:`_overlap_sums`.
    """
    pair, block = np.nonzero(sums[:, 0] >= MIN_PIXELS)
    pixels, *moments = sums[pair, :, block].T
    one, two = (_contrast(pixels, *moments[k : k + 2]) for k in (0, 2))
    return pair, block, pixels, np.log(one / two)


def _changes(waves: list[Floats], lit: NDArray[np.bool_], move: NDArray[np.int64], axis: int) -> Floats:
    """Return the mean change of each cosine from the second to the first frame, by blocks of their overlap.

    Parameters
    ----------
    waves : list of numpy.ndarray
        Cosines along the line and over the scan, (side, terms) each.
    lit : numpy.ndarray
        (side, side) bool: the field.
    move : numpy.ndarray
        Rows and columns by which the second frame lies further.
    axis : int
        0 for blocks of columns, 1 for blocks of rows.

    Returns
    -------
    numpy.ndarray
        (blocks, terms of both).
    """
    side = len(lit)
    down, across = (int(each) for each in move)
    overlap = np.zeros_like(lit)
    to, back = shared_parts(side, down, across)
    overlap[to] = lit[to] & lit[back]
    line, scan = (
        wave - wave[np.clip(np.arange(side) - by, 0, side - 1)] for wave, by in zip(waves, (across, down), strict=True)
    )
    own, other = (line, scan) if axis == 0 else (scan, line)
    count = overlap.sum(axis=axis)
    starts = np.arange(0, side, BLOCK_PX)
    pixels = np.maximum(np.add.reduceat(count, starts), 1)[:, None]
    by_other = (overlap.T if axis == 0 else overlap).astype(np.float64) @ other
    own_mean = np.add.reduceat(own * count[:, None], starts) / pixels
    other_mean = np.add.reduceat(by_other, starts) / pixels
    return np.concatenate([own_mean, other_mean] if axis == 0 else [other_mean, own_mean], axis=1)


def _pairs(poses: Sequence[Pose], grid: Grid, max_frames: int, max_pairs: int) -> list[tuple[int, int]]:
    """Return indices of tracked frames that overlap at different columns or rows, the earlier one first."""
    tracked = tracked_frames(poses)
    pairs = []
    for a, b in combinations(_spread(tracked, max_frames), 2):
        one, two = poses[a], poses[b]
        apart = max(abs(two.col - one.col), abs(two.row - one.row)) / grid.diameter
        away = np.hypot(two.row - one.row, two.col - one.col) / grid.diameter
        upright = abs(two.angle - one.angle) < MAX_TURN_RAD
        if one.segment == two.segment and upright and apart > DISTANCES[0] and away < DISTANCES[1]:
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
    waves: list[Floats],
    lit: NDArray[np.bool_],
    trend: _Trend,
) -> LineLight | None:
    """Solve for the light and the frames' brightness by weighted least squares with their priors.

    Parameters
    ----------
    design, values, weights : numpy.ndarray
        Of the logarithm of each ratio of contrasts: its derivatives by the unknowns, itself, and its weight.
    pair : numpy.ndarray
        Number of its pair, the clusters of the uncertainty.
    waves : list of numpy.ndarray
        Cosines along the line and over the scan, (side, terms) each.
    lit : numpy.ndarray
        (side, side) bool: the field.
    trend : _Trend
        Of the frames' brightness, whose expected value was subtracted.
    """
    light_terms = TERMS + SCAN_TERMS
    precision = np.full(design.shape[1], BRIGHTNESS_PRIOR**-2)
    precision[:light_terms] = LIGHT_PRIOR**-2
    precision[-1] = trend.sigma**-2
    used = np.abs(values) < MAX_LOG_RATIO
    noise = MAX_LOG_RATIO
    for _ in range(3):
        if used.sum() <= light_terms:
            return None
        weighted = design * (weights * used / (weights[used].mean() * noise**2))[:, None]
        curvature = weighted.T @ design + np.diag(precision)
        solution = np.linalg.solve(curvature, weighted.T @ values)
        misses = values - design @ solution
        precision[light_terms:-1] = 1 / max(BRIGHTNESS_PRIOR**2, float(np.square(solution[light_terms:-1]).mean()))
        noise = float(np.sqrt(np.average(np.square(misses[used]), weights=weights[used])))
        used = np.abs(misses) < OUTLIER_SIGMAS * noise
    influence = estimator_influence(weighted * misses[:, None], curvature, pair, int(pair.max()) + 1)
    of_prior = np.sqrt(precision * design.any(axis=0))[:, None] * np.linalg.inv(curvature)
    influence = np.concatenate([influence, of_prior])
    line, scan = (wave @ solution[part] for wave, part in zip(waves, _PARTS, strict=True))
    line_errors, scan_errors = (wave @ influence[:, part].T for wave, part in zip(waves, _PARTS, strict=True))
    light = np.exp(scan[:, None] + line)
    relative = np.where(lit, light / light[lit].mean(), 1)
    along, over = np.square(line_errors).sum(axis=1), np.square(scan_errors).sum(axis=1)
    squares = over[:, None] + along + 2 * scan_errors @ line_errors.T
    even_parts = []
    for part, factor, variance, axis in zip(_PARTS, (line, scan), (along, over), (0, 1), strict=True):
        field = lit.sum(axis=axis)
        departure = np.sqrt(np.average(np.square(factor - np.average(factor, weights=field)), weights=field))
        if not _departs(float(departure), float(np.sqrt(np.average(variance, weights=field)))):
            even_parts.append(part)
    return LineLight(
        relative.astype(np.float32),
        departure=float(np.sqrt(np.square(relative[lit] - 1).mean())),
        uncertainty=float(np.sqrt(squares[lit].mean())),
        spread=(float(np.percentile(relative[lit], 5)), float(np.percentile(relative[lit], 95))),
        even_parts=tuple(even_parts),
    )


def _overlap_sums(pair: NDArray[np.float32], lit: NDArray[np.bool_], move: NDArray[np.int64]) -> Floats:
    """Return pixels, grey levels and their squares of what two images share, by columns and by rows of the first.

    Parameters
    ----------
    pair : numpy.ndarray
        (2, side, side) float32: both images.
    lit : numpy.ndarray
        (side, side) bool: the field.
    move : numpy.ndarray
        Rows and columns by which the second one lies further.

    Returns
    -------
    numpy.ndarray
        (2, 5, side): pixels, grey levels and squares of the first, of the second.
    """
    side = len(lit)
    to, back = shared_parts(side, *move.tolist())
    both = lit[to] & lit[back]
    both[1::ROW_STEP] = False
    here, there = np.where(both, pair[0][to], 0), np.where(both, pair[1][back], 0)
    sums = np.zeros((2, 5, side))
    for k, term in enumerate((both, here, here * here, there, there * there)):
        for axis in (0, 1):
            sums[axis, k, to[1 - axis]] = term.sum(axis=axis, dtype=np.float64)
    return sums
