"""Matching of the cores of two views to a hundredth of a pixel.

Centres and diameters of the discs give shift and scale, a search over angles the rotation, a correlation the right
one among the lattice's near matches, and Newton steps on the pixels the rest, in the manner of Lucas & Kanade (1981;
Baker & Matthews 2004, https://doi.org/10.1023/B:VISI.0000011205.11775.fd).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
from scipy.linalg import null_space

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.analysis.uncertainty import estimator_influence, information_criterion
from napari_elsplus.processing.calibration.bundle.view_maps import ViewModel, affine_map, nearest_affine
from napari_elsplus.processing.images.distortion import polynomial_terms
from napari_elsplus.processing.images.resampling import cropped, resampled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.bundle.location import Disc

    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

MAX_ROTATION_DEG: Final = 2.0
"""Between the views; chosen: four times the rotation of the rigs that are drawn at random for the benchmark."""
MAX_SEARCHED_ROTATION_DEG: Final = 10.0
"""Between views whose cores do not match within :data:`MAX_ROTATION_DEG`; chosen: five times as long a search."""
COMPARED_DISC: Final = 0.9
"""Of the diameter; as the paper's alignment error."""
TILES: Final = 8
"""Across the disc, the clusters of the uncertainty; chosen: each is wider than several cores."""
SEARCHED_POINTS: Final = 5_000
"""Pixels compared in the search; chosen: enough to rank shifts, a tenth of the disc's."""
SHIFT_STEP_PX: Final = 0.75
"""Chosen: a quarter of a core's spacing."""
SMOOTHING_PX: Final = 0.8
"""Standard deviation of the Gaussian that suppresses what pixels sample too coarsely to be interpolated, above 0.35
cycles per pixel; measured: where cores are 2.0 and 2.3 px apart, 20 pairs are aligned to 0.0043 and 0.0032 px RMS; with
0.6 px to 0.022 and 0.0064 px; with 1.0 px noise is more."""
STEP_PX: Final = 0.125
"""To either side, for the derivatives of the confocal view; chosen: 3 % less at half a cycle per pixel."""
SHIFT_STEPS: Final = 4
"""To either side; derived: they cover the spacing of cores."""
MAX_STEPS: Final = 12
"""Newton steps of a fit; measured: five suffice on frames distorted by 1 %."""
MAX_STEP: Final = 0.2
"""Of the bundle's radius, above which a fit diverges; chosen: many cores."""
CONVERGED_PX: Final = 1e-3
"""Largest displacement by the last step; chosen."""


class DifferentCoresError(MeasurementError):
    """The cores of the two views do not match."""


class UnresolvedCoresError(DifferentCoresError):
    """A view does not resolve its cores, so that they do not determine how it is aligned."""


@dataclass(frozen=True, slots=True)
class CoreFit:
    """One model fitted to the cores.

    Parameters
    ----------
    coefficients : numpy.ndarray
        (2, 10): the map from the confocal to the residual view, as in
        :mod:`napari_elsplus.processing.calibration.bundle.view_maps`.
    departure : numpy.ndarray
        The model's parameters, px: of the map less the identity, shape (parameters,).
    model : ViewModel
        That they belong to.
    influence : numpy.ndarray
        Contribution of each tile of the disc to the errors of the parameters, shape (tiles, parameters).
    correlation : float
        Between the aligned contrasts; 0 where the steps of the fit diverge.
    """

    coefficients: Floats
    departure: Floats
    model: ViewModel
    influence: Floats
    correlation: float

    def uncertainty_px(self, terms: Floats) -> float:
        """Return one standard deviation of the map along a row or column, root mean square over some points.

        Parameters
        ----------
        terms : numpy.ndarray
            (10, points): the polynomial's terms there.
        """
        errors = np.tensordot(self.influence, self.model.basis @ terms, 1)
        return float(np.sqrt(np.square(errors).sum(axis=0).mean()))

    def criterion(self, model: ViewModel) -> float:
        """Return the Bayesian information criterion of a model.

        Parameters
        ----------
        model : ViewModel
            Contained in the fitted one.
        """
        fitted, simpler = (one.basis.reshape(len(one.basis), -1) for one in (self.model, model))
        omitted = null_space(simpler @ np.linalg.pinv(fitted)).T
        # The inverse of a covariance that few tiles scatter by is too large in its mean (Wishart's distribution).
        free = np.count_nonzero(self.influence.any(axis=1)) - len(self.departure) / 2
        influence = np.sqrt(free / max(free - len(omitted) - 1, 1.0)) * self.influence @ omitted.T
        return information_criterion(omitted @ self.departure, influence, len(simpler))


class CoreMatcher:
    """The cores of both views on one grid about the confocal centre.

    Parameters
    ----------
    frame : numpy.ndarray
        Frame (rows, cols), float32, of the bundle lit from its far end.
    confocal, residual : Disc
        The two discs in it.

    Attributes
    ----------
    side : int
        Rows and columns of the grid.
    inside : numpy.ndarray
        (side, side) bool: the pixels that are compared, those of the 90 % disc that the frame contains in both views.
    rows, cols : numpy.ndarray
        Their positions about the confocal centre, shape (points,).
    radius_px : float
        Of the bundle in the confocal view.
    terms : numpy.ndarray
        (10, side, side): terms of the maps' polynomials on the grid.
    rim : numpy.ndarray
        (10, 24): the same on the rim of the compared disc.
    contrast : numpy.ndarray
        (rows, cols) float32: the frame's light over its local mean.
    confocal : numpy.ndarray
        (side, side) float32: the contrast of the confocal view on the grid.
    """

    def __init__(self, frame: Image, confocal: Disc, residual: Disc) -> None:
        self.radius_px = confocal.diameter_px / 2
        self.side = 2 * int(np.ceil(self.radius_px)) + 5
        rows, cols = np.mgrid[: self.side, : self.side] - (self.side - 1) / 2.0
        self.inside = np.hypot(rows, cols) < COMPARED_DISC * self.radius_px
        for disc in (confocal, residual):
            for at, centre, size in zip((rows, cols), disc.centre, frame.shape, strict=True):
                self.inside &= (centre + at >= 3) & (centre + at < size - 3)
        self.rows, self.cols = rows[self.inside], cols[self.inside]
        self.terms = polynomial_terms(rows / self.radius_px, cols / self.radius_px)
        self.rim = polynomial_terms(*circle_points(float(np.hypot(self.rows, self.cols).max()) / self.radius_px))
        self._residual_centre = residual.centre
        self._scale = residual.diameter_px / confocal.diameter_px
        self.contrast = core_contrast(frame, self.radius_px)
        self.confocal = cropped(self.contrast, confocal.centre, self.side)
        row, col = confocal.centre
        steps = ((row - STEP_PX, col), (row + STEP_PX, col)), ((row, col - STEP_PX), (row, col + STEP_PX))
        ends = ([cropped(self.contrast, at, self.side) for at in step] for step in steps)
        self._derivatives = np.stack([(after - before) / (2 * STEP_PX) for before, after in ends])

    def start(
        self,
        part: float = 1.0,
        scales: Sequence[float] = (1.0,),
        steps: int = SHIFT_STEPS,
        rotation_deg: float = MAX_ROTATION_DEG,
    ) -> Floats:
        """Estimate the map (2, 10) to within half a core: scale from the diameters, angle and shift by correlation.

        Parameters
        ----------
        part : float
            Share of the compared disc's radius within which the cores are compared.
        scales : sequence of float
            Factors to the ratio of the diameters that are tried: distorted views differ more at the rim than inside.
        steps : int
            Of :data:`SHIFT_STEP_PX`, to either side.
        rotation_deg : float
            Largest rotation that is tried, to either side.

        Notes
        -----
        The discs' rims do not determine the angle; the shift corrects a rim that is a core off, where the lattices
        nearly match too.
        """
        motion = np.array([[self._scale, 0.0, 0.0], [0.0, self._scale, 0.0]])
        away = np.hypot(self.rows, self.cols)
        central = np.flatnonzero(away <= part * away.max())
        some = central[:: -(-len(central) // SEARCHED_POINTS)]
        rows, cols = self.rows[some], self.cols[some]
        target = self.confocal[self.inside][some]
        target = (target - target.mean()) / target.std()
        shifts = SHIFT_STEP_PX * np.arange(-steps, steps + 1)
        down, across = (grid.ravel() for grid in np.meshgrid(shifts, shifts, indexing="ij"))
        step = 0.5 / float(np.hypot(rows, cols).max())
        count = int(np.radians(rotation_deg) / step)
        best, found = -1.0, motion
        for turned in (_rotated(scale * motion, k * step) for scale in scales for k in range(-count, count + 1)):
            row, col = turned @ np.stack([rows, cols, np.ones_like(rows)]) + np.array(self._residual_centre)[:, None]
            at_row, at_col = (at.astype(np.float32) for at in (row + down[:, None], col + across[:, None]))
            values = cv2.remap(self.contrast, at_col, at_row, cv2.INTER_LINEAR)
            scores = (values @ target) / len(target) / np.maximum(values.std(axis=1), 1e-9)
            if scores.max() > best:
                best = float(scores.max())
                found = turned.copy()
                found[:, 2] += (down[scores.argmax()], across[scores.argmax()])
        return affine_map(found, self.radius_px)

    def fit(self, start: Floats, model: ViewModel, part: float = 1.0) -> CoreFit:
        """Fit a model by Newton steps, to the part of the disc within a share of its radius.

        Parameters
        ----------
        start : numpy.ndarray
            (2, 10) map that is correct to within a core, of any model.
        model : ViewModel
            The map.
        part : float
            Share of the bundle's radius.
        """
        used = np.hypot(self.rows, self.cols) < part * self.radius_px
        pixels = self.inside.copy()
        pixels[self.inside] = used
        moves = np.tensordot(model.basis, self.terms[:, pixels], 1)
        departure = _nearest(start - self.identity, moves, self.terms[:, pixels])
        target = self.confocal[pixels].astype(np.float64)
        of_target, response = (along(by, moves, pixels) for by in (differences(self.confocal), self._derivatives))
        for _ in range(MAX_STEPS):
            coefficients = self.identity + np.tensordot(departure, model.basis, 1)
            moved = self.residual_view(self.contrast, coefficients)
            found = moved[pixels].astype(np.float64)
            of_found = along(differences(moved), moves, pixels)
            step, scores, curvature = newton_step(target, found, of_target, of_found, response)
            moved_px = float(np.abs(np.tensordot(step, moves, 1)).max())
            diverges = moved_px > MAX_STEP * self.radius_px
            if diverges:
                break
            departure = departure + step
            if moved_px < CONVERGED_PX:
                break
        return CoreFit(
            coefficients=self.identity + np.tensordot(departure, model.basis, 1),
            departure=departure,
            model=model,
            influence=estimator_influence(scores, curvature, *tiles(self.rows[used], self.cols[used])),
            correlation=0.0 if diverges else float(np.corrcoef(target, found)[0, 1]),
        )

    @property
    def identity(self) -> Floats:
        """Coefficients (2, 10) of the map by the centres alone."""
        return affine_map(np.eye(2, 3), self.radius_px)

    def motion(self, coefficients: Floats) -> Floats:
        """Return the affine motion (2, 3) about the centres that is nearest to a map in the compared disc.

        Parameters
        ----------
        coefficients : numpy.ndarray
            (2, 10) map.
        """
        return nearest_affine(coefficients, self.terms[:, self.inside], self.radius_px)

    def residual_view(self, image: Image, coefficients: Floats) -> Image:
        """Return the residual view of an image on the grid, (side, side) float32.

        Parameters
        ----------
        image : numpy.ndarray
            (rows, cols) float32, of the frame's shape.
        coefficients : numpy.ndarray
            (2, 10) map from the confocal to the residual view.
        """
        centre = np.reshape(self._residual_centre, (2, 1, 1))
        return resampled(image, np.tensordot(coefficients, self.terms, 1) + centre)

    def rms_px(self, displacement: Floats) -> float:
        """Return the root mean square length of a displacement over the compared disc.

        Parameters
        ----------
        displacement : numpy.ndarray
            (2, 10) coefficients, px.
        """
        return float(np.sqrt(np.square(displacement @ self.terms[:, self.inside]).sum(axis=0).mean()))


def _nearest(displacement: Floats, moves: Floats, terms: Floats) -> Floats:
    """Return the parameters of a model that are nearest to a displacement (2, 10) at some points.

    Parameters
    ----------
    displacement : numpy.ndarray
        (2, 10) of a model that may contain more.
    moves, terms : numpy.ndarray
        Displacement of the points by each parameter, (parameters, 2, points), and the polynomial's terms there.
    """
    products = np.tensordot(moves, moves, ((1, 2), (1, 2)))
    along = np.tensordot(moves, displacement @ terms, ((1, 2), (0, 1)))
    return np.asarray(np.linalg.lstsq(products, along, rcond=None)[0], np.float64)


def differences(image: Image) -> Image:
    """Return the central differences of an image (side, side) along its rows and columns, (2, side, side)."""
    return np.stack([np.asarray(np.gradient(image, axis=axis), np.float32) for axis in (0, 1)])


def along(gradient: Image, moves: Floats, pixels: NDArray[np.bool_]) -> Floats:
    """Return the derivative of an image by each parameter of a motion, shape (points, parameters).

    Parameters
    ----------
    gradient : numpy.ndarray
        Derivatives of the image along rows and columns, (2, side, side) float32.
    moves : numpy.ndarray
        Displacement of the points by each parameter, (parameters, 2, points).
    pixels : numpy.ndarray
        (side, side) bool: the points.
    """
    down, across = (by[pixels] for by in gradient)
    return np.asarray((moves[:, 0] * down + moves[:, 1] * across).T, np.float64)


def newton_step(
    target: Floats, found: Floats, of_target: Floats, of_found: Floats, response: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the step that aligns two images, the scores of their points, and the curvature of the match.

    Of the sums of least squares, only products of the one image with the other are kept. Products of an image with
    itself vanish on the signal, but not on its noise, which would rotate and stretch the fit in dim light.

    Parameters
    ----------
    target, found : numpy.ndarray
        Both images at the same points, (points,).
    of_target, of_found : numpy.ndarray
        Their differences between neighbouring pixels, of :func:`along`, which suppress what the pixels alias.
    response : numpy.ndarray
        Derivative of the target: by this the images change as they move. Where cores are three pixels apart, the
        differences are half as large: with them in its place, steps would be too long, and uncertainties too large.
    """
    curvature = response.T @ of_found
    curvature = (curvature + curvature.T) / 2
    scores = (of_found * target[:, None] - of_target * found[:, None]) / 2
    return np.linalg.lstsq(curvature, scores.sum(axis=0), rcond=None)[0], scores, curvature


def circle_points(radius: float) -> tuple[Floats, Floats]:
    """Return rows and columns of 24 points of a circle of a `radius` about 0."""
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    return radius * np.sin(angles), radius * np.cos(angles)


def tiles(rows: Floats, cols: Floats) -> tuple[NDArray[np.intp], int]:
    """Return the square tile of each point of a disc, at rows and cols about its centre, and the number of tiles."""
    reach = 1.001 * max(float(np.abs(rows).max()), float(np.abs(cols).max()))
    down, across = (((at / reach + 1) * TILES / 2).astype(np.intp) for at in (rows, cols))
    return down * TILES + across, TILES**2


def _rotated(motion: Floats, angle: float) -> Floats:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.column_stack([turn @ motion[:, :2], motion[:, 2]])


def core_contrast(frame: Image, radius: float, smoothing_px: float = SMOOTHING_PX) -> Image:
    """Return the contrast of the cores: light over its local mean, independent of gain and uneven light.

    Parameters
    ----------
    frame : numpy.ndarray
        (rows, cols) float32 grey levels.
    radius, smoothing_px : float
        Of the bundle's image, px; standard deviation of the Gaussian against noise and what cannot be interpolated.
    """
    fine = cv2.GaussianBlur(frame, (0, 0), smoothing_px)
    mean = cv2.GaussianBlur(frame, (0, 0), max(4.0, radius / 12))
    dark = float(np.percentile(mean, 1))
    floor = 0.05 * float(np.percentile(mean - dark, 95))
    contrast: Image = (fine - mean) / np.maximum(mean - dark, max(floor, 1e-6))
    return contrast
