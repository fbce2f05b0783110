"""Matching of the cores of two views to a hundredth of a pixel.

Centres and diameters of the discs give shift and scale, a search over angles the rotation, a correlation the right
one among the lattice's near matches, and Newton steps on the pixels the rest, in the manner of Lucas & Kanade (1981;
Baker & Matthews 2004, https://doi.org/10.1023/B:VISI.0000011205.11775.fd).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.analysis.uncertainty import estimator_influence
from napari_elsplus.processing.images.resampling import cropped, resampled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

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
cycles per pixel; measured: where cores are 2.0 and 2.3 px apart, 20 pairs are aligned to 0.0043 and 0.0032 px RMS, 1.2
and 0.9 times what is stated; with 0.6 px to 0.022 and 0.0064 px, 6.6 and 2.1 times; with 1.0 px noise is more."""
SHIFT_STEPS: Final = 4
"""To either side; derived: they cover the spacing of cores."""


class DifferentCoresError(MeasurementError):
    """The cores of the two views do not match."""


class UnresolvedCoresError(DifferentCoresError):
    """A view does not resolve its cores, so that they do not determine how it is aligned."""


class AlignmentModel(StrEnum):
    """Motion models from the confocal to the residual view, from the simplest."""

    SHIFT = "shift"
    SIMILARITY = "similarity"
    AFFINE = "affine"

    @property
    def matrices(self) -> Floats:
        """The 2 x 3 matrix of each parameter, acting on (row, col, 1): shape (parameters, 2, 3)."""
        shift = [[[0, 0, 1], [0, 0, 0]], [[0, 0, 0], [0, 0, 1]]]
        match self:
            case AlignmentModel.SHIFT:
                terms = shift
            case AlignmentModel.SIMILARITY:
                terms = [*shift, [[1, 0, 0], [0, 1, 0]], [[0, -1, 0], [1, 0, 0]]]
            case AlignmentModel.AFFINE:
                terms = [*shift, [[1, 0, 0], [0, 0, 0]], [[0, 1, 0], [0, 0, 0]]]
                terms += [[[0, 0, 0], [1, 0, 0]], [[0, 0, 0], [0, 1, 0]]]
        return np.array(terms, np.float64)

    @property
    def constraints(self) -> Floats:
        """Combinations of affine parameters, less the identity, that vanish in this model: (constraints, 6)."""
        match self:
            case AlignmentModel.SHIFT:
                return np.eye(6)[2:]
            case AlignmentModel.SIMILARITY:
                return np.array([[0.0, 0, 1, 0, 0, -1], [0, 0, 0, 1, 1, 0]])
            case AlignmentModel.AFFINE:
                return np.zeros((0, 6))

    def nearest(self, matrix: Floats) -> Floats:
        """Return the matrix of this model that is nearest to a matrix, both 2 x 2."""
        match self:
            case AlignmentModel.SHIFT:
                return np.eye(2)
            case AlignmentModel.SIMILARITY:
                stretch, turn = matrix[0, 0] + matrix[1, 1], matrix[1, 0] - matrix[0, 1]
                return np.array([[stretch, -turn], [turn, stretch]]) / 2
            case AlignmentModel.AFFINE:
                return matrix

    def displacements(self, rows: Floats, cols: Floats) -> Floats:
        """Return the displacement (row, col) of points at rows and cols."""
        points = np.stack([rows, cols, np.ones_like(rows)])
        return np.asarray(self.matrices @ points, np.float64)


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


@dataclass(frozen=True, slots=True)
class CoreFit:
    """One model fitted to the cores.

    Parameters
    ----------
    motion : numpy.ndarray
        Maps (row, col, 1) about the confocal centre to (row, col) about the residual centre, shape (2, 3).
    influence : numpy.ndarray
        Contribution of each tile of the disc to the errors of the model's parameters, shape (tiles, parameters).
    correlation : float
        Between the aligned contrasts.
    uncertainty_px : float
        One standard deviation of the motion along a row or column, at the rim.
    left_over : TileShifts
        Of each tile of the disc that is compared.
    """

    motion: Floats
    influence: Floats
    correlation: float
    uncertainty_px: float
    left_over: TileShifts

    @property
    def centre_uncertainty_px(self) -> float:
        """One standard deviation of the motion along a row or column, in the disc's centre."""
        return float(np.linalg.norm(self.influence[:, :2]) / np.sqrt(2))

    @property
    def departure(self) -> Floats:
        """The motion less the identity, as parameters of the affine model: shift, then the matrix row by row."""
        return np.concatenate([self.motion[:, 2], (self.motion[:, :2] - np.eye(2)).ravel()])


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
    residual_centre : tuple of float
        Row and column of the residual disc's centre in the frame.
    contrast : numpy.ndarray
        (rows, cols) float32: the frame's light over its local mean.
    confocal : numpy.ndarray
        (side, side) float32: the contrast of the confocal view on the grid.
    """

    def __init__(self, frame: Image, confocal: Disc, residual: Disc) -> None:
        radius = confocal.diameter_px / 2
        self.side = 2 * int(np.ceil(radius)) + 5
        rows, cols = np.mgrid[: self.side, : self.side] - (self.side - 1) / 2.0
        self.inside = np.hypot(rows, cols) < COMPARED_DISC * radius
        for disc in (confocal, residual):
            for at, centre, size in zip((rows, cols), disc.centre, frame.shape, strict=True):
                self.inside &= (centre + at >= 3) & (centre + at < size - 3)
        self.rows, self.cols = rows[self.inside], cols[self.inside]
        self.residual_centre = residual.centre
        self._scale = residual.diameter_px / confocal.diameter_px
        self.contrast = core_contrast(frame, radius)
        self.confocal = cropped(self.contrast, confocal.centre, self.side)

    def grid_to_frame(self, centre: tuple[float, float], motion: Floats) -> Floats:
        """Return the map from the grid's (row, col, 1) to the frame, for a motion about a centre, shape (2, 3)."""
        moved = np.array(motion, np.float64)
        moved[:, 2] += np.array(centre) - moved[:, :2] @ np.full(2, (self.side - 1) / 2)
        return moved

    def start(
        self,
        part: float = 1.0,
        scales: Sequence[float] = (1.0,),
        steps: int = SHIFT_STEPS,
        rotation_deg: float = MAX_ROTATION_DEG,
    ) -> Floats:
        """Estimate the motion to within half a core: scale from the diameters, angle and shift by correlation.

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
            row, col = turned @ np.stack([rows, cols, np.ones_like(rows)]) + np.array(self.residual_centre)[:, None]
            at_row, at_col = (at.astype(np.float32) for at in (row + down[:, None], col + across[:, None]))
            values = cv2.remap(self.contrast, at_col, at_row, cv2.INTER_LINEAR)
            scores = (values @ target) / len(target) / np.maximum(values.std(axis=1), 1e-9)
            if scores.max() > best:
                best = float(scores.max())
                found = turned.copy()
                found[:, 2] += (down[scores.argmax()], across[scores.argmax()])
        return found

    def fit(self, start: Floats, model: AlignmentModel) -> CoreFit:
        """Fit a model by Newton steps.

        Parameters
        ----------
        start : numpy.ndarray
            Motion that is correct to within a core, shape (2, 3).
        model : AlignmentModel
            Motion model.

        Raises
        ------
        DifferentCoresError
            If the steps diverge.
        """
        motion = start.copy()
        motion[:, :2] = model.nearest(motion[:, :2])
        moves = model.displacements(self.rows, self.cols)
        target = self.confocal[self.inside].astype(np.float64)
        of_target = slopes(self.confocal, moves, self.inside)
        for _ in range(20):
            moved = self.sample(motion)
            found = moved[self.inside].astype(np.float64)
            of_found = slopes(moved, moves, self.inside)
            step, scores, curvature = newton_step(target, found, of_target, of_found)
            motion = motion + np.tensordot(step, model.matrices, 1)
            moved_px = float(np.abs(np.tensordot(step, moves, 1)).max())
            if moved_px > self.side / 4:
                raise DifferentCoresError(
                    f"the two views do not show the same cores: their alignment diverges by {moved_px:.0f} px",
                    "is the bundle lit from its far end, and in focus in both views?",
                )
            if moved_px < 1e-3:
                break
        tile, count = tiles(self.rows, self.cols)
        influence = estimator_influence(scores, curvature, tile, count)
        return CoreFit(
            motion=motion,
            influence=influence,
            correlation=float(np.corrcoef(target, found)[0, 1]),
            uncertainty_px=self._at_rim(influence, model),
            left_over=self._left_over(of_target[:, :2], of_found[:, :2], scores[:, :2], tile, count),
        )

    def _left_over(
        self, of_target: Floats, of_found: Floats, scores: Floats, tile: NDArray[np.intp], count: int
    ) -> TileShifts:
        """Sum scores and curvature of the shift, whose derivatives are given, over each tile."""

        def summed(values: Floats) -> Floats:
            return np.asarray(np.bincount(tile, weights=values, minlength=count)[filled], np.float64)

        pixels = np.bincount(tile, minlength=count)
        filled = pixels > 0
        one, two = of_target.T.copy(), of_found.T.copy()
        mixed = summed(one[0] * two[1] + one[1] * two[0]) / 2
        curvature = np.array([[summed(one[0] * two[0]), mixed], [mixed, summed(one[1] * two[1])]])
        return TileShifts(
            rows=summed(self.rows) / pixels[filled],
            cols=summed(self.cols) / pixels[filled],
            scores=np.stack([summed(column) for column in scores.T], axis=1),
            curvature=np.moveaxis(curvature, -1, 0),
        )

    def sample(self, motion: Floats, by: ArrayLike = (0.0, 0.0)) -> Image:
        """Return the contrast of the residual view on the grid, (side, side), for a motion and a displacement `by`."""
        moved = motion + np.column_stack([np.zeros((2, 2)), by])
        return resampled(self.contrast, self.grid_to_frame(self.residual_centre, moved), self.side)

    def _at_rim(self, influence: Floats, model: AlignmentModel) -> float:
        rim = circle_points(float(np.hypot(self.rows, self.cols).max()))
        errors = np.tensordot(influence, model.displacements(*rim), 1)
        return float(np.sqrt(np.square(errors).sum(axis=0).mean()))


def slopes(image: Image, moves: Floats, pixels: NDArray[np.bool_]) -> Floats:
    """Return the derivative of an image by each parameter of a motion, shape (points, parameters).

    Parameters
    ----------
    image : numpy.ndarray
        (side, side) float32.
    moves : numpy.ndarray
        Displacement of the points by each parameter, (parameters, 2, points).
    pixels : numpy.ndarray
        (side, side) bool: the points.
    """
    down, across = (np.asarray(np.gradient(image, axis=axis))[pixels] for axis in (0, 1))
    return np.asarray((moves[:, 0] * down + moves[:, 1] * across).T, np.float64)


def newton_step(target: Floats, found: Floats, of_target: Floats, of_found: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the step that aligns two images, the scores of their points, and the curvature of the match.

    Of the sums of least squares, only products of the one image with the other are kept. Products of an image with
    itself vanish on the signal, but not on its noise, which would rotate and stretch the fit in dim light.

    Parameters
    ----------
    target, found : numpy.ndarray
        Both images at the same points, (points,).
    of_target, of_found : numpy.ndarray
        Their derivatives, of :func:`slopes`.
    """
    curvature = of_target.T @ of_found
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
