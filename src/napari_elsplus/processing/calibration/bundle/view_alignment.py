"""Alignment of the residual with the confocal view, and their gain: what a subtraction of the views needs.

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

MIN_CORRELATION: Final = 0.1
"""Of the aligned cores; chosen, above the correlation of different cores by chance."""
GAINS: Final = (0.5, 2.0)
"""Range of the gain, as of the calibration's files."""
MIN_RING_PIXELS: Final = 200
"""Around the discs, for a plane of darkness; chosen."""
MAX_SATURATED_NEARBY: Final = 0.02
"""Share of the pixels around one that may be saturated if it is to count for the gain; chosen: patches are left out,
single cores are not, as leaving out the brightest cores alone would favour the dim ones."""
SAMPLING_PX: Final = 0.001
"""Uncertainty of the alignment by the sampling of the cores and interpolation; chosen."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """Alignment of the residual with the confocal view.

    Parameters
    ----------
    residual_to_confocal : numpy.ndarray
        Maps (row, col, 1) in the residual view to (row, col) in the confocal, shape (2, 3).
    model : AlignmentModel
        The motion model with the lowest Bayesian information criterion.
    evidence : dict
        Bayesian information criterion of each model above the best one's.
    uncertainty_px : float
        One standard deviation of the map along a row or column, at the disc's rim, where it is least certain.
    gain : float
        Brightness of the residual view over the confocal, per area and not per core: of a larger view, each core
        may contain more light than the gain implies.
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
    image: NDArray[np.generic], confocal: Disc, residual: Disc, saturated: NDArray[np.bool_] | None = None
) -> Alignment:
    """Align the residual with the confocal view by their cores, and measure their gain.

    Parameters
    ----------
    image : numpy.ndarray
        Raw frame (rows, cols) of the bundle lit from its far end.
    confocal, residual : Disc
        The two discs, from :func:`napari_elsplus.processing.calibration.bundle.location.locate_pair`.
    saturated : numpy.ndarray, optional
        Pixels (rows, cols) that are left out of the gain.

    Returns
    -------
    Alignment

    Raises
    ------
    MeasurementError
        If the two views do not show the same cores, or saturation leaves no pixels for the gain.
    """
    frame = np.asarray(image, np.float32)
    matcher = CoreMatcher(frame, confocal, residual)
    affine = matcher.fit(matcher.start(), AlignmentModel.AFFINE)
    criterion = {model: _criterion(affine, model) for model in AlignmentModel}
    model = min(AlignmentModel, key=lambda candidate: criterion[candidate])
    fit = affine if model is AlignmentModel.AFFINE else matcher.fit(affine.motion, model)
    if not fit.correlation > MIN_CORRELATION:
        raise MeasurementError(
            f"the two views do not show the same cores (correlation {fit.correlation:.2f})",
            "is the bundle in focus in both, and the light bright enough?",
        )
    gain, gain_uncertainty = _gain(frame, confocal, residual, fit.motion, matcher, saturated)
    return Alignment(
        residual_to_confocal=_residual_to_confocal(fit.motion, confocal, residual),
        model=model,
        evidence={other.value: criterion[other] - criterion[model] for other in AlignmentModel},
        uncertainty_px=float(np.hypot(fit.uncertainty_px, SAMPLING_PX)),
        gain=gain,
        gain_uncertainty=gain_uncertainty,
        correlation=fit.correlation,
    )


def _criterion(affine: CoreFit, model: AlignmentModel) -> float:
    """Return the Bayesian information criterion: Wald statistic of the model in the affine fit, and its parameters.

    The Wald statistic stands in for the likelihood's loss, since its covariance also holds for lumpy residuals.
    """
    must_vanish = model.constraints @ (affine.parameters - AlignmentModel.AFFINE.identity)
    influence = affine.influence @ model.constraints.T
    wald = float(must_vanish @ np.linalg.pinv(influence.T @ influence) @ must_vanish) if len(must_vanish) else 0.0
    return wald + model.parameters * float(np.log(len(influence)))


def darkness(frame: NDArray[np.float32], confocal: Disc, residual: Disc) -> NDArray[np.float32]:
    """Estimate the level of stray light and black from rings around both discs, outside of the bundle.

    Parameters
    ----------
    frame : numpy.ndarray
        (rows, cols) float32.
    confocal, residual : Disc
        The bundle images in it.

    Returns
    -------
    numpy.ndarray
        (rows, cols) float32: a plane fitted to the rings of 1.08 to 1.25 radii, robust against light in them.
    """
    return _spread_out(_dark_plane(frame, confocal, residual)[0], frame)


def _spread_out(plane: Floats, frame: Image) -> Image:
    rows, cols = np.ogrid[: frame.shape[0], : frame.shape[1]]
    return np.asarray(plane[0] + plane[1] * rows + plane[2] * cols, np.float32)


def _dark_plane(frame: Image, confocal: Disc, residual: Disc) -> tuple[Floats, Floats]:
    """Fit level and slopes per row and column of the darkness; return them and their covariance."""
    rows, cols = np.ogrid[: frame.shape[0], : frame.shape[1]]
    away = [np.hypot(rows - d.centre[0], cols - d.centre[1]) / (d.diameter_px / 2) for d in (confocal, residual)]
    nearest = np.minimum(*away)
    y, x = np.nonzero((nearest > 1.08) & (nearest < 1.25))
    if len(y) < MIN_RING_PIXELS:
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


def _residual_to_confocal(motion: Floats, confocal: Disc, residual: Disc) -> Floats:
    """Return the map from residual to confocal in the frame, of a motion from confocal to residual centre."""
    back = np.linalg.inv(motion[:, :2])
    shift = np.array(confocal.centre) - back @ (np.array(residual.centre) + motion[:, 2])
    return np.column_stack([back, shift])


def _gain(
    frame: Image,
    confocal: Disc,
    residual: Disc,
    motion: Floats,
    matcher: CoreMatcher,
    saturated: NDArray[np.bool_] | None,
) -> tuple[float, float]:
    """Return the brightness of the residual view over the confocal, each above darkness, and its uncertainty."""
    plane, covariance = _dark_plane(frame, confocal, residual)
    above_dark = frame - _spread_out(plane, frame)

    def both(image: Image) -> list[Image]:
        views = ((confocal, np.eye(2, 3)), (residual, motion))
        return [
            resampled(image, matcher.grid_to_frame(view.centre, shift), matcher.side)[matcher.inside]
            for view, shift in views
        ]

    first, second = both(above_dark)
    tile, count = tiles(matcher.rows, matcher.cols)
    if saturated is not None and saturated.any():
        around = cv2.GaussianBlur(saturated.astype(np.float32), (0, 0), confocal.diameter_px / 60)
        counts = np.maximum(*both(around)) < MAX_SATURATED_NEARBY
        if not counts.any():
            raise MeasurementError("the bundle's images are saturated all over", "lower the light or the gain")
        first, second, tile = first[counts], second[counts], tile[counts]
    gain = float(second.sum(dtype=np.float64) / first.sum(dtype=np.float64))
    if not GAINS[0] < gain < GAINS[1]:
        raise MeasurementError(
            f"the residual view is {gain:.2f} times as bright as the confocal; {GAINS[0]:g} to {GAINS[1]:g} expected",
            "is one of the views blocked?",
        )
    misses = np.bincount(tile, weights=second - gain * first, minlength=count)
    filled = np.count_nonzero(np.bincount(tile, minlength=count))
    by_tiles = np.sqrt(np.square(misses).sum() * filled / max(filled - 1, 1)) / first.sum()
    by_darkness = (gain * np.array([1, *confocal.centre]) - np.array([1, *residual.centre])) / first.mean()
    return gain, float(np.sqrt(by_tiles**2 + by_darkness @ covariance @ by_darkness))
