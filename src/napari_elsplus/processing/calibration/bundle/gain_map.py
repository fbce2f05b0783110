"""Map of the residual view's gain over the field: vignettes, and cores that couple differently into the two views.

A single gain is kept unless the evidence supports a map. Evidence is prediction: a map that is made from every other
pixel of the bundle lit from its far end must predict the other pixels better, or vary over the field as that of the
other pixels does, which noise and the cores' sampling by the camera do not.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.calibration.bundle.core_matching import COMPARED_DISC
from napari_elsplus.processing.calibration.bundle.gain import GAINS
from napari_elsplus.processing.images.cores import core_pitch_px
from napari_elsplus.processing.images.sectioning import Sectioner, disc

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

    Image = NDArray[np.float32]

DEGREE: Final = 4
"""Of the smooth map's polynomial; chosen: a vignette of cos^4, and the cubic distortion of either view."""
CORE_PITCHES: Final = (0.2, 0.3)
"""Those of maps of single cores, core pitches; derived: of the light at a core 80 and 60 % is then its own."""
MAX_MISFIT: Final = 0.9
"""Of the predicted pixels over that of a single gain, with which a map is used; measured on the
clean views of twelve random rigs (seeds 500 to 511): it is larger in all of them."""
MIN_VARIATION: Final = 0.004
"""Standard deviation of the smooth map over the field, with which it is used even where the cores' sampling hides it
from the misfit; measured: at most 0.0034 on the clean views of 36 random rigs (seeds 500 to 523, 600 to 611)."""
_LIT: Final = 0.05
"""Share of the mean light below which a pixel has no gain of its own; chosen."""


def measure_gain_map(frame: NDArray[np.floating], calibration: Calibration) -> Image | None:
    """Measure the gain of the residual view over the field.

    Parameters
    ----------
    frame : numpy.ndarray
        (rows, cols): the bundle lit from its far end.
    calibration : Calibration
        With the bundle section, and the darkness of that frame as its background; its own gain map is not used.

    Returns
    -------
    numpy.ndarray or None
        (n, n) float32 on the grid of :class:`Sectioner`, gain over the single one: 1 outside of the disc, and such that
        the residual view divided by it keeps its light in the part of it in which the single gain is measured. None
        where a single gain is sufficient.
    """
    flat = calibration.with_view_arrays(calibration.distortion, None)
    sectioner = Sectioner(flat, frame.shape)
    confocal, residual = sectioner.ls(frame), sectioner.residual(frame)
    inside = disc(sectioner.side, sectioner.diameter_px) & np.isfinite(residual)
    residual = np.where(inside, residual, 0).astype(np.float32)
    confocal = np.where(inside, confocal, 0).astype(np.float32)
    weights = confocal * disc(sectioner.side, COMPARED_DISC * sectioner.diameter_px)
    every_other = (np.indices(confocal.shape).sum(axis=0) % 2).astype(bool)
    halves = inside & every_other, inside & ~every_other
    single = sum(_misfit(confocal, residual, half) for half in halves)
    ratios: list[Callable[[Image, Image], Image]] = [_polynomial_ratio]
    ratios += [partial(_smoothed_ratio, sigma_px=sigma_px) for sigma_px in _core_scales(confocal, inside)]
    maps = [[ratio(confocal * half, residual * half) for half in halves] for ratio in ratios]
    misfits = [
        sum(_misfit(confocal * made, residual, half) for made, half in zip(pair, reversed(halves), strict=True))
        for pair in maps
    ]
    best = int(np.argmin(misfits))
    if not misfits[best] < MAX_MISFIT * single:
        best = 0
        if not _common_variation(maps[0][0], maps[0][1], weights) > MIN_VARIATION:
            return None
    found = np.where(inside, np.clip(ratios[best](confocal, residual), *GAINS), 1)
    # Its mean would not do: light divided by a map that varies from core to core is more than light over the mean.
    light = residual * disc(sectioner.side, COMPARED_DISC * sectioner.diameter_px)
    scale = float(light.sum(dtype=np.float64) / (light / found).sum(dtype=np.float64))
    return np.where(inside, found / scale, 1).astype(np.float32)


def _core_scales(confocal: Image, inside: NDArray[np.bool_]) -> list[float]:
    """Return the standard deviations of the maps of single cores that are tried, px; none if they are not resolved."""
    try:
        pitch_px = core_pitch_px(confocal, inside)
    except MeasurementError:
        return []
    return [pitches * pitch_px for pitches in CORE_PITCHES]


def _common_variation(one: Image, other: Image, weights: Image) -> float:
    """Return the weighted standard deviation of what two maps have in common: noise of their own cancels."""
    share = weights / weights.sum(dtype=np.float64)
    covariance = float((share * one * other).sum() - (share * one).sum() * (share * other).sum())
    return float(np.sqrt(max(covariance, 0.0)))


def _smoothed_ratio(confocal: Image, residual: Image, sigma_px: float) -> Image:
    light, other = (cv2.GaussianBlur(image, (0, 0), sigma_px) for image in (confocal, residual))
    dim = light < _LIT * float(light.max())
    return np.where(dim, 1, other / np.where(dim, 1, light)).astype(np.float32)


def _polynomial_ratio(confocal: Image, residual: Image) -> Image:
    """Return the polynomial of the place that takes the confocal light to as much residual light, in all its moments.

    Unlike a fit of one image to the other it is not weakened by what noise and sampling change in single pixels; unlike
    a smoothed ratio it is as exact at the rim.
    """
    powers = np.vander(np.linspace(-1, 1, len(confocal)), 2 * DEGREE + 1, increasing=True)
    lit, other = (powers.T @ image @ powers for image in (confocal, residual))
    down, across = np.nonzero(np.add.outer(np.arange(DEGREE + 1), np.arange(DEGREE + 1)) <= DEGREE)
    factors = np.zeros((DEGREE + 1, DEGREE + 1))
    factors[down, across] = np.linalg.solve(
        lit[np.add.outer(down, down), np.add.outer(across, across)], other[down, across]
    )
    terms = powers[:, : DEGREE + 1]
    return np.asarray(terms @ factors @ terms.T, np.float32)


def _misfit(predicted: Image, residual: Image, where: NDArray[np.bool_]) -> float:
    """Return the root mean square difference of two images over some pixels."""
    return float(np.sqrt(np.square((predicted - residual)[where]).mean()))
