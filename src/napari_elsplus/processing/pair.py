"""The right view laid onto the left: to a fraction of a pixel, by the cores that both show, and its brightness.

Centres and diameters of the two discs give shift and scale, a search over angles the rotation, and Gauss-Newton on the
pixels the rest (Lucas & Kanade 1981; Baker & Matthews 2004, https://doi.org/10.1023/B:VISI.0000011205.11775.fd). The
motion is no richer than the pair needs: shift, similarity or affine, whichever the Bayesian information criterion
prefers with one sample per core.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.uncertainty import clustered_influence

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.bundle import Disc

    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

STEEPEST_TURN_DEG: Final = 2.0
INNER: Final = 0.9
SAMPLE_PX: Final = 3.0
TILES: Final = 8
LEAST_CORRELATION: Final = 0.1
STRONG_EVIDENCE: Final = 6.0


class PairModel(StrEnum):
    """How the right view may differ from the left, from the simplest."""

    SHIFT = "shift"
    SIMILARITY = "similarity"
    AFFINE = "affine"

    def basis(self, rows: Floats, cols: Floats) -> Floats:
        """Displacements (row, col) per parameter at points relative to the centre: shape (parameters, 2, points)."""
        one, zero = np.ones_like(rows), np.zeros_like(rows)
        shift = [[one, zero], [zero, one]]
        match self:
            case PairModel.SHIFT:
                terms = shift
            case PairModel.SIMILARITY:
                terms = [*shift, [rows, cols], [-cols, rows]]
            case PairModel.AFFINE:
                terms = [*shift, [rows, zero], [cols, zero], [zero, rows], [zero, cols]]
        return np.array(terms)


@dataclass(frozen=True, slots=True)
class Alignment:
    """The right view laid onto the left.

    Parameters
    ----------
    residual_to_confocal : numpy.ndarray
        Maps (row, col, 1) in the right view to (row, col) in the left, shape (2, 3).
    model : PairModel
        The simplest motion that the evidence asks for.
    evidence : dict
        Bayesian information criterion of each model above the smallest; a richer model has to win by 6.
    uncertainty_px : float
        Largest standard deviation of the map inside the disc.
    gain : float
        Brightness of the right view over the left.
    gain_uncertainty : float
        One standard deviation of the gain.
    correlation : float
        Between the cores of the two views, once aligned.
    """

    residual_to_confocal: Floats
    model: PairModel
    evidence: dict[str, float]
    uncertainty_px: float
    gain: float
    gain_uncertainty: float
    correlation: float


def align_pair(image: NDArray[np.generic], left: Disc, right: Disc) -> Alignment:
    """Lay the right view onto the left by their cores, and compare their brightness.

    Parameters
    ----------
    image : numpy.ndarray
        Raw frame (rows, cols) of the bundle lit from its far end.
    left, right : Disc
        The two discs, from :func:`napari_elsplus.processing.bundle.locate_pair`.

    Returns
    -------
    Alignment

    Raises
    ------
    MeasurementError
        If the two views do not show the same cores.
    """
    frame = np.asarray(image, np.float32)
    radius = left.diameter_px / 2
    n = 2 * int(np.ceil(radius)) + 5
    rows, cols = np.mgrid[:n, :n] - (n - 1) / 2.0
    disc = np.hypot(rows, cols) < INNER * radius
    disc &= _on_frame(frame, left, rows, cols) & _on_frame(frame, right, rows, cols)
    motion = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    texture = _texture(frame, radius)
    confocal = _sample(texture, left.centre, motion, rows, cols)
    motion[:, :2] *= right.diameter_px / left.diameter_px
    motion = _turn(texture, confocal, right.centre, motion, rows, cols, disc)
    motion = _step_to_the_best_core(texture, confocal, right.centre, motion, rows, cols, disc)
    cores = max(100.0, disc.sum() / SAMPLE_PX**2)
    fits = {model: _refine(texture, confocal, right.centre, motion, rows, cols, disc, model) for model in PairModel}
    criterion = {
        model: cores * np.log(fit.misfit) + len(model.basis(rows[:1, 0], cols[:1, 0])) * np.log(cores)
        for model, fit in fits.items()
    }
    least = min(criterion.values())
    best = next(model for model in PairModel if criterion[model] < least + STRONG_EVIDENCE)
    fit = fits[best]
    if not fit.correlation > LEAST_CORRELATION:
        raise MeasurementError(
            f"the two views do not show the same cores (correlation {fit.correlation:.2f})",
            "is the bundle in focus in both, and the light bright enough?",
        )
    gain, gain_uncertainty = _gain(frame, left, right, fit.motion, rows, cols, disc)
    return Alignment(
        residual_to_confocal=_absolute(fit.motion, left, right),
        model=best,
        evidence={model.value: float(criterion[model] - least) for model in PairModel},
        uncertainty_px=fit.uncertainty_px,
        gain=gain,
        gain_uncertainty=gain_uncertainty,
        correlation=fit.correlation,
    )


@dataclass(frozen=True, slots=True)
class _Fit:
    motion: Floats
    misfit: float
    correlation: float
    uncertainty_px: float


def _on_frame(frame: Image, disc: Disc, rows: Floats, cols: Floats) -> NDArray[np.bool_]:
    row, col = disc.centre[0] + rows, disc.centre[1] + cols
    inside: NDArray[np.bool_] = (row >= 3) & (row < frame.shape[0] - 3) & (col >= 3) & (col < frame.shape[1] - 3)
    return inside


def _texture(frame: Image, radius: float) -> Image:
    """Contrast of the cores: light over its local mean, so that neither gain nor uneven light matters."""
    fine = cv2.GaussianBlur(frame, (0, 0), 0.8)
    mean = cv2.GaussianBlur(frame, (0, 0), max(4.0, radius / 12))
    dark = float(np.percentile(mean, 1))
    floor = 0.05 * float(np.percentile(mean - dark, 95))
    contrast: Image = (fine - mean) / np.maximum(mean - dark, max(floor, 1e-6))
    return contrast


def _sample(image: Image, centre: tuple[float, float], motion: Floats, rows: Floats, cols: Floats) -> Image:
    """Image at centre + motion of the points (rows, cols)."""
    at_row = centre[0] + motion[0, 2] + motion[0, 0] * rows + motion[0, 1] * cols
    at_col = centre[1] + motion[1, 2] + motion[1, 0] * rows + motion[1, 1] * cols
    sampled: Image = cv2.remap(image, at_col.astype(np.float32), at_row.astype(np.float32), cv2.INTER_LANCZOS4)
    return sampled


def _correlation(a: Image, b: Image, disc: NDArray[np.bool_]) -> float:
    return float(np.corrcoef(a[disc], b[disc])[0, 1])


def _turn(
    texture: Image,
    confocal: Image,
    centre: tuple[float, float],
    motion: Floats,
    rows: Floats,
    cols: Floats,
    disc: NDArray[np.bool_],
) -> Floats:
    """Best rotation: the only number that the discs' edges do not tell."""
    rim = float(np.hypot(rows[disc], cols[disc]).max())
    step = 0.5 / rim
    count = int(np.radians(STEEPEST_TURN_DEG) / step)
    turned = [_rotated(motion, k * step) for k in range(-count, count + 1)]
    scores = [_correlation(confocal, _sample(texture, centre, m, rows, cols), disc) for m in turned]
    return turned[int(np.argmax(scores))]


def _rotated(motion: Floats, angle: float) -> Floats:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.column_stack([turn @ motion[:, :2], motion[:, 2]])


def _step_to_the_best_core(
    texture: Image,
    confocal: Image,
    centre: tuple[float, float],
    motion: Floats,
    rows: Floats,
    cols: Floats,
    disc: NDArray[np.bool_],
) -> Floats:
    """Shift that correlates best: a lattice nearly matches a pitch away, only the right cores match fully."""
    moved = np.where(disc, _sample(texture, centre, motion, rows, cols), 0).astype(np.float32)
    reach = 6
    template = np.where(disc, confocal, 0).astype(np.float32)[reach:-reach, reach:-reach]
    score = cv2.matchTemplate(moved, template, cv2.TM_CCOEFF_NORMED)
    row, col = np.unravel_index(np.argmax(score), score.shape)
    stepped = motion.copy()
    stepped[:, 2] += np.array([row - reach, col - reach])
    return stepped


def _refine(
    texture: Image,
    confocal: Image,
    centre: tuple[float, float],
    motion: Floats,
    rows: Floats,
    cols: Floats,
    disc: NDArray[np.bool_],
    model: PairModel,
) -> _Fit:
    """Gauss-Newton on the pixels with one model; a shift starts without the scale and turn of the search."""
    motion = motion.copy()
    if model is PairModel.SHIFT:
        motion[:, :2] = np.eye(2)
    y, x = rows[disc], cols[disc]
    basis = model.basis(y, x)
    target = confocal[disc].astype(np.float64)
    jacobian = np.empty((len(target), len(basis)))
    residuals = target
    for _ in range(20):
        moved = _sample(texture, centre, motion, rows, cols)
        gradient = np.stack(
            [cv2.Scharr(0.5 * (moved + confocal), cv2.CV_32F, *axis)[disc] / 32 for axis in ((0, 1), (1, 0))]
        )
        jacobian = np.einsum("kap,ap->pk", basis, gradient).astype(np.float64)
        found = moved[disc].astype(np.float64)
        scale = float(found @ target) / max(float(target @ target), 1e-12)
        residuals = scale * target - found
        step = np.linalg.lstsq(jacobian.T @ jacobian, jacobian.T @ residuals, rcond=None)[0]
        motion = motion + _as_motion(step, model)
        if np.abs(np.einsum("kap,k->ap", basis, step)).max() < 1e-3:
            break
    moved = _sample(texture, centre, motion, rows, cols)
    rim = float(np.hypot(y, x).max())
    tile = _tiles(y, x, rim)
    influence = clustered_influence(jacobian, residuals, tile, (TILES + 1) ** 2)
    ring = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    at_rim = model.basis(rim * np.sin(ring), rim * np.cos(ring))
    errors = np.einsum("ck,kap->cap", influence, at_rim)
    return _Fit(
        motion=motion,
        misfit=float(np.mean(np.square(residuals))),
        correlation=_correlation(confocal, moved, disc),
        uncertainty_px=float(np.sqrt(np.square(errors).sum(axis=0)).max()),
    )


def _tiles(rows: Floats, cols: Floats, rim: float) -> NDArray[np.intp]:
    """Return the number of the square tile in which each point lies."""
    down, across = (((at / rim + 1) * TILES / 2).astype(np.intp) for at in (rows, cols))
    return down * (TILES + 1) + across


def _as_motion(step: Floats, model: PairModel) -> Floats:
    """Parameters of a model as a 2 x 3 matrix."""
    match model:
        case PairModel.SHIFT:
            return np.array([[0, 0, step[0]], [0, 0, step[1]]])
        case PairModel.SIMILARITY:
            return np.array([[step[2], -step[3], step[0]], [step[3], step[2], step[1]]])
        case PairModel.AFFINE:
            return np.array([[step[2], step[3], step[0]], [step[4], step[5], step[1]]])


def _absolute(motion: Floats, left: Disc, right: Disc) -> Floats:
    """Motion about the centres, left to right, as the matrix from right to left in the frame's coordinates."""
    back = np.linalg.inv(motion[:, :2])
    shift = np.array(left.centre) - back @ (np.array(right.centre) + motion[:, 2])
    return np.column_stack([back, shift])


def _gain(
    frame: Image,
    left: Disc,
    right: Disc,
    motion: Floats,
    rows: Floats,
    cols: Floats,
    disc: NDArray[np.bool_],
) -> tuple[float, float]:
    """Brightness of the right view over the left, each above the darkness around it."""
    confocal, residual = (
        _sample(frame, view.centre, shift, rows, cols)[disc].astype(np.float64) - darkness(frame, view, left, right)
        for view, shift in ((left, np.eye(2, 3)), (right, motion))
    )
    y, x = rows[disc], cols[disc]
    rim = float(np.hypot(y, x).max())
    tile = _tiles(y, x, rim)
    gain = float(residual.sum() / confocal.sum())
    misses = np.bincount(tile, weights=residual - gain * confocal)
    filled = np.count_nonzero(np.bincount(tile))
    spread = np.sqrt(np.square(misses).sum() * filled / max(filled - 1, 1)) / confocal.sum()
    return gain, float(spread)


def darkness(frame: NDArray[np.float32], view: Disc, left: Disc, right: Disc) -> float:
    """Level beside a disc, where no bundle is: a ring of 1.08 to 1.25 radii, as much of it as the frame shows."""
    rows, cols = np.ogrid[: frame.shape[0], : frame.shape[1]]
    distance = [np.hypot(rows - d.centre[0], cols - d.centre[1]) / (d.diameter_px / 2) for d in (view, left, right)]
    ring = (distance[0] > 1.08) & (distance[0] < 1.25) & (distance[1] > 1.08) & (distance[2] > 1.08)
    return float(np.mean(frame[ring])) if ring.any() else float(frame.min())
