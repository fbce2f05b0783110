"""Circle through the rim of a lit disc, followed around at half level.

Where a dark target covers the rim, its edge appears too far inside, never too far outside. The circle is therefore
fitted to the largest consistent set of points, not to the middle of all.

A rim is a ragged row of cores: where the circle happens to cut the lattice between two rows of it, the half level lies
inside. The outermost cores determine the circle's centre with less uncertainty than the middle of all; its diameter
is by definition that at half level.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
import scipy

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.analysis.uncertainty import estimator_influence, robust_sigma
from napari_elsplus.processing.images.distortion import polynomial_terms

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

ARCS: Final = 36
"""Clusters of the circle's uncertainty; chosen: each arc is wider than several cores."""
COMMON_ERROR: Final = 0.08
"""Of the rim's roughness: the error of its half level that all arcs share; measured on 60 random rigs (seeds 700 to
759): diameters are 0.07 px too small in their mean, and 1.0 standard deviations off, RMS (with 0.05, 1.2)."""
MIN_CONSISTENT: Final = 0.4
"""Share of the points that must lie on the true rim; chosen: structured targets cover up to half of it."""
HALF_LEVEL: Final = 0.5
"""By the definition of the diameter."""
FOOT_LEVEL: Final = 0.2
"""At which the outermost cores end; chosen, above noise and stray light."""
NEAR_EDGE: Final = 0.03
"""Distance of an edge from a circle, over the radius, at which it counts as the circle's; chosen."""
MAX_RAYS, RAY_STEP_PX = 1440, 0.25
"""Rays from the centre on which the edge is followed, and the step along them; chosen: finer than any core."""
SAMPLES: Final = 60
"""Along the radius, to which the light is fitted; chosen: thousands for the six terms of a quadratic."""
MAX_STEPS, CONVERGED_PX = 50, 1e-3
"""Steps of a fit at most, and the last one; chosen, far below the uncertainty."""
EXPECTILE: Final = 0.98
"""Weight of a point outside the circle, against 0.02 inside; chosen: the circle passes the outermost cores."""


def fit_rim(frame: Image, circle: Floats) -> tuple[Floats, Floats, float]:
    """Fit a circle to the half level of a lit disc, starting from one that is correct to a few percent.

    Parameters
    ----------
    frame : numpy.ndarray
        (rows, cols) float32.
    circle : numpy.ndarray
        Row, column and radius to start from.

    Returns
    -------
    circle : numpy.ndarray
        Row, column and radius.
    uncertainty : numpy.ndarray
        One standard deviation of each, shape (3,).
    seen : float
        Share of the circumference on which the rim was found.

    Raises
    ------
    MeasurementError
        If no rim is seen on most of the circumference.
    """
    _refuse_other_than_disc(circle, frame)
    even = _evenly_lit(frame, circle)
    smooth = _smoothed(even, circle)
    uncertainty, seen = np.zeros(3), 0.0
    for reach in (0.25, 0.1, 0.1):
        points, arcs, rays = _edge(smooth, circle, reach, HALF_LEVEL)
        if len(points) < max(ARCS, rays // 6):
            raise MeasurementError(
                f"no bundle: a rim is seen on {100 * len(points) / rays:.0f} % of a circle",
                "is the probe lit from the far end, and the bundle in view?",
            )
        circle, by_arcs, left = _fit_circle(points, arcs, circle)
        _refuse_other_than_disc(circle, frame)
        uncertainty, seen = np.hypot(by_arcs, COMMON_ERROR * left.std()), len(left) / rays
    fine = cv2.GaussianBlur(even, (0, 0), max(0.6, float(circle[2]) / 300))
    points, arcs, _ = _edge(fine, circle, 0.06, FOOT_LEVEL)
    if len(points) >= ARCS:
        outermost, by_arcs, _ = _fit_circle(points, arcs, circle, EXPECTILE)
        if by_arcs[:2].max() < uncertainty[:2].max():
            circle[:2], uncertainty[:2] = outermost[:2], by_arcs[:2]
    return circle, uncertainty, seen


def _refuse_other_than_disc(circle: Floats, frame: Image) -> None:
    if not min(frame.shape) / 4 < circle[2] < max(frame.shape):
        raise MeasurementError("no bundle: the lit area is no disc", "is the probe lit from the far end?")


def edge_share(frame: Image, centre: Sequence[float] | Floats, diameter_px: float, side: float = 0.0) -> float:
    """Return the share of a circle's circumference on which the half level of a lit disc lies near it.

    Parameters
    ----------
    frame : numpy.ndarray
        (rows, cols) float32.
    centre : sequence of float
        Row and column of the circle's centre.
    diameter_px : float
        Its diameter.
    side : float
        Positive: of its half below the centre; negative: above; 0: of all of it.
    """
    circle = np.array([*centre, diameter_px / 2])
    points, _, rays = _edge(_smoothed(_evenly_lit(frame, circle), circle), circle, 0.1, HALF_LEVEL)
    from_centre = points - circle[:2]
    near = np.abs(np.hypot(*from_centre.T) - circle[2]) < NEAR_EDGE * circle[2]
    if side:
        near &= from_centre[:, 0] * side > 0
    return float(np.count_nonzero(near)) / (rays / 2 if side else rays)


def _smoothed(even: Image, circle: Floats) -> Image:
    """Return evenly lit light without the cores, by a Gaussian of a hundredth of a circle's radius."""
    return np.asarray(cv2.GaussianBlur(even, (0, 0), float(np.clip(circle[2] / 100, 0.8, 4.0))), np.float32)


def circle_through(points: Floats, start: Floats) -> Floats:
    """Fit a circle (row, column, radius) to points by a Cauchy loss: those beyond a pixel from it count little.

    Parameters
    ----------
    points : numpy.ndarray
        Row and column of each, shape (n, 2).
    start : numpy.ndarray
        Initial row, column and radius.
    """

    def misses(circle: Floats) -> Floats:
        return np.asarray(np.hypot(*(points - circle[:2]).T) - circle[2], np.float64)

    return np.asarray(scipy.optimize.least_squares(misses, start, loss="cauchy").x, np.float64)


def _evenly_lit(frame: Image, circle: Floats) -> Image:
    """Divide the light by a quadratic that is fitted to it inside the disc: half level is then the same all around."""
    row, column, radius = circle
    rows, cols = ((np.arange(size) - at) / radius for size, at in zip(frame.shape, (row, column), strict=True))
    step = max(1, int(radius / SAMPLES))
    y, x = (grid.ravel() for grid in np.meshgrid(rows[::step], cols[::step], indexing="ij"))
    inside = np.hypot(y, x) < 0.95
    coarse = frame[::step, ::step].ravel().astype(np.float64)
    beside = np.hypot(y, x) > 1.1
    dark = float(np.median(coarse[beside])) if beside.any() else float(coarse.min())
    light = coarse[inside] - dark
    quadratic = polynomial_terms(y[inside], x[inside])[:6]
    terms = np.linalg.lstsq(quadratic @ quadratic.T, quadratic @ light, rcond=None)[0]
    y, x = (np.clip(axis, -1.1, 1.1) for axis in (rows[:, None], cols))
    surface = (terms[0] + terms[1] * y + terms[3] * y * y) + (terms[2] * x + terms[5] * x * x)
    surface += terms[4] * y * x
    surface /= max(float(light.mean()), 1e-6)
    even = np.subtract(frame, dark, dtype=np.float32)
    even /= np.maximum(surface, 0.2, out=surface)
    return even


def _edge(smooth: Image, circle: Floats, reach: float, level: float) -> tuple[Floats, NDArray[np.intp], int]:
    """Return the points where the light has fallen to a level, on those rays from the centre that cross an edge."""
    row, column, radius = circle
    rays = int(np.clip(2 * np.pi * radius, 4 * ARCS, MAX_RAYS))
    angles = 2 * np.pi * (np.arange(rays) + 0.5) / rays
    radii = np.arange((1 - reach) * radius, (1 + reach) * radius, RAY_STEP_PX)
    at_row = (row + radii * np.sin(angles)[:, None]).astype(np.float32)
    at_col = (column + radii * np.cos(angles)[:, None]).astype(np.float32)
    light = cv2.remap(smooth, at_col, at_row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    outside = (at_row < 0) | (at_row > smooth.shape[0] - 1) | (at_col < 0) | (at_col > smooth.shape[1] - 1)
    far = radii > (1 + 0.4 * reach) * radius
    near = (radii > (1 - 0.9 * reach) * radius) & (radii < (1 - 0.25 * reach) * radius)
    if not (far.any() and near.any()):  # a circle of a few pixels
        return np.empty((0, 2)), np.empty(0, np.intp), rays
    dark = np.median(np.where(outside[:, far], np.inf, light[:, far]), axis=1)
    usual_dark = np.median(dark[np.isfinite(dark)]) if np.isfinite(dark).any() else float(smooth.min())
    dark = np.where(np.isfinite(dark), dark, usual_dark)
    bright = np.median(light[:, near], axis=1)
    contrast = bright - dark
    edge = dark + level * contrast
    above = light > edge[:, None]
    last = above.shape[1] - 1 - np.argmax(above[:, ::-1], axis=1)
    ray = np.arange(rays)
    seen = (contrast > 0.4 * np.percentile(contrast, 75)) & (last < above.shape[1] - 1) & above.any(axis=1)
    beyond = np.minimum(last + 1, above.shape[1] - 1)
    seen &= ~outside[ray, beyond]
    drop = light[ray, last] - light[ray, beyond]
    part = (light[ray, last] - edge) / np.where(drop > 0, drop, 1.0)
    at = radii[last] + RAY_STEP_PX * np.clip(part, 0, 1)
    points = np.stack([row + at * np.sin(angles), column + at * np.cos(angles)], axis=1)
    return points[seen], (ray * ARCS // rays)[seen], rays


def _fit_circle(
    points: Floats, arcs: NDArray[np.intp], circle: Floats, expectile: float = 0.5
) -> tuple[Floats, Floats, Floats]:
    """Fit a circle to the consistent points; return it, the spread of its parameters by arcs, and what it leaves over.

    With an expectile above a half by asymmetric least squares, so that it passes points further out: Newey & Powell
    1987, https://doi.org/10.2307/1911031.
    """
    for _ in range(MAX_STEPS):
        away = points - circle[:2]
        distance = np.hypot(*away.T)
        miss = distance - circle[2]
        middle, scatter = _shortest_stretch(miss)
        good = np.abs(miss - middle) < max(3.5 * scatter, 0.5)
        jacobian, miss = np.c_[away / distance[:, None], np.ones(len(away))][good], miss[good]
        weighted = jacobian * np.where(miss > 0, expectile, 1 - expectile)[:, None]
        step = np.linalg.lstsq(weighted.T @ jacobian, weighted.T @ miss, rcond=None)[0]
        circle = circle + step
        if np.abs(step).max() < CONVERGED_PX:
            break
    left = miss - jacobian @ step
    influence = estimator_influence(weighted * left[:, None], weighted.T @ jacobian, arcs[good], ARCS)
    return circle, np.linalg.norm(influence, axis=0), left


def _shortest_stretch(miss: Floats) -> tuple[float, float]:
    """Return the middle of the shortest stretch that contains that share of the values, and the scatter beyond it."""
    ordered = np.sort(miss)
    count = int(MIN_CONSISTENT * len(ordered))
    widths = ordered[count:] - ordered[:-count]
    first = int(np.argmin(widths))
    middle = float((ordered[first] + ordered[first + count]) / 2)
    outward = miss[miss > middle] - middle
    return middle, float(robust_sigma(outward)) if len(outward) else 0.0
