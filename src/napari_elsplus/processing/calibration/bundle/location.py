"""Location of the bundle's two images: binary threshold, centres, diameter.

The paper thresholds a frame lit from the far end and takes the row and the column with the most pixels above the
threshold (System Calibration, step iii). That is the initial estimate here; then the disc's edge is followed around at
half level and a circle is fitted to it, which is robust against a structured target and an edge that the sensor cuts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
from skimage.filters import threshold_li
from skimage.measure import label

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.calibration.bundle.rim import circle_through, fit_rim

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Circle = tuple[tuple[float, float], float]
    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

COARSE_ROWS: Final = 160
"""Size of the reduced image; chosen: cores are averaged, the disc is still located to a percent."""
MIN_DISC: Final = 0.15
"""Of all lit pixels, in each half of the frame; chosen: a good view has about half of them."""
MIN_EDGE_SEEN: Final = 0.26
"""Share of the circumference; measured: photographs of bundles behind targets have 0.55 and more, images of layers that
are taken for a disc 0.22 to 0.25."""
MIN_CERTAIN_EDGE: Final = 0.5
"""Share of the circumference on which a bundle's edge is seen, below which a warning is given; measured: photographs of
bundles behind targets have 0.55 and more, a target on dark ground 0.29 to 0.47 wherever its bundle is."""
MAX_DIAMETER_DIFFERENCE: Final = 0.1
"""Relative, between the views; chosen: optics differ by less than a percent."""


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
    edge_seen : float
        Share of the circumference on which the edge was found.
    """

    centre: tuple[float, float]
    diameter_px: float
    centre_uncertainty_px: float
    diameter_uncertainty_px: float
    edge_seen: float

    @property
    def circle(self) -> Circle:
        """Centre and diameter in pixels."""
        return self.centre, self.diameter_px


def locate_bundle(image: NDArray[np.generic]) -> Disc:
    """Locate the one bundle in an image.

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
        If the image contains no lit disc.

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
    """Locate the two images of the bundle that lie side by side.

    Parameters
    ----------
    image : numpy.ndarray
        Raw frame (rows, cols) of the bundle lit from its far end.

    Returns
    -------
    tuple of Disc
        In the confocal view, which lies on the left, and in the residual view.

    Raises
    ------
    MeasurementError
        If there are not two discs of similar size.
    """
    frame = np.asarray(image, np.float32)
    small, scale = _reduced(frame)
    threshold = _threshold(small)
    mask = _without_specks(small > threshold)
    split = _dark_column(mask, threshold)
    halves = (mask[:, :split], mask[:, split:])
    lit = [half.sum() > MIN_DISC * mask.sum() for half in halves]
    if not all(lit):
        raise _not_two(sum(lit), threshold)
    column = round(split * scale)
    confocal = _disc(frame[:, :column], halves[0], scale, threshold, 0)
    residual = _disc(frame[:, column:], halves[1], scale, threshold, column)
    unequal = abs(confocal.diameter_px / residual.diameter_px - 1)
    if unequal > MAX_DIAMETER_DIFFERENCE:
        raise MeasurementError(
            f"the two bundle images have diameters {confocal.diameter_px:.0f} and {residual.diameter_px:.0f} px",
            "is one of them dark, cut off or blocked?",
        )
    return confocal, residual


def _not_two(found: int, threshold: float) -> MeasurementError:
    return MeasurementError(
        f"two bundle images expected, {found} found (threshold {threshold:.3g})", "is the probe lit from the far end?"
    )


def _reduced(frame: Image) -> tuple[Image, float]:
    """Return the image reduced to about 160 rows, without honeycomb and hot pixels, and the factor."""
    if min(frame.shape) < 32:
        raise MeasurementError(f"the image has {frame.shape[0]} x {frame.shape[1]} pixels", "a bundle needs 32 x 32")
    scale = max(1.0, min(frame.shape) / COARSE_ROWS)
    size = (round(frame.shape[1] / scale), round(frame.shape[0] / scale))
    small = cv2.resize(cv2.medianBlur(frame, 3), size, interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(small, (0, 0), 1.5), frame.shape[0] / size[1]


def _threshold(small: Image) -> float:
    """Return the binary threshold between darkness and the dimmest lit parts."""
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
    """Return the column between the two images: the middle of the darkest gap near the middle of the lit columns."""
    counts = mask.sum(axis=0)
    lit = np.flatnonzero(counts)
    if not lit.size:
        raise _not_two(0, threshold)
    start, stop = (int(lit[0] + part * (np.ptp(lit) + 1)) for part in (0.3, 0.7))
    middle = counts[start : stop + 1]
    if middle.min() > 0.5 * counts.max():
        raise _not_two(1, threshold)
    return start + middle_of_longest_run(np.flatnonzero(middle == middle.min()))


def middle_of_longest_run(indices: NDArray[np.intp]) -> int:
    """Return the middle of the longest run of successive numbers among ascending `indices`.

    Examples
    --------
    >>> middle_of_longest_run(np.array([2, 7, 8, 9, 14, 15]))
    8
    """
    runs = np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1)
    return round(float(max(runs, key=len).mean()))


def _disc(frame: Image, mask: NDArray[np.bool_], scale: float, threshold: float, first_column: int) -> Disc:
    """Locate a disc by its rows and columns with the most pixels, its outline, and its half-level edge."""
    mask = _without_specks(mask)
    if not mask.any():
        raise MeasurementError(f"no bundle (threshold {threshold:.3g})", "is the probe lit from the far end?")
    row, column = (_most_pixels(mask.sum(axis=axis)) for axis in (1, 0))
    radius = max(np.ptp(np.flatnonzero(mask.any(axis=axis))) for axis in (0, 1)) / 2 + 0.5
    circle = _outline_circle(mask, (row, column, radius))
    circle = np.r_[(circle[:2] + 0.5) * scale - 0.5, circle[2] * scale]
    circle, spread, seen = fit_rim(frame, circle)
    if seen < MIN_EDGE_SEEN:
        raise MeasurementError(
            f"no bundle: its edge is seen on {100 * seen:.0f} % of the circumference",
            "light the probe evenly from the far end, without a dark target",
        )
    return Disc(
        centre=(float(circle[0]), float(circle[1] + first_column)),
        diameter_px=float(2 * circle[2]),
        centre_uncertainty_px=float(max(spread[:2])),
        diameter_uncertainty_px=float(2 * spread[2]),
        edge_seen=seen,
    )


def _most_pixels(counts: NDArray[np.int_]) -> float:
    """Return the middle of the rows (columns) with nearly the most pixels above the threshold."""
    return float(np.flatnonzero(counts >= 0.98 * counts.max()).mean())


def _outline_circle(mask: NDArray[np.bool_], start: tuple[float, float, float]) -> Floats:
    """Fit a circle to the outermost lit pixels: those of the mask that lie on its convex hull."""
    hull = cv2.convexHull(np.argwhere(mask).astype(np.int32))[:, 0].astype(np.float64)
    edge = np.array(mask.shape) - 1
    free = ((hull > 0) & (hull < edge)).all(axis=1)
    points = hull[free] if free.sum() >= 8 else hull
    return circle_through(points, np.array(start))
