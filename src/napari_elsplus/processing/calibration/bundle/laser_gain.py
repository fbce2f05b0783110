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
from napari_elsplus.processing.calibration.line.view_offset import IN_PLACE, ViewOffset
from napari_elsplus.processing.images.hot_pixels import HotPixels
from napari_elsplus.processing.images.sectioning import Sectioner, disc

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.line.location import Line

    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

REACH_WIDTHS: Final = 6.0
"""Rows about the line that are used, in standard deviations of its Gaussian; chosen: in a distorted or turned view the
line is a row or two off the window's middle, of which a narrower one takes 0.1 to 0.4 % of its light."""
FAR_WIDTHS: Final = 18.0
"""Rows from the line beyond which a pixel shows the darkness under it, in the same; chosen: of the line's halo as much
of either view is subtracted as dark."""
LAMP_GAIN: Final = 0.02
"""Standard deviation of the gain in the lamp's light about that in the fluorescence's, relative; chosen: that of the
rigs that are drawn at random, up to 3 %."""
MAX_DISAGREEMENT: Final = 0.15
"""Of the gains by the line and by the lamp; chosen: by more, the views do not show the line alike."""
DOUBTFUL_DISAGREEMENT: Final = 3 * LAMP_GAIN
"""Of these gains; derived: one rig in 400 exceeds it by its lamp's spectrum."""
MAX_CLIPPED_LINES: Final = 0.5
"""Part of the sweep's lines that may be left out as saturated; chosen: the others then are few and lie apart, where the
target is dark, and the gain of the residual view may differ from place to place."""
BANDS: Final = 16
"""Of rows, the clusters of the uncertainty; chosen: power noise of the laser is common to all columns of a line, but
not to successive lines."""
BAND_EXCESS: Final = 1.5
"""Scatter of the bands over that of the lines from which it counts; derived: by chance alone 0.4 % of sweeps exceed it,
15 degrees of freedom given."""
BAND_EDGES: Final = 1e-3
"""Scatter of the bands, as a standard deviation of the gain, that stable power leaves, since light of a core at a
band's edge may lie in one band of one view and in the next of the other: what one lacks the other has; measured: 0.0002
to 0.0009 in eight rigs (seeds 8001, 8005, 8019, 8021, 8034, 8039, 8040, 8056), whose gains are off by 0.0002 RMS."""
LEFT_OVER: Final = 2e-4
"""Standard deviation of the gain by a laser of stable power; measured: on the same rigs."""
MIN_LINES: Final = 3
"""For a scatter of lines, and for the darkness of a pixel; chosen."""
ROW_SHAPE_DEGREE: Final = 4
"""Of the polynomial that brings the rows of a flat field by the sweep to one level; chosen."""
MIN_WEIGHT: Final = 5.0
"""Of a pixel in a flat field by the sweep; derived: lines two standard deviations apart, whose ripple is 1 %."""
MIN_RELATIVE_WEIGHT: Final = 0.3
MAX_UNCOVERED: Final = 0.02
"""Of the typical weight; share of the disc that may have less. Chosen: the rim beyond the outermost whole lines."""
MAX_OFFSET_CHANGE_ROWS: Final = 1.0
"""Of a line in the residual view, from where it was taken to be in the sweep to where the bundle pair has it; chosen: a
fraction of the line's width."""


@dataclass(frozen=True, slots=True)
class SweptLight:
    """Light of the line in a sweep, as far as it covers the bundle.

    Parameters
    ----------
    image : numpy.ndarray
        (rows, cols) float32: light about the lines, above darkness; 0 where no line stood near.
    weight : numpy.ndarray
        (rows, cols) float32: sum of the windows by which the frames were weighted in `image`.
    lines : numpy.ndarray
        (lines, 5) float64, by rows: row and column in the confocal view, rows from there to the residual view's line,
        as used, and the light in both views, above darkness.
    clipped : int
        Lines that were left out, as their core is saturated.
    """

    image: Image
    weight: Image
    lines: Floats
    clipped: int = 0

    @property
    def mostly_clipped(self) -> bool:
        """True if so many lines are saturated that the others do not stand for the bundle."""
        return self.clipped > MAX_CLIPPED_LINES * (self.clipped + len(self.lines))

    def chance(self, centre_row: float, diameter_px: float) -> float:
        """Return the relative standard deviation of the gain in `COMPARED_DISC`, by how lines differ at random.

        By the differences of successive lines (von Neumann 1941), in which whatever varies slowly over the bundle
        cancels: hundreds of lines tell it far better than a few bands of rows. Each counts by its part within the disc.

        Parameters
        ----------
        centre_row, diameter_px : float
            Of the bundle in the confocal view.

        Returns
        -------
        float
            0 by fewer than three lines.
        """
        row, _, _, first, second = self.lines.T
        radius_px = diameter_px / 2
        within = np.maximum((COMPARED_DISC * radius_px) ** 2 - np.square(row - centre_row), 0)
        light = first * np.sqrt(within / (within + (1 - COMPARED_DISC**2) * radius_px**2))
        lit = light > 0
        if np.count_nonzero(lit) < MIN_LINES:
            return 0.0
        light, ratio = light[lit], second[lit] / first[lit]
        differences = np.diff(ratio) * (light[1:] + light[:-1]) / 2
        return float(np.sqrt(np.square(differences).sum() / 2) / light.sum())


class LightCollector:
    """Sum of the frames of a sweep, each weighted by a window that follows the line in both views.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the frames.
    split : int
        Column between the views.

    Notes
    -----
    Darkness is what the pixels show while the line stands far from them: black level, and stray light, which differs
    between the views. The background is not taken off: it was scanned, and contains less light of the residual view
    than of the confocal.
    """

    def __init__(self, shape: tuple[int, ...], split: int) -> None:
        self._views = slice(0, split), slice(split, shape[1])
        self._light, self._weight, self._dark = np.zeros((3, *shape), np.float32)
        self._dark_frames = np.zeros(shape, np.float32)
        self._lines: list[tuple[float, ...]] = []

    def add(self, frame: NDArray[np.generic], line: Line, view_offset: ViewOffset) -> None:
        """Add a frame whose confocal view shows a line.

        Parameters
        ----------
        frame : numpy.ndarray
            (rows, cols), any real dtype.
        line : Line
            In the confocal view.
        view_offset : ViewOffset
            From there to the line in the residual view.
        """
        row = line.row - line.bow * line.mean_square_px
        found = [row, line.column, view_offset.rows]
        for part, (down, across, turn, stretch) in zip(self._views, (IN_PLACE, view_offset), strict=True):
            reach = REACH_WIDTHS * line.width_rows * stretch
            along = np.arange(part.start, part.stop) - line.column - across
            where = (row + down + (line.slope + turn) * along + line.bow * np.square(along)).astype(np.float32)
            far = FAR_WIDTHS / REACH_WIDTHS * reach
            for rows in (slice(max(int(where.min() - far), 0)), slice(max(int(where.max() + far) + 2, 0), None)):
                self._dark[rows, part] += frame[rows, part]
                self._dark_frames[rows, part] += 1
            first = max(int(where.min() - reach), 0)
            band = slice(first, min(int(where.max() + reach) + 2, len(frame)))
            if band.start >= band.stop:
                found += [0.0, 0.0]
                continue
            away = (np.arange(band.start, band.stop, dtype=np.float32)[:, None] - where) / np.float32(reach)
            weight = np.square(np.maximum(1 - np.square(np.square(away)), 0))  # flat in its middle
            light = weight * frame[band, part]
            self._weight[band, part] += weight
            self._light[band, part] += light
            found += [float(weight.sum()), float(light.sum())]
        self._lines.append(tuple(found))

    def swept(self, unlit: NDArray[np.uint8], background: Image | None = None, clipped: int = 0) -> SweptLight:
        """Return the light above darkness.

        Parameters
        ----------
        unlit : numpy.ndarray
            (rows, cols), 1 in pixels that no light reaches: their level is the darkness of rows near all lines.
        background : numpy.ndarray, optional
            (rows, cols) mean frame of the dark tube, which shows the hot pixels: their light would count in each line.
        clipped : int
            Lines that were not added, as their core is saturated.
        """
        none = unlit > 0
        level = self._light[none].sum(dtype=np.float64) / max(self._weight[none].sum(dtype=np.float64), 1e-9)
        seen = self._dark_frames >= MIN_LINES
        dark = np.where(seen, self._dark / np.maximum(self._dark_frames, 1), np.float32(level))
        image = HotPixels(background).mended(self._light - self._weight * dark)
        lines = np.array(sorted(self._lines), np.float64).reshape(-1, 7)
        above_dark = lines[:, 4::2] - [dark[:, part].mean() for part in self._views] * lines[:, 3::2]
        return SweptLight(image, self._weight, np.hstack([lines[:, :3], above_dark]), clipped)


def _sectioner(light: SweptLight, calibration: Calibration) -> Sectioner | None:
    """Return the sectioner of a sweep's light; None if the residual view is not where it was taken to be in it."""
    affine, at = np.array(calibration.measured_bundle.residual_to_confocal), light.lines[:, :2].T
    expected_rows = np.linalg.solve(affine[:, :2], at - affine[:, 2:])[0] - at[0]
    if np.abs(light.lines[:, 2] - expected_rows).max(initial=0.0) > MAX_OFFSET_CHANGE_ROWS:
        return None
    return Sectioner(calibration.model_copy(update={"background": None}), light.image.shape)


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
    sectioner = _sectioner(light, calibration)
    if sectioner is None:
        return None
    lit, weight = sectioner.ls(light.image), sectioner.ls(light.weight)
    inside = disc(sectioner.side, sectioner.diameter_px)
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
    bundle, sectioner = calibration.measured_bundle, _sectioner(light, calibration)
    if sectioner is None or light.mostly_clipped:
        return None
    confocal, residual = sectioner.ls(light.image), sectioner.residual(light.image)
    inside = disc(sectioner.side, COMPARED_DISC * bundle.diameter_px) & np.isfinite(residual)
    first, second = (np.where(inside, view, 0).sum(axis=1, dtype=np.float64) for view in (confocal, residual))
    if not first.sum() > 0:
        return None
    band = np.arange(sectioner.side) * BANDS // sectioner.side
    ratio, by_bands = ratio_of_light(first, second, band, BANDS)
    by_lines = light.chance(bundle.confocal_centre[0], bundle.diameter_px)
    # Bands tell what lines share with their neighbours; where they do not, lines tell their chance far better.
    shared = by_lines == 0 or by_bands > BAND_EXCESS * max(by_lines, BAND_EDGES)
    uncertainty = float(np.hypot(by_bands if shared else by_lines, LEFT_OVER))
    return ratio * bundle.residual_gain, uncertainty * bundle.residual_gain
