"""Image quality by the paper's measures: saturation scaling, alignment error, contrast, edge artefact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.errors import MeasurementError
from napari_elsplus.instrument.arguments import Choice
from napari_elsplus.processing.images.modes import Mode
from napari_elsplus.processing.images.sectioning import disc

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray

SATURATED_FRACTION: Final = 1e-4
"""Fraction of pixels shown as white (the paper normalises images individually, "allowing 0.01 % saturation")."""
PAPER_ALIGNMENT_PERCENT: Final = (5.5, 0.74)
"""The paper's alignment error for a USAF target in transmission, per cent: unfiltered, and after the core filter."""
USED_DIAMETER: Final = 0.9
"""Diameter of the disc that measures are taken in, fraction of the bundle's diameter (the paper's circular crop)."""


def white_level(pixels: NDArray[np.floating], saturated: float = SATURATED_FRACTION) -> float:
    """Return the grey level displayed as white, which a small fraction of the pixels exceeds.

    Parameters
    ----------
    pixels : numpy.ndarray
        Grey levels, any shape; NaN, of pixels that were not seen, does not count.
    saturated : float
        That fraction.

    Returns
    -------
    float
        At least 1e-6, so that it is a valid divisor; 1 of no pixels.

    Examples
    --------
    >>> round(white_level(np.arange(10_000.0))), white_level(np.arange(2001.0), 1e-3), white_level(np.zeros(0))
    (9998, 1998.0, 1.0)
    """
    seen = pixels[np.isfinite(pixels)]
    return max(float(np.quantile(seen, 1 - saturated)), 1e-6) if seen.size else 1.0


class Scaling(Choice):
    """Rule for the grey levels displayed as white in compared images."""

    PAPER = "0.01 % saturated"
    """LS and ELS+ each with 0.01 % of the pixels saturated, ELSA by the factor of ELS+, as in the paper."""
    SHARED = "shared"
    """One level for all images: that of the brightest."""
    INDIVIDUAL = "individual"
    """Each with 0.01 % of its pixels saturated."""


def white_levels(
    images: Mapping[Mode, NDArray[np.float32]], inside: NDArray[np.bool_], scaling: Scaling | str = Scaling.PAPER
) -> dict[Mode, float]:
    """Return the grey level displayed as white, for each of several images.

    Parameters
    ----------
    images : mapping
        Mode to (n, n) grey levels.
    inside : numpy.ndarray
        (n, n) bool, pixels that are evaluated.
    scaling : Scaling or str
        Rule.

    Returns
    -------
    dict
        Mode to grey level.
    """
    own = {mode: white_level(image[inside]) for mode, image in images.items()}
    match Scaling(scaling):
        case Scaling.INDIVIDUAL:
            return own
        case Scaling.SHARED:
            return dict.fromkeys(own, max(own.values()))
        case Scaling.PAPER:
            return {mode: own[Mode.ELS] if mode is Mode.ELSA else white for mode, white in own.items()}


def alignment_error(confocal: NDArray[np.floating], residual: NDArray[np.floating], diameter_px: float) -> float:
    """Return the mean absolute difference of the views over the mean of the confocal view, in the 90 % disc.

    The paper finds 5.5 % for a USAF target in transmission, 0.74 % after the core filter.

    Parameters
    ----------
    confocal, residual : numpy.ndarray
        (n, n), the residual aligned and divided by its gain.
    diameter_px : float
        Diameter of the bundle, pixels.

    Returns
    -------
    float
        A fraction; NaN if the confocal image is dark. Pixels that are NaN in the residual image are left out.
    """
    used = disc(len(confocal), USED_DIAMETER * diameter_px) & ~np.isnan(residual)
    mean = float(confocal[used].mean())
    return float(np.abs(confocal - residual)[used].mean()) / mean if mean > 0 else float("nan")


@dataclass(frozen=True, slots=True)
class Contrast:
    """Levels of structure and background in an image.

    Attributes
    ----------
    background : float
        First decile, grey levels: light from out of focus.
    structure : float
        Ninth decile, grey levels.
    """

    background: float
    structure: float

    @property
    def michelson(self) -> float:
        """Michelson contrast, (structure - background) / (structure + background), a negative background taken as 0."""
        background = max(self.background, 0.0)
        total = self.structure + background
        return (self.structure - background) / total if total > 0 else float("nan")


def contrast(image: NDArray[np.floating], inside: NDArray[np.bool_]) -> Contrast:
    """Measure the levels of background and structure in an image by its deciles.

    Parameters
    ----------
    image : numpy.ndarray
        (n, n), grey levels.
    inside : numpy.ndarray
        (n, n) bool, the pixels that are counted; those that are NaN, as they were not seen, are left out.

    Examples
    --------
    >>> stripes = np.tile([10.0, 30.0], (4, 2))
    >>> contrast(stripes, np.ones_like(stripes, bool)).michelson
    0.5
    """
    background, structure = np.nanquantile(image[inside], (0.1, 0.9))
    return Contrast(float(background), float(structure))


def edge_artefact(residuals: Iterable[NDArray[np.floating]]) -> NDArray[np.float64]:
    """Return the normalised mean residual image, which shows the edge artefact: less light where the line is clipped.

    Parameters
    ----------
    residuals : iterable of numpy.ndarray
        (n, n) residual images of a moving probe; the paper averages about 300.

    Returns
    -------
    numpy.ndarray
        (n, n) float64; 1 in the central 100 x 100 pixels, 0 where no line reaches.

    Raises
    ------
    MeasurementError
        If there is no image, or no light in the middle.

    References
    ----------
    Thrapp and Hughes, "Edge Effect Artefacts".
    """
    total: NDArray[np.float64] | None = None
    for image in residuals:
        total = image.astype(np.float64) if total is None else total + image
    if total is None:
        raise MeasurementError("there are 0 residual images", "record a moving probe")
    low = max(0, len(total) // 2 - 50)
    middle = float(total[low : low + 100, low : low + 100].mean())
    if not middle > 0:
        raise MeasurementError(f"the middle of the residual images is dark ({middle:g})", "is the laser on?")
    return total / middle
