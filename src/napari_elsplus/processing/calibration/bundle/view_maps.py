"""Distortion of the residual against the confocal view, fitted to the cores as a polynomial of third degree.

Each model is a linear space of polynomials, and contains the one before it; the Newton steps are those of
:meth:`CoreMatcher.fit`. The fit begins in the middle of the disc, where the views differ by less than a core.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg import null_space

from napari_elsplus.processing.analysis.uncertainty import estimator_influence, information_criterion
from napari_elsplus.processing.calibration.bundle.core_matching import (
    CoreMatcher,
    circle_points,
    newton_step,
    slopes,
    tiles,
)
from napari_elsplus.processing.images.warping import POWERS, polynomial_terms, warped

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

GROWING: Final = (0.35, 0.5, 0.65, 0.8)
"""Parts of the bundle's radius on which the fit begins; chosen: a lens distorted by 1 % displaces the cores of each by
less than a third of their spacing from where the fit to the one before expects them."""
SCALES: Final = (1.0, 0.99, 1.01, 0.98, 1.02)
"""Scales of the middle over that of the diameters that are tried; chosen: they cover distortion of 2 % of the rim to
within a third of a core."""
GROWING_STEPS: Final = 7
"""Shifts to either side that are tried there; derived: a lens distorted by 1 % about the sensor's centre displaces the
discs' rims by three pixels against the cores in their middle, and those of the first part by one."""
MAX_STEPS: Final = 12
"""Newton steps of a fit; measured: five suffice on frames distorted by 1 %."""


class DistortionModel(StrEnum):
    """Maps from the confocal to the residual view, from the simplest."""

    AFFINE = "affine"
    RADIAL = "radial distortion"
    CUBIC = "cubic distortion"

    @property
    def basis(self) -> Floats:
        """Coefficients of the polynomials that span the model, shape (parameters, 2, 10)."""
        unit = np.eye(2 * len(POWERS)).reshape(-1, 2, len(POWERS))
        if self is DistortionModel.CUBIC:
            return unit
        affine = [unit[axis * len(POWERS) + term] for axis in (0, 1) for term in (0, 1, 2)]
        if self is DistortionModel.AFFINE:
            return np.array(affine)

        def field(row: dict[tuple[int, int], float], col: dict[tuple[int, int], float]) -> Floats:
            return np.array([[part.get(power, 0.0) for power in POWERS] for part in (row, col)])

        radial = [
            field({(3, 0): 1, (1, 2): 1}, {(2, 1): 1, (0, 3): 1}),  # r^2 p
            field({(2, 0): 3, (0, 2): 1}, {(1, 1): 2}),  # its derivative by the row of its centre, and by the column
            field({(1, 1): 2}, {(0, 2): 3, (2, 0): 1}),
        ]
        return np.array(affine + radial)


@dataclass(frozen=True, slots=True)
class DistortedFit:
    """One polynomial fitted to the cores.

    Parameters
    ----------
    coefficients : numpy.ndarray
        (2, 10): row and column about the residual centre, px, of the terms of the position about the confocal centre
        over the bundle's radius.
    basis : numpy.ndarray
        (parameters, 2, 10): the model.
    influence : numpy.ndarray
        Contribution of each tile of the disc to the errors of the parameters, shape (tiles, parameters).
    correlation : float
        Between the aligned contrasts.
    """

    coefficients: Floats
    basis: Floats
    influence: Floats
    correlation: float

    def criterion(self, model: DistortionModel) -> float:
        """Return the Bayesian information criterion of a model.

        Parameters
        ----------
        model : DistortionModel
            Contained in the fitted one.
        """
        space = model.basis.reshape(len(model.basis), -1)
        omitted = null_space(space).T
        influence = self.influence @ (omitted @ self.basis.reshape(len(self.basis), -1).T).T
        return information_criterion(omitted @ self.coefficients.ravel(), influence, len(space))


class DistortionMatcher:
    """Fits of distorted maps to the cores of both views.

    Parameters
    ----------
    matcher : CoreMatcher
        The cores on a grid about the confocal centre.
    radius_px : float
        Of the bundle in the confocal view: the polynomial's unit.

    Attributes
    ----------
    terms : numpy.ndarray
        (10, side, side): the polynomial's terms on the grid.
    """

    def __init__(self, matcher: CoreMatcher, radius_px: float) -> None:
        self.matcher, self.radius_px = matcher, radius_px
        axis = (np.arange(matcher.side) - (matcher.side - 1) / 2) / radius_px
        self.terms = polynomial_terms(*np.meshgrid(axis, axis, indexing="ij"))

    def positions(self, coefficients: Floats) -> Floats:
        """Return row and column in the frame of each pixel of the grid, (2, side, side), for (2, 10) coefficients.

        Parameters
        ----------
        coefficients : numpy.ndarray
            (2, 10) map, as in :class:`DistortedFit`.
        """
        centre = np.reshape(self.matcher.residual_centre, (2, 1, 1))
        return np.asarray(np.tensordot(coefficients, self.terms, 1) + centre, np.float64)

    def start(self, motion: Floats) -> Floats:
        """Return the coefficients (2, 10) of an affine motion (2, 3) about the centres.

        Parameters
        ----------
        motion : numpy.ndarray
            (2, 3), as in :class:`CoreFit`.
        """
        coefficients = np.zeros((2, len(POWERS)))
        coefficients[:, 0], coefficients[:, 1:3] = motion[:, 2], self.radius_px * motion[:, :2]
        return coefficients

    def affine_part(self, coefficients: Floats) -> Floats:
        """Return the affine motion (2, 3) about the centres that is nearest to a map in the compared disc.

        Parameters
        ----------
        coefficients : numpy.ndarray
            (2, 10) map, as in :class:`DistortedFit`.
        """
        terms = self.terms[:, self.matcher.inside]
        motion = np.linalg.lstsq(terms[:3].T, (coefficients @ terms).T, rcond=None)[0].T
        return np.column_stack([motion[:, 1:] / self.radius_px, motion[:, 0]])

    def rms_px(self, coefficients: Floats) -> float:
        """Return the root mean square length of a displacement (2, 10) over the compared disc.

        Parameters
        ----------
        coefficients : numpy.ndarray
            (2, 10) displacement, px.
        """
        return float(np.sqrt(np.square(coefficients @ self.terms[:, self.matcher.inside]).sum(axis=0).mean()))

    @property
    def _rim(self) -> Floats:
        """Terms at 24 points of the compared disc's rim, (10, 24)."""
        rim = float(np.hypot(self.matcher.rows, self.matcher.cols).max()) / self.radius_px
        return polynomial_terms(*circle_points(rim))

    def uncertainty_px(self, fit: DistortedFit) -> float:
        """Return one standard deviation of a fitted map along a row or column, at the rim.

        Parameters
        ----------
        fit : DistortedFit
            With the influence of the disc's tiles.
        """
        errors = np.tensordot(fit.influence, np.tensordot(fit.basis, self._rim, 1), 1)
        return float(np.sqrt(np.square(errors).sum(axis=0).mean()))

    def centre_uncertainty_px(self, fit: DistortedFit) -> float:
        """Return one standard deviation of a fitted map along a row or column, in the disc's centre.

        Parameters
        ----------
        fit : DistortedFit
            With the influence of the disc's tiles.
        """
        return float(np.linalg.norm(np.tensordot(fit.influence, fit.basis[..., 0], 1)) / np.sqrt(2))

    def left_over_px(self, full: DistortedFit, coefficients: Floats) -> float:
        """Return how far a map departs from the fullest one along a row or column, at the rim, beyond chance.

        Parameters
        ----------
        full : DistortedFit
            The fullest model.
        coefficients : numpy.ndarray
            (2, 10): the map.
        """
        departure = np.square((full.coefficients - coefficients) @ self._rim).mean()
        return float(np.sqrt(max(departure - 2 * self.uncertainty_px(full) ** 2, 0.0)))

    def grown(self) -> Floats:
        """Return coefficients (2, 10) fitted to discs that grow, from a motion found in the middle of the disc."""
        coefficients = self.start(self.matcher.start(GROWING[0], SCALES, GROWING_STEPS))
        coefficients = self.fit(coefficients, DistortionModel.AFFINE, GROWING[0]).coefficients
        for part in GROWING[1:]:
            coefficients = self.fit(coefficients, DistortionModel.RADIAL, part).coefficients
        return coefficients

    def fit(self, start: Floats, model: DistortionModel, part: float = 1.0) -> DistortedFit:
        """Fit a model by Newton steps, to the part of the disc within a share of its radius.

        Parameters
        ----------
        start : numpy.ndarray
            (2, 10) coefficients that are correct to within a core, of any model.
        model : DistortionModel
            The map.
        part : float
            Share of the bundle's radius.
        """
        matcher, basis = self.matcher, model.basis
        used = np.hypot(matcher.rows, matcher.cols) < part * self.radius_px
        pixels = matcher.inside.copy()
        pixels[matcher.inside] = used
        moves = np.tensordot(basis, self.terms[:, pixels], 1)
        coefficients = _nearest(start, basis, moves, self.terms[:, pixels])
        target = matcher.confocal[pixels].astype(np.float64)
        of_target = slopes(matcher.confocal, moves, pixels)
        for _ in range(MAX_STEPS):
            moved = warped(matcher.contrast, self.positions(coefficients))
            found = moved[pixels].astype(np.float64)
            step, scores, curvature = newton_step(target, found, of_target, slopes(moved, moves, pixels))
            moved_px = float(np.abs(np.tensordot(step, moves, 1)).max())
            if moved_px > 0.2 * self.radius_px:
                break
            coefficients = coefficients + np.tensordot(step, basis, 1)
            if moved_px < 2e-3:
                break
        tile, count = tiles(matcher.rows[used], matcher.cols[used])
        influence = estimator_influence(scores, curvature, tile, count)
        return DistortedFit(coefficients, basis, influence, float(np.corrcoef(target, found)[0, 1]))

    def sample(self, coefficients: Floats, by: Floats) -> Image:
        """Return the contrast of the residual view on the grid, (side, side), for a map.

        Parameters
        ----------
        coefficients : numpy.ndarray
            (2, 10) map, as in :class:`DistortedFit`.
        by : numpy.ndarray
            Displacement (row, col) that is added, px.
        """
        moved = coefficients.copy()
        moved[:, 0] += by
        return warped(self.matcher.contrast, self.positions(moved))


def _nearest(coefficients: Floats, basis: Floats, moves: Floats, terms: Floats) -> Floats:
    """Return the coefficients (2, 10) of a model that are nearest to others by the displacement of points.

    Parameters
    ----------
    coefficients : numpy.ndarray
        (2, 10) of a model that may contain more.
    basis : numpy.ndarray
        (parameters, 2, 10): the model.
    moves, terms : numpy.ndarray
        Displacement of the points by each parameter, (parameters, 2, points), and the polynomial's terms there.
    """
    products = np.tensordot(moves, moves, ((1, 2), (1, 2)))
    along = np.tensordot(moves, coefficients @ terms, ((1, 2), (0, 1)))
    return np.asarray(np.tensordot(np.linalg.lstsq(products, along, rcond=None)[0], basis, 1), np.float64)
