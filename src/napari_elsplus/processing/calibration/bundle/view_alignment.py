"""The right view laid onto the left, and its brightness: what has to be right before one is subtracted from the other.

The paper extracts both views at their located centres and finds an alignment error of 5.5 % (System Calibration). Here
the cores themselves, which both views show, give the map, its model and its uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.calibration.bundle.core_matching import AlignmentModel, CoreFit, CoreMatcher, tiles
from napari_elsplus.processing.images.resampling import resampled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.bundle.location import Disc

    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

LEAST_CORRELATION: Final = 0.1
GAINS: Final = (0.5, 2.0)
LEAST_RING: Final = 200
SATURATED_NEARBY: Final = 0.02
"""Share of the pixels around one that may be saturated if it is to count for the gain: patches do not, single cores do.
Leaving out the brightest cores alone would favour the dim ones."""
SAMPLING_PX: Final = 0.001
"""What pixels that sample the cores, and interpolation between them, add to the alignment's uncertainty."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """The right view laid onto the left.

    Parameters
    ----------
    residual_to_confocal : numpy.ndarray
        Maps (row, col, 1) in the right view to (row, col) in the left, shape (2, 3).
    model : AlignmentModel
        The simplest motion that the evidence asks for.
    evidence : dict
        Bayesian information criterion of each model above the best one's.
    uncertainty_px : float
        One standard deviation of the map along a row or column, at the disc's rim, where it is least certain.
    gain : float
        Brightness of the right view over the left, per area and not per core: of a larger view, each core may hold more
        light than the gain says.
    gain_uncertainty : float
        One standard deviation of the gain.
    correlation : float
        Between the cores of the two views, once aligned.
    """

    residual_to_confocal: Floats
    model: AlignmentModel
    evidence: dict[str, float]
    uncertainty_px: float
    gain: float
    gain_uncertainty: float
    correlation: float


def align_views(
    image: NDArray[np.generic], left: Disc, right: Disc, saturated: NDArray[np.bool_] | None = None
) -> Alignment:
    """Lay the right view onto the left by their cores, and compare their brightness.

    Parameters
    ----------
    image : numpy.ndarray
        Raw frame (rows, cols) of the bundle lit from its far end.
    left, right : Disc
        The two discs, from :func:`napari_elsplus.processing.calibration.bundle.location.locate_pair`.
    saturated : numpy.ndarray, optional
        Pixels (rows, cols) that do not count for the brightness.

    Returns
    -------
    Alignment

    Raises
    ------
    MeasurementError
        If the two views do not show the same cores, or saturation leaves nothing to compare their brightness by.
    """
    frame = np.asarray(image, np.float32)
    matcher = CoreMatcher(frame, left, right)
    affine = matcher.fit(matcher.start(), AlignmentModel.AFFINE)
    criterion = {model: _criterion(affine, model) for model in AlignmentModel}
    model = min(AlignmentModel, key=lambda candidate: criterion[candidate])
    fit = affine if model is AlignmentModel.AFFINE else matcher.fit(affine.motion, model)
    if not fit.correlation > LEAST_CORRELATION:
        raise MeasurementError(
            f"the two views do not show the same cores (correlation {fit.correlation:.2f})",
            "is the bundle in focus in both, and the light bright enough?",
        )
    gain, gain_uncertainty = _gain(frame, left, right, fit.motion, matcher, saturated)
    return Alignment(
        residual_to_confocal=_right_to_left(fit.motion, left, right),
        model=model,
        evidence={other.value: criterion[other] - criterion[model] for other in AlignmentModel},
        uncertainty_px=float(np.hypot(fit.uncertainty_px, SAMPLING_PX)),
        gain=gain,
        gain_uncertainty=gain_uncertainty,
        correlation=fit.correlation,
    )


def _criterion(affine: CoreFit, model: AlignmentModel) -> float:
    """Bayesian information criterion: how far the affine fit is from the model, in its own uncertainty, and parameters.

    The Wald statistic stands in for the likelihood's loss, since its covariance also holds for lumpy residuals.
    """
    must_vanish = model.constraints @ (affine.parameters - AlignmentModel.AFFINE.identity)
    influence = affine.influence @ model.constraints.T
    wald = float(must_vanish @ np.linalg.pinv(influence.T @ influence) @ must_vanish) if len(must_vanish) else 0.0
    return wald + model.parameters * float(np.log(len(influence)))


def darkness(frame: NDArray[np.float32], left: Disc, right: Disc) -> NDArray[np.float32]:
    """Level of stray light and black everywhere, from rings around both discs, where no bundle is.

    Parameters
    ----------
    frame : numpy.ndarray
        (rows, cols) float32.
    left, right : Disc
        The bundle images in it.

    Returns
    -------
    numpy.ndarray
        (rows, cols) float32: a plane fitted to the rings of 1.08 to 1.25 radii, robust against what shines in them.
    """
    return _spread_out(_dark_plane(frame, left, right)[0], frame)


def _spread_out(plane: Floats, frame: Image) -> Image:
    rows, cols = np.ogrid[: frame.shape[0], : frame.shape[1]]
    return np.asarray(plane[0] + plane[1] * rows + plane[2] * cols, np.float32)


def _dark_plane(frame: Image, left: Disc, right: Disc) -> tuple[Floats, Floats]:
    """Level and slopes per row and column of the darkness, and their covariance."""
    rows, cols = np.ogrid[: frame.shape[0], : frame.shape[1]]
    away = [np.hypot(rows - d.centre[0], cols - d.centre[1]) / (d.diameter_px / 2) for d in (left, right)]
    nearest = np.minimum(*away)
    y, x = np.nonzero((nearest > 1.08) & (nearest < 1.25))
    if len(y) < LEAST_RING:
        return np.array([frame.min(), 0.0, 0.0]), np.zeros((3, 3))
    level = frame[y, x].astype(np.float64)
    terms = np.stack([np.ones(len(y)), y, x], axis=1)
    plane, covariance = np.array([np.median(level), 0.0, 0.0]), np.zeros((3, 3))
    for _ in range(3):
        miss = level - terms @ plane
        kept = np.abs(miss) <= 4 * max(1.4826 * float(np.median(np.abs(miss))), 0.5)
        inverse = np.linalg.pinv(terms[kept].T @ terms[kept])
        plane = inverse @ (terms[kept].T @ level[kept])
        covariance = inverse * float(np.var(level[kept] - terms[kept] @ plane))
    return plane, covariance


def _right_to_left(motion: Floats, left: Disc, right: Disc) -> Floats:
    """Motion about the centres, left to right, as the matrix from right to left in the frame's coordinates."""
    back = np.linalg.inv(motion[:, :2])
    shift = np.array(left.centre) - back @ (np.array(right.centre) + motion[:, 2])
    return np.column_stack([back, shift])


def _gain(
    frame: Image,
    left: Disc,
    right: Disc,
    motion: Floats,
    matcher: CoreMatcher,
    saturated: NDArray[np.bool_] | None,
) -> tuple[float, float]:
    """Brightness of the right view over the left, each above the darkness around it, and its uncertainty."""
    plane, covariance = _dark_plane(frame, left, right)
    above_dark = frame - _spread_out(plane, frame)

    def both(image: Image) -> list[Image]:
        views = ((left, np.eye(2, 3)), (right, motion))
        return [
            resampled(image, matcher.grid_to_frame(view.centre, shift), matcher.side)[matcher.inside]
            for view, shift in views
        ]

    confocal, residual = both(above_dark)
    tile, count = tiles(matcher.rows, matcher.cols)
    if saturated is not None and saturated.any():
        around = cv2.GaussianBlur(saturated.astype(np.float32), (0, 0), left.diameter_px / 60)
        counts = np.maximum(*both(around)) < SATURATED_NEARBY
        if not counts.any():
            raise MeasurementError(
                "the bundle's images are saturated here and there all over", "lower the light or the gain"
            )
        confocal, residual, tile = confocal[counts], residual[counts], tile[counts]
    gain = float(residual.sum(dtype=np.float64) / confocal.sum(dtype=np.float64))
    if not GAINS[0] < gain < GAINS[1]:
        raise MeasurementError(
            f"the right view is {gain:.2f} times as bright as the left, {GAINS[0]:g} to {GAINS[1]:g} is expected",
            "is one of the views blocked?",
        )
    misses = np.bincount(tile, weights=residual - gain * confocal, minlength=count)
    filled = np.count_nonzero(np.bincount(tile, minlength=count))
    by_tiles = np.sqrt(np.square(misses).sum() * filled / max(filled - 1, 1)) / confocal.sum()
    by_darkness = (gain * np.array([1, *left.centre]) - np.array([1, *right.centre])) / confocal.mean()
    return gain, float(np.sqrt(by_tiles**2 + by_darkness @ covariance @ by_darkness))
