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
from napari_elsplus.processing.calibration.bundle.core_matching import (
    MAX_ROTATION_DEG,
    MAX_SEARCHED_ROTATION_DEG,
    CoreFit,
    CoreMatcher,
    DifferentCoresError,
    UnresolvedCoresError,
)
from napari_elsplus.processing.calibration.bundle.gain import measure_gain
from napari_elsplus.processing.calibration.bundle.location import MIN_CERTAIN_EDGE, Disc
from napari_elsplus.processing.calibration.bundle.view_maps import DISTORTED, UNDISTORTED, ViewModel, affine_map
from napari_elsplus.processing.images.cores import core_pitch_px
from napari_elsplus.processing.images.distortion import polynomial_terms
from napari_elsplus.processing.images.resampling import cropped

if TYPE_CHECKING:
    from collections.abc import Sequence

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
MIN_DISTORTION_PX: Final = 0.02
"""Root mean square over the disc below which distortion is part of the uncertainty; chosen: it adds a tenth of the
alignment error of clean views."""
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
does not contain; measured: with it, errors in the middle of 16 rigs in light of 20,000 electrons (random, seeds 5000
to 5015) are 1.3 times what is stated where cores are 2.0 px apart, and 0.4 to 0.5 times from 2.3 to 3.2 px, RMS."""

GROWING: Final = (0.35, 0.5, 0.65, 0.8)
"""Parts of the bundle's radius on which the fit of a distorted view begins; chosen: a lens distorted by 1 % displaces
the cores of each by less than a third of their spacing from where the fit to the one before expects them."""
SCALES: Final = (1.0, 0.99, 1.01, 0.98, 1.02)
"""Scales of the middle over that of the diameters that are tried; chosen: they cover distortion of 2 % of the rim to
within a third of a core."""
GROWING_STEPS: Final = 7
"""Shifts to either side that are tried there; derived: a lens distorted by 1 % about the sensor's centre displaces the
discs' rims by three pixels against the cores in their middle, and those of the first part by one."""
CENTRE: Final = polynomial_terms(np.zeros(1), np.zeros(1))
"""Terms of the maps' polynomials in the disc's centre."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """Alignment of the residual with the confocal view.

    Parameters
    ----------
    residual_to_confocal : numpy.ndarray
        Maps (row, col, 1) in the residual view to (row, col) in the confocal, shape (2, 3).
    model : ViewModel
        The model with the lowest Bayesian information criterion.
    evidence : dict
        Bayesian information criterion of each model above the best one's.
    uncertainty_px : float
        One standard deviation of the map along a row or column, at the disc's rim, where it is least certain; includes
        what fuller models find left over, as far as they are probable.
    centre_uncertainty_px : float
        The same in the disc's centre.
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
    model: ViewModel
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
    if affine.correlation < MIN_CLOSE:
        rotated = _affine_fit(views.matcher, MAX_SEARCHED_ROTATION_DEG)
        affine = rotated if rotated.correlation > MIN_CLOSE else affine
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
        matcher = self.matcher
        try:
            for view in (self.confocal, self.residual):
                core_pitch_px(cropped(matcher.contrast, view.centre, matcher.side), matcher.inside)
        except MeasurementError:
            return False
        return True

    def require_resolved(self, fit: CoreFit) -> None:
        """Raise an UnresolvedCoresError if aligned views are as alike a core's distance away: they show no cores there.

        Parameters
        ----------
        fit : CoreFit
            That aligns them.
        """
        if fit.correlation > MIN_CLOSE:
            return
        angles = np.linspace(0, 2 * np.pi, BESIDE_POINTS, endpoint=False)
        by = BESIDE_PX * np.stack([np.sin(angles), np.cos(angles)], axis=1)
        beside = max(self.correlation(fit.coefficients + np.outer(shift, CENTRE)) for shift in by)
        if beside > MAX_BESIDE * fit.correlation:
            raise UnresolvedCoresError(
                f"a view does not resolve its cores (correlation {fit.correlation:.2f}, {beside:.2f} beside)",
                "is the bundle in focus in both views?",
            )

    def correlation(self, coefficients: Floats) -> float:
        """Return the correlation of the views' contrasts under a map (2, 10)."""
        matcher = self.matcher
        view = matcher.residual_view(matcher.contrast, coefficients)
        return float(np.corrcoef(matcher.confocal[matcher.inside], view[matcher.inside])[0, 1])

    def gain(self, coefficients: Floats) -> tuple[float, float]:
        """Return the gain and its uncertainty under a map (2, 10)."""
        return measure_gain(self.frame, self.confocal, self.residual, self.matcher, coefficients, self.saturated)

    def residual_to_confocal(self, motion: Floats) -> Floats:
        """Return the map from residual to confocal in the frame, of a motion from confocal to residual centre."""
        back = np.linalg.inv(motion[:, :2])
        shift = np.array(self.confocal.centre) - back @ (np.array(self.residual.centre) + motion[:, 2])
        return np.column_stack([back, shift])


def _core_alignment(views: _Views, affine: CoreFit) -> Alignment:
    """Return the alignment by the model with the lowest criterion, from an affine fit to the cores.

    Raises
    ------
    MeasurementError
        If the views do not show the same cores under any of them; a DifferentCoresError if the cores do not match.
    """
    matcher, full = views.matcher, affine
    if affine.correlation > MIN_CLOSE:
        full = matcher.fit(affine.coefficients, ViewModel.CUBIC)
    if full.correlation < CERTAIN:
        # Where an affine map is off by half a core, a fit that starts from it slips by whole ones.
        grown = matcher.fit(_grown(matcher), ViewModel.CUBIC)
        full = grown if full is affine or grown.correlation > full.correlation else full
    evidence = distorted = _evidence(full, DISTORTED)
    beyond_px = matcher.rms_px(full.coefficients - affine_map(matcher.motion(full.coefficients), matcher.radius_px))
    containing = best = max(affine, full, key=lambda fit: fit.correlation)
    if best is affine or evidence[ViewModel.AFFINE] == 0 or beyond_px < MIN_DISTORTION_PX:
        containing = matcher.fit(best.coefficients, ViewModel.AFFINE)
        evidence = _evidence(containing, UNDISTORTED)
    model = min(evidence, key=lambda candidate: evidence[candidate])
    fit = containing if model is containing.model else matcher.fit(containing.coefficients, model)
    _require_same_cores(matcher, fit, full)
    if fit.uncertainty_px(matcher.rim) > MAX_UNCERTAINTY_PX:
        raise _other_cores(fit.correlation)
    likelihood = np.exp(-np.array([distorted[candidate] for candidate in DISTORTED]) / 2)
    further = DISTORTED.index(max(model, ViewModel.AFFINE, key=list(ViewModel).index)) + 1
    omitted = float(likelihood[further:].sum() / likelihood.sum())
    at_rim, in_centre = (_uncertainty_px(fit, full, omitted, at) for at in (matcher.rim, CENTRE))
    return _alignment(views, fit, evidence, at_rim, in_centre)


def _centre_alignment(views: _Views, refusal: str) -> Alignment:
    """Return the alignment by the centres; what they leave open, angle and scale, is uncertainty."""
    confocal, residual, identity = views.confocal, views.residual, views.matcher.identity
    gain, gain_uncertainty = views.gain(identity)
    at_rim = (
        np.radians(ROTATION_DEG) * confocal.diameter_px / 2,
        (confocal.diameter_px - residual.diameter_px) / 2,
        confocal.diameter_uncertainty_px / 2,
        residual.diameter_uncertainty_px / 2,
    )
    centres = confocal.centre_uncertainty_px, residual.centre_uncertainty_px
    return Alignment(
        residual_to_confocal=shift_of_centres(confocal.centre, residual.centre),
        model=ViewModel.SHIFT,
        evidence={},
        uncertainty_px=float(np.hypot(np.linalg.norm(centres), np.linalg.norm(at_rim) / np.sqrt(2))),
        centre_uncertainty_px=float(np.linalg.norm(centres)),
        gain=gain,
        gain_uncertainty=gain_uncertainty,
        correlation=views.correlation(identity),
        refusal=refusal,
    )


def _affine_fit(matcher: CoreMatcher, rotation_deg: float) -> CoreFit:
    """Return the affine fit within a rotation."""
    return matcher.fit(matcher.start(rotation_deg=rotation_deg), ViewModel.AFFINE)


def _evidence(full: CoreFit, models: Sequence[ViewModel]) -> dict[ViewModel, float]:
    """Return the criterion of each model above the best one's, by a fit of one that contains them."""
    criterion = {model: full.criterion(model) for model in models}
    return {model: value - min(criterion.values()) for model, value in criterion.items()}


def _uncertainty_px(fit: CoreFit, full: CoreFit, omitted: float, terms: Floats) -> float:
    """Return one standard deviation of a map along a row or column, root mean square over some points.

    Parameters
    ----------
    fit, full : CoreFit
        Fit of the map's model, and of the fullest one.
    omitted : float
        Probability of the models of distortion that contain more (of Bayesian model averaging; Hoeting et al. 1999,
        https://doi.org/10.1214/ss/1009212519): so much of what the fullest fit departs by, beyond chance, counts.
    terms : numpy.ndarray
        (10, points): the polynomial's terms there.
    """
    variance = fit.uncertainty_px(terms) ** 2
    chance = max(full.uncertainty_px(terms) ** 2 - variance, 0.0)
    departure = float(np.square((full.coefficients - fit.coefficients) @ terms).mean())
    return float(np.sqrt(variance + omitted * max(departure - chance, 0.0) + SAMPLING_PX**2))


def _grown(matcher: CoreMatcher) -> Floats:
    """Return a map (2, 10) fitted to discs that grow, from one found in the middle of the disc."""
    coefficients = matcher.fit(
        matcher.start(GROWING[0], SCALES, GROWING_STEPS), ViewModel.AFFINE, GROWING[0]
    ).coefficients
    for part in GROWING[1:]:
        coefficients = matcher.fit(coefficients, ViewModel.RADIAL, part).coefficients
    return coefficients


def _alignment(
    views: _Views, fit: CoreFit, evidence: dict[ViewModel, float], at_rim: float, in_centre: float
) -> Alignment:
    """Return the alignment by a fit, and its uncertainty at the rim and in the centre, px.

    Raises
    ------
    MeasurementError
        If a view does not resolve its cores, or the gain is out of range.
    """
    matcher = views.matcher
    views.require_resolved(fit)
    gain, gain_uncertainty = views.gain(fit.coefficients)
    motion = matcher.motion(fit.coefficients)
    beyond = fit.coefficients - affine_map(motion, matcher.radius_px)
    return Alignment(
        residual_to_confocal=views.residual_to_confocal(motion),
        model=fit.model,
        evidence={model.value: above for model, above in evidence.items()},
        uncertainty_px=at_rim,
        centre_uncertainty_px=in_centre,
        gain=gain,
        gain_uncertainty=gain_uncertainty,
        correlation=fit.correlation,
        distortion=None if fit.model in UNDISTORTED else beyond,
    )


def _require_same_cores(matcher: CoreMatcher, fit: CoreFit, full: CoreFit) -> None:
    """Raise an error if the aligned views do not show the same cores; it names distortion where the middle fits."""
    if fit.correlation > MIN_CORRELATION:
        return
    middle = matcher.fit(full.coefficients, ViewModel.AFFINE, MIDDLE).correlation
    if middle > MIN_CLOSE:
        raise MeasurementError(
            f"the views show the same cores in the middle (correlation {middle:.2f}), not at the rim "
            f"({fit.correlation:.2f}): one is distorted by more than a polynomial of third degree describes",
            "is a lens tilted or the wrong way round, and the rim in focus in both views?",
        )
    raise _other_cores(fit.correlation)


def _other_cores(correlation: float) -> DifferentCoresError:
    return DifferentCoresError(
        f"the two views do not show the same cores (correlation {correlation:.2f})",
        "is the bundle in focus in both, the light bright enough, and neither view mirrored?",
    )
