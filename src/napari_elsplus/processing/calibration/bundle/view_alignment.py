"""Alignment of the residual with the confocal view, and their gain: what a subtraction of the views needs.

The paper extracts both views at their located centres and finds an alignment error of 5.5 % (System Calibration). Here
the cores themselves, which both views show, give the map, its model and its uncertainty. Where a view does not resolve
them, the centres remain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.analysis.uncertainty import information_criterion
from napari_elsplus.processing.calibration.bundle.core_matching import (
    MAX_ROTATION_DEG,
    MAX_SEARCHED_ROTATION_DEG,
    AlignmentModel,
    CoreFit,
    CoreMatcher,
    DifferentCoresError,
    UnresolvedCoresError,
)
from napari_elsplus.processing.calibration.bundle.distortion import DistortionMatcher, DistortionModel
from napari_elsplus.processing.calibration.bundle.distortion_evidence import MIN_DISTORTION_PX, distortion_evidence
from napari_elsplus.processing.calibration.bundle.gain import measure_gain
from napari_elsplus.processing.calibration.bundle.location import MIN_CERTAIN_EDGE, Disc
from napari_elsplus.processing.images.cores import core_pitch_px
from napari_elsplus.processing.images.resampling import cropped, resampled
from napari_elsplus.processing.images.warping import warped

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

MIN_CORRELATION: Final = 0.1
"""Of the aligned cores; chosen, above the correlation of different cores by chance."""
MIN_CLOSE: Final = 0.5
"""Correlation of the cores above which an alignment is correct to within a core; chosen, between those of a bundle's
lattice a core off, 0.2, and of noisy frames, 0.8."""
CERTAIN: Final = 0.95
"""Correlation of the cores above which an alignment is correct everywhere; chosen: of well lit cores it is 0.99."""
MAX_UNCERTAINTY_PX: Final = 1.0
"""Of a fitted map at the rim, above which it follows no cores; chosen: of dim frames it is a tenth."""
MIDDLE: Final = 0.45
"""Part of the radius that even strong distortion leaves aligned; chosen."""
ROTATION_DEG: Final = 0.3
"""Standard deviation of the angle between views of which only the centres are known; chosen: that of the rigs that are
drawn at random for the benchmark, up to 0.5 degrees to either side."""
BESIDE_PX: Final = 3.0
BESIDE_POINTS: Final = 12
"""Distance and number of the points about an alignment at which the views are compared; chosen: a core's spacing."""
MAX_BESIDE: Final = 0.75
"""Correlation there over that of the alignment, above which the cores do not determine it; measured on seven random
rigs (seeds 400 to 406): at most 0.28 in dim light; with a residual view blurred by one spacing of the cores 0.54 to
0.69, and errors are as stated; by 1.5 spacings from 0.77, and by two errors are up to 15 times what is stated."""
SAMPLING_PX: Final = 0.0015
"""Uncertainty of the alignment by the sampling of the cores and interpolation, which the scatter of the disc's tiles
does not contain; measured: with it, slit offsets by the cores of 38 imperfect rigs (seeds of 5600 to 5702; 0.0028 rows
RMS in their middle) are 1.0 standard deviations off, RMS."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """Alignment of the residual with the confocal view.

    Parameters
    ----------
    residual_to_confocal : numpy.ndarray
        Maps (row, col, 1) in the residual view to (row, col) in the confocal, shape (2, 3).
    model : AlignmentModel or DistortionModel
        The model with the lowest Bayesian information criterion.
    evidence : dict
        Bayesian information criterion of each model above the best one's.
    uncertainty_px : float
        One standard deviation of the map along a row or column, at the disc's rim, where it is least certain; includes
        what the next models find left over.
    gain : float
        Brightness of the residual view over the confocal, per area and not per core: of a larger view, each core
        may contain more light than the gain implies.
    gain_uncertainty : float
        One standard deviation of the gain.
    correlation : float
        Between the cores of the two views, once aligned.
    distortion : numpy.ndarray or None
        (2, 10): what the residual view departs from the affine map, as in :class:`Calibration`; None where the affine
        map is sufficient.
    refusal : str
        Why the cores were not matched, where the views are aligned by their centres alone; empty otherwise.
    """

    residual_to_confocal: Floats
    model: AlignmentModel | DistortionModel
    evidence: dict[str, float]
    uncertainty_px: float
    centre_uncertainty_px: float
    gain: float
    gain_uncertainty: float
    correlation: float
    distortion: Floats | None = None
    refusal: str = ""


def align_views(
    image: NDArray[np.generic], confocal: Disc, residual: Disc, saturated: NDArray[np.bool_] | None = None
) -> Alignment:
    """Align the residual with the confocal view by their cores, else by their centres, and measure their gain.

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
        By the centres alone, as in the paper, if the cores do not match because a view does not resolve them, and the
        edge of both views is clearly seen.

    Raises
    ------
    MeasurementError
        If the two views show different cores, or saturation leaves no pixels for the gain.
    """
    views = _Views(np.asarray(image, np.float32), confocal, residual, saturated)
    affine = _affine_fit(views.matcher, MAX_ROTATION_DEG)
    if affine is None or affine.correlation < MIN_CLOSE:
        rotated = _affine_fit(views.matcher, MAX_SEARCHED_ROTATION_DEG)
        affine = rotated if rotated is not None and rotated.correlation > MIN_CLOSE else affine
    try:
        return _core_alignment(views, affine)
    except DifferentCoresError as refusal:
        unresolved = isinstance(refusal, UnresolvedCoresError) or not views.resolve_cores
        if not unresolved or min(confocal.edge_seen, residual.edge_seen) < MIN_CERTAIN_EDGE:
            raise
        return _centre_alignment(views, refusal.problem)


def shift_of_centres(confocal: tuple[float, float], residual: tuple[float, float]) -> Floats:
    """Return the map (2, 3) from the residual to the confocal view by their centres (row, col) alone.

    Parameters
    ----------
    confocal, residual : tuple of float
        Centre of the bundle in each view.
    """
    return np.column_stack([np.eye(2), np.subtract(confocal, residual)])


class _Views:
    """A frame in transmission with both bundle images, whose cores are matched."""

    def __init__(self, frame: Image, confocal: Disc, residual: Disc, saturated: NDArray[np.bool_] | None) -> None:
        self.frame, self.confocal, self.residual = frame, confocal, residual
        self.saturated = saturated
        self.matcher = CoreMatcher(frame, confocal, residual)

    @property
    def resolve_cores(self) -> bool:
        """True if the pattern of the cores stands out in the spectrum of both views."""
        return all(self._resolves_cores(disc) for disc in (self.confocal, self.residual))

    def require_resolved(self, correlation: float, moved: Callable[[Floats], Image]) -> None:
        """Raise an UnresolvedCoresError if aligned views are as alike a core's distance away: they show no cores there.

        Parameters
        ----------
        correlation : float
            Between the aligned views.
        moved : callable
            Returns the residual view (side, side) for a displacement (row, col) from its alignment.
        """
        if correlation > MIN_CLOSE:
            return
        matcher, angles = self.matcher, np.linspace(0, 2 * np.pi, BESIDE_POINTS, endpoint=False)
        target = matcher.confocal[matcher.inside]
        views = (moved(BESIDE_PX * np.array([np.sin(angle), np.cos(angle)])) for angle in angles)
        beside = max(float(np.corrcoef(target, view[matcher.inside])[0, 1]) for view in views)
        if beside > MAX_BESIDE * correlation:
            raise UnresolvedCoresError(
                f"a view does not resolve its cores (correlation {correlation:.2f}, {beside:.2f} beside)",
                "is the bundle in focus in both views?",
            )

    def _resolves_cores(self, view: Disc) -> bool:
        """Return True if the core pattern stands out in the spectrum of a view."""
        matcher = self.matcher
        image = cropped(matcher.contrast, view.centre, matcher.side)
        try:
            core_pitch_px(image, matcher.inside)
        except MeasurementError:
            return False
        return True

    def gain(self, residual_view: Callable[[Image], Image]) -> tuple[float, float]:
        """Return the gain and its uncertainty, of an alignment that resamples the residual view."""
        return measure_gain(self.frame, self.confocal, self.residual, residual_view, self.matcher, self.saturated)

    def residual_to_confocal(self, motion: Floats) -> Floats:
        """Return the map from residual to confocal in the frame, of a motion from confocal to residual centre."""
        back = np.linalg.inv(motion[:, :2])
        shift = np.array(self.confocal.centre) - back @ (np.array(self.residual.centre) + motion[:, 2])
        return np.column_stack([back, shift])


def _core_alignment(views: _Views, affine: CoreFit | None) -> Alignment:
    """Return the alignment by the cores, from an affine fit to them if there is one.

    Raises
    ------
    MeasurementError
        A DifferentCoresError if they do not match.
    """
    if affine is not None and affine.correlation > MIN_CLOSE:
        evidence = distortion_evidence(affine.left_over, views.confocal.diameter_px / 2)
        if not evidence.needs_distortion:
            return _simplest_alignment(views, affine, evidence.left_over_px)
    return _distorted_alignment(views, affine)


def _centre_alignment(views: _Views, refusal: str) -> Alignment:
    """Return the alignment by the centres; what they leave open, angle and scale, is uncertainty."""
    confocal, residual, matcher = views.confocal, views.residual, views.matcher
    gain, gain_uncertainty = views.gain(lambda image: cropped(image, residual.centre, matcher.side))
    pair = cropped(matcher.contrast, residual.centre, matcher.side)[matcher.inside], matcher.confocal[matcher.inside]
    at_rim = (
        np.radians(ROTATION_DEG) * confocal.diameter_px / 2,
        (confocal.diameter_px - residual.diameter_px) / 2,
        confocal.diameter_uncertainty_px / 2,
        residual.diameter_uncertainty_px / 2,
    )
    centres = confocal.centre_uncertainty_px, residual.centre_uncertainty_px
    return Alignment(
        residual_to_confocal=shift_of_centres(confocal.centre, residual.centre),
        model=AlignmentModel.SHIFT,
        evidence={},
        uncertainty_px=float(np.hypot(np.linalg.norm(centres), np.linalg.norm(at_rim) / np.sqrt(2))),
        centre_uncertainty_px=float(np.linalg.norm(centres)),
        gain=gain,
        gain_uncertainty=gain_uncertainty,
        correlation=float(np.corrcoef(*pair)[0, 1]),
        refusal=refusal,
    )


def _affine_fit(matcher: CoreMatcher, rotation_deg: float) -> CoreFit | None:
    """Return the affine fit within a rotation; None if it diverges, as it does on strongly distorted views."""
    try:
        return matcher.fit(matcher.start(rotation_deg=rotation_deg), AlignmentModel.AFFINE)
    except DifferentCoresError:
        return None


def _simplest_alignment(views: _Views, affine: CoreFit, left_over_px: float) -> Alignment:
    """Return the alignment by the simplest sufficient part of an affine fit; distortion left over is uncertainty.

    Raises
    ------
    DifferentCoresError
        If the cores do not determine it.
    """
    criterion = {model: _criterion(affine, model) for model in AlignmentModel}
    model = min(AlignmentModel, key=lambda candidate: criterion[candidate])
    fit = affine if model is AlignmentModel.AFFINE else views.matcher.fit(affine.motion, model)
    if fit.uncertainty_px > MAX_UNCERTAINTY_PX:
        raise _other_cores(fit.correlation)
    views.require_resolved(fit.correlation, lambda by: views.matcher.sample(fit.motion, by))
    grid_to_residual = views.matcher.grid_to_frame(views.residual.centre, fit.motion)
    gain, gain_uncertainty = views.gain(lambda image: resampled(image, grid_to_residual, views.matcher.side))
    return Alignment(
        residual_to_confocal=views.residual_to_confocal(fit.motion),
        model=model,
        evidence={other.value: criterion[other] - criterion[model] for other in AlignmentModel},
        uncertainty_px=float(np.linalg.norm((fit.uncertainty_px, left_over_px, SAMPLING_PX))),
        centre_uncertainty_px=float(np.linalg.norm((fit.centre_uncertainty_px, left_over_px, SAMPLING_PX))),
        gain=gain,
        gain_uncertainty=gain_uncertainty,
        correlation=fit.correlation,
    )


def _distorted_alignment(views: _Views, affine: CoreFit | None) -> Alignment:
    """Return the alignment by the model with the lowest criterion, those with distortion among them.

    Raises
    ------
    MeasurementError
        If the views do not show the same cores under any of them.
    """
    distorted = DistortionMatcher(views.matcher, views.confocal.diameter_px / 2)
    full = None
    if affine is not None and affine.correlation > MIN_CLOSE:
        full = distorted.fit(distorted.start(affine.motion), DistortionModel.CUBIC)
    if full is None or full.correlation < CERTAIN:
        # Where an affine map is off by half a core, a fit that starts from it slips by whole ones.
        grown = distorted.fit(distorted.grown(), DistortionModel.CUBIC)
        full = grown if full is None or grown.correlation > full.correlation else full
    near = full.coefficients
    criterion = {other: full.criterion(other) for other in DistortionModel}
    model = min(DistortionModel, key=lambda candidate: criterion[candidate])
    beyond_px = distorted.rms_px(full.coefficients - distorted.start(distorted.affine_part(full.coefficients)))
    better = affine is None or full.correlation > affine.correlation
    if affine is not None and not (better and model is not DistortionModel.AFFINE and beyond_px > MIN_DISTORTION_PX):
        _require_same_cores(affine.correlation, distorted, near)
        return _simplest_alignment(views, affine, distorted.left_over_px(full, distorted.start(affine.motion)))
    fit = full if model is DistortionModel.CUBIC else distorted.fit(near, model)
    if distorted.uncertainty_px(fit) > MAX_UNCERTAINTY_PX:
        raise _other_cores(0.0)
    _require_same_cores(fit.correlation, distorted, near)
    views.require_resolved(fit.correlation, lambda by: distorted.sample(fit.coefficients, by))
    motion = distorted.affine_part(fit.coefficients)
    gain, gain_uncertainty = views.gain(lambda image: warped(image, distorted.positions(fit.coefficients)))
    left_over_px = distorted.left_over_px(full, fit.coefficients)
    return Alignment(
        residual_to_confocal=views.residual_to_confocal(motion),
        model=model,
        evidence={other.value: criterion[other] - criterion[model] for other in DistortionModel},
        uncertainty_px=float(np.linalg.norm((distorted.uncertainty_px(fit), left_over_px, SAMPLING_PX))),
        centre_uncertainty_px=float(np.linalg.norm((distorted.centre_uncertainty_px(fit), left_over_px, SAMPLING_PX))),
        gain=gain,
        gain_uncertainty=gain_uncertainty,
        correlation=fit.correlation,
        distortion=fit.coefficients - distorted.start(motion),
    )


def _require_same_cores(correlation: float, distorted: DistortionMatcher, near: Floats) -> None:
    """Raise an error if the aligned views do not show the same cores; it names distortion where the middle fits."""
    if correlation > MIN_CORRELATION:
        return
    middle = distorted.fit(near, DistortionModel.AFFINE, MIDDLE).correlation
    if middle > MIN_CLOSE:
        raise MeasurementError(
            f"the views show the same cores in the middle (correlation {middle:.2f}), not at the rim "
            f"({correlation:.2f}): one is distorted by more than a polynomial of third degree describes",
            "is a lens tilted or the wrong way round, and the rim in focus in both views?",
        )
    raise _other_cores(correlation)


def _other_cores(correlation: float) -> DifferentCoresError:
    return DifferentCoresError(
        f"the two views do not show the same cores (correlation {correlation:.2f})",
        "is the bundle in focus in both, the light bright enough, and neither view mirrored?",
    )


def _criterion(affine: CoreFit, model: AlignmentModel) -> float:
    """Return the Bayesian information criterion of a model by the affine fit."""
    omitted, influence = model.constraints @ affine.departure, affine.influence @ model.constraints.T
    return information_criterion(omitted, influence, len(model.matrices))
