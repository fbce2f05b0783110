"""Gain of the residual view in the light that is imaged: that of the standing line, over the frames of a sweep.

The lamp that lights the bundle from its far end has another spectrum and polarisation than the fluorescence, and the
splitter divides them otherwise. Both views show the whole of a standing line, in and out of focus, so that the ratio of
its light in the two is the gain, whatever the specimen; scanned, their slits would select different parts of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.calibration.bundle.core_matching import COMPARED_DISC
from napari_elsplus.processing.calibration.bundle.gain import ratio_of_light
from napari_elsplus.processing.images.hot_pixels import HotPixels
from napari_elsplus.processing.images.sectioning import Sectioner, disc

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import BundleSection, Calibration

    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

REACH_WIDTHS: Final = 6.0
"""Rows about the line that are used, in standard deviations of its Gaussian; chosen: in a distorted or turned view the
line is a row or two off the window's middle, of which a narrower one takes 0.1 to 0.4 % of its light."""
LAMP_GAIN: Final = 0.02
"""Standard deviation of the gain in the lamp's light about that in the fluorescence's, relative; chosen: that of the
rigs that are drawn at random, up to 3 %."""
MAX_DISAGREEMENT: Final = 0.15
"""Of the gains by the line and by the lamp; chosen: by more, the views do not show the line alike."""
BANDS: Final = 16
"""Of rows, the clusters of the uncertainty; chosen: power noise of the laser is common to all columns of a line, but
not to successive lines."""
MIN_LINES: Final = 3
"""For a scatter of lines; chosen."""
ROW_SHAPE_DEGREE: Final = 4
"""Of the polynomial that brings the rows of a flat field by the sweep to one level; chosen."""
MIN_WEIGHT: Final = 5.0
"""Of a pixel in a flat field by the sweep; derived: lines two standard deviations apart, whose ripple is 1 %."""
MIN_RELATIVE_WEIGHT: Final = 0.3
MAX_UNCOVERED: Final = 0.02
"""Of the typical weight; share of the disc that may have less. Chosen: the rim beyond the outermost whole lines."""
MAX_OFFSET_CHANGE_ROWS: Final = 1.0
"""Of the residual view since the sweep; chosen: a fraction of the line's width."""


@dataclass(frozen=True, slots=True)
class SweptLight:
    """Light of the line in a sweep, as far as it covers the bundle.

    Parameters
    ----------
    image : numpy.ndarray
        (rows, cols) float32: light about the lines, above darkness; 0 where no line stood near.
    weight : numpy.ndarray
        (rows, cols) float32: sum of the windows by which the frames were weighted in `image`.
    offset_rows : float
        Of the line in the residual view, as used.
    chance : float
        Standard deviation of the residual view's light, over that of the confocal, by what lines differ in at random.
    """

    image: Image
    weight: Image
    offset_rows: float
    chance: float = 0.0


class LightCollector:
    """Sum of the frames of a sweep, each weighted by a window that follows the line in both views.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the frames.
    split : int
        Column between the views.
    offset : tuple of float
        Rows and columns from the line in the confocal view to that in the residual one, and by how many rows per
        column its slope exceeds that in the confocal view.

    Notes
    -----
    The background is not taken off: it was scanned, and contains less light of the residual view than of the confocal.
    """

    def __init__(self, shape: tuple[int, ...], split: int, offset: tuple[float, float, float]) -> None:
        self._offset_rows = offset[0]
        self._views = ((slice(0, split), 0.0, 0.0, 0.0), (slice(split, shape[1]), *offset))
        self._light, self._weight = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self._lines: list[tuple[float, ...]] = []

    def add(
        self, frame: NDArray[np.generic], row: float, column: float, slope: float, bend: float, width_rows: float
    ) -> None:
        """Add a frame whose confocal view shows the line at a row and column.

        Parameters
        ----------
        frame : numpy.ndarray
            (rows, cols), any real dtype.
        row, column, slope, bend : float
            Of the line in the confocal view; the slope in rows per column there, the bend in rows per squared column.
        width_rows : float
            Standard deviation of its Gaussian.
        """
        reach = REACH_WIDTHS * width_rows
        found = [row]
        for part, down, across, turn in self._views:
            along = np.arange(part.start, part.stop) - column - across
            line = (row + down + (slope + turn) * along + bend * np.square(along)).astype(np.float32)
            first = max(int(line.min() - reach), 0)
            band = slice(first, min(int(line.max() + reach) + 2, len(frame)))
            if band.start >= band.stop:
                found.append(0.0)
                continue
            weight = np.arange(band.start, band.stop, dtype=np.float32)[:, None] - line
            weight *= np.float32(1 / reach)
            np.square(weight, out=weight)
            np.square(weight, out=weight)  # flat in its middle
            np.subtract(1, weight, out=weight)
            np.maximum(weight, 0, out=weight)
            np.square(weight, out=weight)
            self._weight[band, part] += weight
            np.multiply(weight, frame[band, part], out=weight, casting="same_kind")
            self._light[band, part] += weight
            found.append(float(weight.sum()))
        self._lines.append(tuple(found))

    def swept(self, unlit: NDArray[np.uint8], background: Image | None = None) -> SweptLight:
        """Return the light above the level of the pixels that none reaches.

        Parameters
        ----------
        unlit : numpy.ndarray
            (rows, cols), 1 in these pixels.
        background : numpy.ndarray, optional
            (rows, cols) mean frame of the dark tube, which shows the hot pixels: their light would count in each line.
        """
        dark, lit = unlit > 0, HotPixels(background).mended(self._light)
        level = lit[dark].sum(dtype=np.float64) / max(self._weight[dark].sum(dtype=np.float64), 1e-9)
        image = lit - np.float32(level) * self._weight
        total = float(image[:, self._views[0][0]].sum(dtype=np.float64))
        return SweptLight(image, self._weight, self._offset_rows, self._scatter() / total if total > 0 else 0.0)

    def _scatter(self) -> float:
        """Return the standard deviation of the sum of the residual view's light, for that of the confocal view.

        By the differences of successive lines (von Neumann 1941), in which whatever varies slowly over the bundle
        cancels: hundreds of lines tell it far better than a few bands of rows.
        """
        lines = np.array(sorted(line for line in self._lines if line[1] > 0), np.float64)
        if len(lines) < MIN_LINES:
            return 0.0
        _, first, second = lines.T
        differences = np.diff(second / first) * (first[1:] + first[:-1]) / 2
        return float(np.sqrt(np.square(differences).sum() / 2))


def _has_moved(light: SweptLight, bundle: BundleSection) -> bool:
    """Return True if the residual view is not where it was in the sweep."""
    offset_rows = bundle.residual_centre[0] - bundle.confocal_centre[0]
    return abs(light.offset_rows - offset_rows) > MAX_OFFSET_CHANGE_ROWS


def swept_flat_field(light: SweptLight, calibration: Calibration) -> Image | None:
    """Return the relative brightness of the confocal view under the line of a sweep; None where it is not covered.

    Parameters
    ----------
    light : SweptLight
        Of the same bundle and offset, on an evenly fluorescent target.
    calibration : Calibration
        With the bundle section.

    Returns
    -------
    numpy.ndarray or None
        (n, n) float32, mean 1 inside the disc; None if the lines lie too far apart, or leave a part of the disc out.

    Notes
    -----
    Rows are brought to one level: towards the rim the halo of lines beyond it is missing.
    """
    bundle = calibration.measured_bundle
    if _has_moved(light, bundle):
        return None
    sectioner = Sectioner(calibration.model_copy(update={"background": None}), light.image.shape)
    lit, weight = sectioner.ls(light.image), sectioner.ls(light.weight)
    inside = disc(sectioner.side, bundle.diameter_px)
    typical = float(np.median(weight[inside]))
    if typical < MIN_WEIGHT or np.mean(weight[inside] < MIN_RELATIVE_WEIGHT * typical) > MAX_UNCOVERED:
        return None
    flat = np.maximum(lit, 0) / np.maximum(weight, MIN_RELATIVE_WEIGHT * typical)
    row, pixels = np.linspace(-1, 1, sectioner.side), inside.sum(axis=1)
    level = np.where(inside, flat, 0).sum(axis=1) / np.maximum(pixels, 1)
    flat /= np.polynomial.Polynomial.fit(row, level, ROW_SHAPE_DEGREE, w=np.sqrt(pixels))(row)[:, None]
    return np.where(inside, flat / flat[inside].mean(), 1).astype(np.float32)


def laser_gain(light: SweptLight, calibration: Calibration) -> tuple[float, float] | None:
    """Return the gain in the light of a sweep and its uncertainty; None where the sweep does not show it.

    Parameters
    ----------
    light : SweptLight
        Of the same bundle and offset.
    calibration : Calibration
        With the bundle section, its gain that of the lamp, and a gain map if there is one.
    """
    bundle = calibration.measured_bundle
    if _has_moved(light, bundle):
        return None
    sectioner = Sectioner(calibration.model_copy(update={"background": None}), light.image.shape)
    confocal, residual = sectioner.ls(light.image), sectioner.residual(light.image)
    inside = disc(sectioner.side, COMPARED_DISC * bundle.diameter_px) & np.isfinite(residual)
    first, second = (np.where(inside, view, 0).sum(axis=1, dtype=np.float64) for view in (confocal, residual))
    if not first.sum() > 0:
        return None
    band = np.arange(sectioner.side) * BANDS // sectioner.side
    ratio, uncertainty = ratio_of_light(first, second, band, BANDS)
    if not abs(ratio - 1) < MAX_DISAGREEMENT:
        return None
    # The scatter over bands contains that of the lines, but of few bands it may be small by chance.
    return ratio * bundle.residual_gain, max(uncertainty, light.chance) * bundle.residual_gain
