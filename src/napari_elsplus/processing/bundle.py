"""Where the bundle's two images are: binary threshold, centres, diameter.

The paper thresholds a frame lit from the far end and takes the row and the column with the most pixels above the
threshold (System Calibration, step iii). That is the start here; then the disc's edge is followed around at half
level and a circle is fitted to it, which sees neither a structured target nor an edge that the sensor cuts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
from scipy import optimize
from skimage.filters import threshold_li
from skimage.measure import label

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.uncertainty import clustered_influence

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

ARCS: Final = 36
COARSE_ROWS: Final = 160
SMALLEST_DISC: Final = 0.15
MOST_UNEQUAL: Final = 0.1


@dataclass(frozen=True, slots=True)
class Disc:
    """The lit disc of one bundle image.

    Parameters
    ----------
    centre : tuple of float
        Row and column.
    diameter_px : float
        Diameter of the circle at which the light has fallen to half.
    centre_uncertainty_px : float
        One standard deviation of the centre, along a row or column.
    diameter_uncertainty_px : float
        One standard deviation of the diameter.
    threshold : float
        Grey level of the binary threshold that found it.
    edge_seen : float
        Share of the circumference on which the edge was found.
    """

    centre: tuple[float, float]
    diameter_px: float
    centre_uncertainty_px: float
    diameter_uncertainty_px: float
    threshold: float
    edge_seen: float


def locate_bundle(image: NDArray[np.generic]) -> Disc:
    """Find the one bundle in an image.

    Parameters
    ----------
    image : numpy.ndarray
        Light that came through the bundle (rows, cols), any real dtype; structured targets and uneven light are fine.

    Returns
    -------
    Disc

    Raises
    ------
    MeasurementError
        If nothing in the image is a lit disc.

    Examples
    --------
    >>> rows, cols = np.mgrid[:200, :260]
    >>> disc = locate_bundle(10 + 90 * (np.hypot(rows - 98.5, cols - 130.25) < 80))
    >>> bool(np.allclose(disc.centre, (98.5, 130.25), atol=0.1)), bool(abs(disc.diameter_px - 160) < 0.5)
    (True, True)
    """
    frame = np.asarray(image, np.float32)
    small, scale = _reduced(frame)
    threshold = _threshold(small)
    return _disc(frame, small > threshold, scale, threshold, 0)


def locate_pair(image: NDArray[np.generic]) -> tuple[Disc, Disc]:
    """Find the two images of the bundle that lie side by side.

    Parameters
    ----------
    image : numpy.ndarray
        Raw frame (rows, cols) of the bundle lit from its far end.

    Returns
    -------
    tuple of Disc
        Left (confocal) and right (residual).

    Raises
    ------
    MeasurementError
        If there are not two discs of like size.
    """
    frame = np.asarray(image, np.float32)
    small, scale = _reduced(frame)
    threshold = _threshold(small)
    mask = _without_specks(small > threshold)
    split = _dark_column(mask, threshold)
    halves = (mask[:, :split], mask[:, split:])
    lit = [half.sum() > SMALLEST_DISC * mask.sum() for half in halves]
    if not all(lit):
        raise _not_two(sum(lit), threshold)
    column = round(split * scale)
    left = _disc(frame[:, :column], halves[0], scale, threshold, 0)
    right = _disc(frame[:, column:], halves[1], scale, threshold, column)
    unequal = abs(left.diameter_px / right.diameter_px - 1)
    if unequal > MOST_UNEQUAL:
        raise MeasurementError(
            f"the two bundle images have diameters {left.diameter_px:.0f} and {right.diameter_px:.0f} px",
            "is one of them dark, cut off or blocked?",
        )
    return left, right


def _not_two(found: int, threshold: float) -> MeasurementError:
    return MeasurementError(
        f"two bundle images expected, {found} found (threshold {threshold:.3g})", "is the probe lit from the far end?"
    )


def _reduced(frame: Image) -> tuple[Image, float]:
    """Honeycomb and hot pixels averaged away: the image at about 160 rows, and the factor back."""
    if min(frame.shape) < 32:
        raise MeasurementError(f"the image has {frame.shape[0]} x {frame.shape[1]} pixels", "a bundle needs 32 x 32")
    scale = max(1.0, min(frame.shape) / COARSE_ROWS)
    size = (round(frame.shape[1] / scale), round(frame.shape[0] / scale))
    small = cv2.resize(cv2.medianBlur(frame, 3), size, interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(small, (0, 0), 1.5), frame.shape[0] / size[1]


def _threshold(small: Image) -> float:
    """Binary threshold between darkness and the dimmest lit parts."""
    low, high = np.percentile(small, [1, 99])
    if not high - low > 1e-6 * max(abs(float(high)), 1e-6):
        raise MeasurementError(f"no bundle: all pixels are {float(high):.3g}", "is the probe lit from the far end?")
    return float(threshold_li(np.clip(small, low, high)))


def _without_specks(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    labels = label(mask)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    kept: NDArray[np.bool_] = (sizes > 0.002 * mask.size)[labels]
    return kept


def _dark_column(mask: NDArray[np.bool_], threshold: float) -> int:
    """Column between the two images: the middle of the darkest gap in the middle of the frame."""
    counts = mask.sum(axis=0)
    if not counts.any():
        raise _not_two(0, threshold)
    start, stop = int(0.3 * len(counts)), int(np.ceil(0.7 * len(counts)))
    middle = counts[start:stop]
    if middle.min() > 0.25 * counts.max():
        raise _not_two(1, threshold)
    gap = np.flatnonzero(middle == middle.min())
    runs = np.split(gap, np.flatnonzero(np.diff(gap) > 1) + 1)
    widest = max(runs, key=len)
    return start + round(float(widest.mean()))


def _disc(frame: Image, mask: NDArray[np.bool_], scale: float, threshold: float, first_column: int) -> Disc:
    """Rows and columns with the most pixels, then the outline, then the half-level edge at full resolution."""
    mask = _without_specks(mask)
    if not mask.any():
        raise MeasurementError(f"no bundle (threshold {threshold:.3g})", "is the probe lit from the far end?")
    row, column = (_most_pixels(mask.sum(axis=axis)) for axis in (1, 0))
    radius = max(np.ptp(np.flatnonzero(mask.any(axis=axis))) for axis in (0, 1)) / 2 + 0.5
    circle = _outline_circle(mask, (row, column, radius))
    circle = np.r_[(circle[:2] + 0.5) * scale - 0.5, circle[2] * scale]
    smooth = cv2.GaussianBlur(_evenly_lit(frame, circle), (0, 0), float(np.clip(circle[2] / 100, 0.8, 4.0)))
    for reach in (0.25, 0.1, 0.1):
        points, sectors, rays = _edge(smooth, circle, reach)
        if len(points) < max(ARCS, rays // 6):
            raise MeasurementError(
                f"no bundle: only {100 * len(points) / rays:.0f} % of a rim is seen (threshold {threshold:.3g})",
                "is the probe lit from the far end, and the bundle in view?",
            )
        circle, influence, used = _fit_circle(points, sectors, circle)
    spread = np.linalg.norm(influence, axis=0)
    return Disc(
        centre=(float(circle[0]), float(circle[1] + first_column)),
        diameter_px=float(2 * circle[2]),
        centre_uncertainty_px=float(max(spread[:2])),
        diameter_uncertainty_px=float(2 * spread[2]),
        threshold=threshold,
        edge_seen=used / rays,
    )


def _evenly_lit(frame: Image, circle: Floats) -> Image:
    """Light over a quadratic that is fitted to it inside the disc, so that half level means the same all around."""
    row, column, radius = circle
    rows, cols = ((np.arange(size) - at) / radius for size, at in zip(frame.shape, (row, column), strict=True))
    step = max(1, int(radius / 60))
    y, x = (grid.ravel() for grid in np.meshgrid(rows[::step], cols[::step], indexing="ij"))
    inside = np.hypot(y, x) < 0.95
    coarse = frame[::step, ::step].ravel().astype(np.float64)
    beside = np.hypot(y, x) > 1.1
    dark = float(np.median(coarse[beside])) if beside.any() else float(coarse.min())
    light = coarse[inside] - dark
    terms = np.linalg.lstsq(_quadratic(y[inside], x[inside]).T, light, rcond=None)[0]
    y, x = (np.clip(axis, -1.1, 1.1) for axis in (rows[:, None], cols))
    down, across = (terms[0] + terms[1] * y + terms[3] * y * y, terms[2] * x + terms[5] * x * x)
    surface = (down + across + terms[4] * y * x) / max(float(light.mean()), 1e-6)
    return np.asarray((frame - dark) / np.maximum(surface, 0.2), np.float32)


def _quadratic(y: Floats, x: Floats) -> Floats:
    return np.stack([np.ones_like(y), y, x, y * y, y * x, x * x])


def _most_pixels(counts: NDArray[np.int_]) -> float:
    """Middle of the rows (columns) that have nearly the most pixels above the threshold."""
    return float(np.flatnonzero(counts >= 0.98 * counts.max()).mean())


def _outline_circle(mask: NDArray[np.bool_], start: tuple[float, float, float]) -> Floats:
    """Circle through the outermost lit pixels: those of the mask that lie on its convex hull."""
    hull = cv2.convexHull(np.argwhere(mask).astype(np.int32))[:, 0].astype(np.float64)
    edge = np.array(mask.shape) - 1
    free = ((hull > 0) & (hull < edge)).all(axis=1)
    points = hull[free] if free.sum() >= 8 else hull
    return _robust_circle(points, np.array(start), 1.0)


def _robust_circle(points: Floats, start: Floats, scale_px: float) -> Floats:
    def misses(circle: Floats) -> Floats:
        away: Floats = np.hypot(points[:, 0] - circle[0], points[:, 1] - circle[1]) - circle[2]
        return away

    circle: Floats = optimize.least_squares(misses, start, loss="cauchy", f_scale=scale_px).x
    return circle


def _edge(smooth: Image, circle: Floats, reach: float) -> tuple[Floats, NDArray[np.intp], int]:
    """Points where the light has fallen to half, on rays from the centre; rays that see no edge are left out."""
    row, column, radius = circle
    rays = int(np.clip(2 * np.pi * radius / 2, 4 * ARCS, 720))
    angles = 2 * np.pi * (np.arange(rays) + 0.5) / rays
    radii = np.arange((1 - reach) * radius, (1 + reach) * radius, 0.25)
    at_row = (row + radii * np.sin(angles)[:, None]).astype(np.float32)
    at_col = (column + radii * np.cos(angles)[:, None]).astype(np.float32)
    light = cv2.remap(smooth, at_col, at_row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    outside = (at_row < 0) | (at_row > smooth.shape[0] - 1) | (at_col < 0) | (at_col > smooth.shape[1] - 1)
    far = radii > (1 + 0.4 * reach) * radius
    near = (radii > (1 - 0.9 * reach) * radius) & (radii < (1 - 0.25 * reach) * radius)
    dark = np.median(np.where(outside[:, far], np.inf, light[:, far]), axis=1)
    usual_dark = np.median(dark[np.isfinite(dark)]) if np.isfinite(dark).any() else float(smooth.min())
    dark = np.where(np.isfinite(dark), dark, usual_dark)
    bright = np.median(light[:, near], axis=1)
    contrast = bright - dark
    above = light > (0.5 * (bright + dark))[:, None]
    last = above.shape[1] - 1 - np.argmax(above[:, ::-1], axis=1)
    ray = np.arange(rays)
    seen = (contrast > 0.4 * np.percentile(contrast, 75)) & (last < above.shape[1] - 1) & above.any(axis=1)
    beyond = np.minimum(last + 1, above.shape[1] - 1)
    seen &= ~outside[ray, beyond]
    drop = light[ray, last] - light[ray, beyond]
    part = (light[ray, last] - 0.5 * (bright + dark)) / np.where(drop > 0, drop, 1.0)
    at = radii[last] + 0.25 * np.clip(part, 0, 1)
    points = np.stack([row + at * np.sin(angles), column + at * np.cos(angles)], axis=1)
    return points[seen], (ray * ARCS // rays)[seen], rays


def _fit_circle(points: Floats, sectors: NDArray[np.intp], start: Floats) -> tuple[Floats, Floats, int]:
    """Circle through edge points, outliers left out; the arcs' influences give the uncertainty."""
    circle = _robust_circle(points, start, 0.5)
    for _ in range(2):
        away = points - circle[:2]
        distance = np.hypot(*away.T)
        miss = distance - circle[2]
        scatter = 1.4826 * np.median(np.abs(miss - np.median(miss)))
        good = np.abs(miss - np.median(miss)) < max(3.5 * scatter, 0.5)
        jacobian = np.c_[away / distance[:, None], np.ones(len(away))][good]
        circle = circle + np.linalg.lstsq(jacobian, miss[good], rcond=None)[0]
    left = miss[good] - jacobian @ np.linalg.lstsq(jacobian, miss[good], rcond=None)[0]
    influence = clustered_influence(jacobian, left, sectors[good], ARCS)
    return circle, influence, int(good.sum())
