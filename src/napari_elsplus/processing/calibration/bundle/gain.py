"""Gain of the residual view: its brightness over the confocal view's, each above the darkness around the bundle."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.analysis.uncertainty import robust_sigma
from napari_elsplus.processing.calibration.bundle.core_matching import COMPARED_DISC, CoreMatcher, tiles
from napari_elsplus.processing.images.resampling import cropped

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.bundle.location import Circle, Disc

    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

GAINS: Final = (0.5, 2.0)
"""Range of the gain, as of the calibration's files."""
MIN_RING_PIXELS: Final = 200
"""Around the discs, for a plane of darkness; chosen."""
RING_STEP_PX: Final = 2
"""Of the pixels around the discs that are used; chosen: thousands are left."""
MAX_SATURATED_NEARBY: Final = 0.02
"""Share of the pixels around one that may be saturated if it is to count for the gain; chosen: patches are left out,
single cores are not, as leaving out the brightest cores alone would favour the dim ones."""


def measure_gain(
    frame: NDArray[np.float32],
    confocal: Disc,
    residual: Disc,
    matcher: CoreMatcher,
    coefficients: Floats,
    saturated: NDArray[np.bool_] | None,
) -> tuple[float, float]:
    """Return the brightness of the residual view over the confocal, each above darkness, and its uncertainty.

    Parameters
    ----------
    frame : numpy.ndarray
        (rows, cols) float32, the bundle lit from its far end.
    confocal, residual : Disc
        The bundle images in it.
    matcher : CoreMatcher
        The grid, and its pixels that are compared.
    coefficients : numpy.ndarray
        (2, 10) map from the confocal to the residual view.
    saturated : numpy.ndarray or None
        (rows, cols), bool: pixels that are left out.

    Raises
    ------
    MeasurementError
        If saturation leaves no pixels, or the gain lies outside of :data:`GAINS`.
    """
    plane, covariance = _dark_plane(frame, (confocal.circle, residual.circle))
    above_dark = frame - _spread_out(plane, frame)

    def both(image: Image) -> list[Image]:
        views = cropped(image, confocal.centre, matcher.side), matcher.residual_view(image, coefficients)
        return [view[matcher.inside] for view in views]

    first, second = both(above_dark)
    tile, count = tiles(matcher.rows, matcher.cols)
    if saturated is not None and saturated.any():
        around = cv2.GaussianBlur(saturated.astype(np.float32), (0, 0), confocal.diameter_px / 60)
        counts = np.maximum(*both(around)) < MAX_SATURATED_NEARBY
        if not counts.any():
            raise MeasurementError("the bundle's images are saturated all over", "lower the light or the gain")
        first, second, tile = first[counts], second[counts], tile[counts]
    gain, by_tiles = ratio_of_light(first, second, tile, count)
    if not GAINS[0] < gain < GAINS[1]:
        raise MeasurementError(
            f"the residual view is {gain:.2f} times as bright as the confocal; {GAINS[0]:g} to {GAINS[1]:g} expected",
            "is one of the views blocked?",
        )
    by_darkness = (gain * np.array([1, *confocal.centre]) - np.array([1, *residual.centre])) / first.mean()
    return gain, float(np.sqrt(by_tiles**2 + by_darkness @ covariance @ by_darkness))


def ratio_of_light(
    first: NDArray[np.floating], second: NDArray[np.floating], cluster: NDArray[np.intp], count: int
) -> tuple[float, float]:
    """Return the light of a second view over that of a first, and one standard deviation by its scatter over clusters.

    Parameters
    ----------
    first, second : numpy.ndarray
        Light of the same pixels in both views, (points,).
    cluster : numpy.ndarray
        Cluster of each, 0 to `count` - 1, (points,).
    count : int
        Number of clusters.
    """
    total = float(first.sum(dtype=np.float64))
    ratio = float(second.sum(dtype=np.float64)) / total
    misses = np.bincount(cluster, weights=second - ratio * first, minlength=count)
    filled = np.count_nonzero(np.bincount(cluster, minlength=count))
    return ratio, float(np.sqrt(np.square(misses).sum() * filled / max(filled - 1, 1))) / total


def darkness(frame: NDArray[np.float32], discs: Sequence[Circle]) -> NDArray[np.float32]:
    """Estimate the level of stray light and black from rings around both discs, outside of the bundle.

    Parameters
    ----------
    frame : numpy.ndarray
        (rows, cols) float32.
    discs : sequence of tuple
        Centre (row, col) and diameter in pixels of both bundle images in it.

    Returns
    -------
    numpy.ndarray
        (rows, cols) float32: a plane fitted to the rings of 1.08 to 1.25 radii, robust against light in them.
    """
    return _spread_out(_dark_plane(frame, discs)[0], frame)


def mean_light(frame: NDArray[np.float32], discs: Sequence[Circle]) -> float:
    """Return the mean light within both discs, in grey levels above the darkness around them.

    Parameters
    ----------
    frame : numpy.ndarray
        (rows, cols) float32.
    discs : sequence of tuple
        Centre (row, col) and diameter in pixels of both bundle images in it.
    """
    rows, cols = np.ogrid[: frame.shape[0], : frame.shape[1]]
    inside = [np.hypot(rows - row, cols - col) < COMPARED_DISC * px / 2 for (row, col), px in discs]
    return float((frame - darkness(frame, discs))[np.logical_or(*inside)].mean())


def _spread_out(plane: Floats, frame: Image) -> Image:
    rows, cols = np.ogrid[: frame.shape[0], : frame.shape[1]]
    return np.asarray(plane[0] + plane[1] * rows + plane[2] * cols, np.float32)


def _dark_plane(frame: Image, discs: Sequence[Circle]) -> tuple[Floats, Floats]:
    """Fit level and slopes per row and column of the darkness; return them and their covariance."""
    rows, cols = np.ogrid[: frame.shape[0] : RING_STEP_PX, : frame.shape[1] : RING_STEP_PX]
    squared = [
        np.square((rows - row) / (diameter_px / 2)) + np.square((cols - col) / (diameter_px / 2))
        for (row, col), diameter_px in discs
    ]
    nearest = np.minimum(*squared)
    y, x = RING_STEP_PX * np.array(np.nonzero((nearest > 1.08**2) & (nearest < 1.25**2)))
    if len(y) < MIN_RING_PIXELS:
        return np.array([frame.min(), 0.0, 0.0]), np.zeros((3, 3))
    level = frame[y, x].astype(np.float64)
    terms = np.stack([np.ones(len(y)), y, x], axis=1)
    plane, covariance = np.array([np.median(level), 0.0, 0.0]), np.zeros((3, 3))
    for _ in range(3):
        miss = level - terms @ plane
        kept = np.abs(miss) <= 4 * max(float(robust_sigma(miss)), 0.5)
        inverse = np.linalg.pinv(terms[kept].T @ terms[kept])
        plane = inverse @ (terms[kept].T @ level[kept])
        covariance = inverse * float(np.var(level[kept] - terms[kept] @ plane))
    return plane, covariance
