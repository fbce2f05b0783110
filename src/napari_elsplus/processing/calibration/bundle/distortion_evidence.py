"""Evidence for distortion in the shifts that an affine fit leaves over in the tiles of the disc.

The shifts are those of one step, so that views without distortion are not fitted again. Their scatter about the
fullest model is their noise: photons, and cores that the camera's pixels sample differently in the two views.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.calibration.bundle.core_matching import (
    COMPARED_DISC,
    CoreFit,
    CoreMatcher,
    circle_points,
    newton_step,
    slopes,
    tiles,
)
from napari_elsplus.processing.calibration.bundle.view_maps import DISTORTED, ViewModel
from napari_elsplus.processing.images.warping import polynomial_terms

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MIN_DISTORTION_PX: Final = 0.02
"""Root mean square over the disc below which distortion is part of the uncertainty; chosen: it adds a tenth of the
alignment error of clean views."""


@dataclass(frozen=True, slots=True)
class TileShifts:
    """Shift of the cores that a fit leaves over, by tile of the disc.

    Parameters
    ----------
    rows, cols : numpy.ndarray
        Mean position about the confocal centre, px, shape (tiles,).
    scores : numpy.ndarray
        Gradient of the match by the shift (row, col), shape (tiles, 2).
    curvature : numpy.ndarray
        Negative derivative of the scores by the shift, shape (tiles, 2, 2): the shift is that of scores over curvature.
    """

    rows: Floats
    cols: Floats
    scores: Floats
    curvature: Floats

    @classmethod
    def left_over(cls, matcher: CoreMatcher, fit: CoreFit) -> TileShifts:
        """Return what a fit to the cores leaves over.

        Parameters
        ----------
        matcher : CoreMatcher
            The cores.
        fit : CoreFit
            To the whole disc.
        """

        def summed(values: Floats) -> Floats:
            sums = np.zeros((count, *values.shape[1:]))
            np.add.at(sums, tile, values)
            return sums[filled]

        inside = matcher.inside
        tile, count = tiles(matcher.rows, matcher.cols)
        pixels = np.bincount(tile, minlength=count)
        filled = pixels > 0
        views = matcher.confocal, matcher.residual_view(matcher.contrast, fit.coefficients)
        moves = np.tensordot(ViewModel.SHIFT.basis, matcher.terms[:, inside], 1)
        target, found = (view[inside].astype(np.float64) for view in views)
        of_target, of_found = (slopes(view, moves, inside) for view in views)
        products = of_target[:, :, None] * of_found[:, None, :]
        return cls(
            rows=summed(matcher.rows) / pixels[filled],
            cols=summed(matcher.cols) / pixels[filled],
            scores=summed(newton_step(target, found, of_target, of_found)[1]),
            curvature=summed((products + products.swapaxes(1, 2)) / 2),
        )


@dataclass(frozen=True, slots=True)
class DistortionEvidence:
    """Models of distortion compared on what an affine fit leaves over.

    Parameters
    ----------
    criterion : dict
        Bayesian information criterion of each model.
    rms_px : float
        Length of the displacement of the tiles beyond an affine one by the fullest model, root mean square.
    left_over_px : float
        The same along a row or column at the rim of the compared disc, less what chance explains.
    """

    criterion: dict[ViewModel, float]
    rms_px: float
    left_over_px: float

    @property
    def needs_distortion(self) -> bool:
        """True if a model of distortion has the lowest criterion, and the displacement is worth modelling."""
        best = min(self.criterion, key=lambda model: self.criterion[model])
        return best is not ViewModel.AFFINE and self.rms_px >= MIN_DISTORTION_PX


def distortion_evidence(shifts: TileShifts, radius_px: float) -> DistortionEvidence:
    """Compare models of distortion on the shifts left over by an affine fit.

    Parameters
    ----------
    shifts : TileShifts
        Of the affine fit.
    radius_px : float
        Of the bundle in the confocal view.

    Returns
    -------
    DistortionEvidence
        Of the affine map alone where the tiles are too few for the fullest model.
    """
    weights, vectors = np.linalg.eigh(shifts.curvature)
    usable = weights[:, 0] > 0
    roots = np.sqrt(weights[usable])[:, :, None] * np.swapaxes(vectors[usable], 1, 2)  # whitens: K = roots.T @ roots
    shift = np.linalg.solve(shifts.curvature[usable], shifts.scores[usable][..., None])
    measured = (roots @ shift).ravel()
    count = len(measured)
    if count <= 2 * len(ViewModel.CUBIC.basis):
        return DistortionEvidence({ViewModel.AFFINE: 0.0}, 0.0, 0.0)
    terms = polynomial_terms(shifts.rows[usable] / radius_px, shifts.cols[usable] / radius_px)
    criterion = {}
    for model in DISTORTED:
        design = (roots @ np.moveaxis(model.basis @ terms, -1, 0).swapaxes(1, 2)).reshape(count, -1)
        parameters = np.linalg.lstsq(design, measured, rcond=None)[0]
        misfit = float(np.square(measured - design @ parameters).sum())
        criterion[model] = count * float(np.log(misfit / count)) + len(parameters) * float(np.log(count))
    covariance = misfit / (count - len(parameters)) * np.linalg.pinv(design.T @ design)
    rim = polynomial_terms(*circle_points(COMPARED_DISC))
    over_tiles, at_rim = _beyond_affine(terms, terms), _beyond_affine(rim, terms)
    by_chance = float(np.einsum("op,pq,oq->o", at_rim, covariance, at_rim).mean())
    found = float(np.square(at_rim @ parameters).mean())
    return DistortionEvidence(
        criterion,
        rms_px=float(np.sqrt(2 * np.square(over_tiles @ parameters).mean())),
        left_over_px=float(np.sqrt(max(found - 2 * by_chance, 0.0))),
    )


def _beyond_affine(at: Floats, over: Floats) -> Floats:
    """Return the displacement of each parameter of the fullest model, less its affine part over some positions.

    Parameters
    ----------
    at, over : numpy.ndarray
        (10, positions): polynomial's terms at the positions of the result, and at those that have the affine part.

    Returns
    -------
    numpy.ndarray
        (2 * positions, parameters).
    """

    def displacements(model: ViewModel, terms: Floats) -> Floats:
        return np.asarray((model.basis @ terms).reshape(len(model.basis), -1).T, np.float64)

    affine, full = ViewModel.AFFINE, ViewModel.CUBIC
    affine_part = np.linalg.pinv(displacements(affine, over)) @ displacements(full, over)
    return displacements(full, at) - displacements(affine, at) @ affine_part
