"""Agreement of a calibration with frames: the place of the cores in both views, and the brightness of the views.

The cores transmit differently, whatever lies before them: the pattern of the calibration's flat field is found in each
view of a few averaged frames, to a fraction of a pixel. A bundle that has moved displaces both views, a tilt mirror
that was turned the residual view alone. The gain is seen on one side only: what is out of focus is as bright in both
views, what is in focus dimmer in the residual view, but nothing is brighter there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy import fft

from napari_elsplus.errors import CalibrationError
from napari_elsplus.instrument.scanning import rate_advice
from napari_elsplus.processing.calibration.bundle.agreement import averaged_frames, grey_level_note, require_agreement
from napari_elsplus.processing.calibration.bundle.core_matching import COMPARED_DISC, core_contrast
from napari_elsplus.processing.calibration.frame_regions import mean_frame
from napari_elsplus.processing.images.sectioning import Sectioner, disc

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.modes import Frames

    Image = NDArray[np.float32]

REACH_PX: Final = 20
"""Displacement to either side that is searched; derived: the rim shows larger ones of bundles of up to 650 pixels."""
COMPARED_SIDE_PX: Final = 256
"""Of the square in the middle of the views that is compared; chosen: thousands of cores, in a third of the time."""
MIN_CORRELATION: Final = 0.15
"""Of the cores with those of the flat field, below which a view shows too few for a statement; chosen."""
MIN_PEAK_RATIO: Final = 1.4
"""Of the correlation over the largest one farther away than a core; chosen: of a clear peak it is 3 and more."""
SMOOTHING_PX: Final = 0.6
"""Standard deviation of the Gaussian that suppresses noise; chosen: with 0.8, as for the alignment of views, the
cores of the simulated rig are not clear in live frames. Whole pixels are compared, nothing is interpolated."""
CORE_PX: Final = 2.0
"""Distance from a peak beyond which correlations are another shift's; chosen: half a core and more."""
MIN_MOVED_PX: Final = 0.4
"""Displacement along a row or column from which on it is stated; chosen: a seventh of a core's spacing, of which cores
begin to remain in ELS+. Measured of eight frames of a moving probe, four scenes, both presets: errors of
at most 0.03."""
UNCERTAINTIES: Final = 4.0
"""The same in standard deviations of the calibration's view alignment."""
MAX_BRIGHTER: Final = 1.08
"""Brightness of the residual view over that of the confocal view beyond which the gain has changed; chosen, four times
the gain's uncertainty."""
TILES: Final = 8
"""Across the views, in which their brightness is compared; chosen: each averages over hundreds of cores."""
MIN_TILES: Final = 8
"""Lit ones for a comparison; chosen."""
MIN_LIGHT_DN: Final = 3.0
"""Grey levels of a lit tile; chosen: a rounding error of the background is then a hundredth of it."""
BRIGHT_SHARE: Final = 80
"""Percentile of the tiles' ratios that is compared; chosen: tiles with little in focus, not their noise."""


class ViewDisplacement(NamedTuple):
    """Rows and columns by which a view's cores lie from where the calibration has them, px, and their correlation."""

    rows: float
    cols: float
    correlation: float


class CoreAgreement:
    """Compares frames with the calibration that they are sectioned by.

    Parameters
    ----------
    calibration : Calibration
        With its bundle section, and a flat field that shows the cores.
    frame_shape : tuple of int
        Rows and columns of the frames.

    Raises
    ------
    CalibrationError
        If the calibration does not fit the frames, or has no flat field.
    """

    def __init__(self, calibration: Calibration, frame_shape: tuple[int, int]) -> None:
        self._sectioner = Sectioner(calibration, frame_shape)
        self._calibration = calibration
        side, bundle = self._sectioner.side, calibration.measured_bundle
        if calibration.flat is None or calibration.flat.shape != (side, side):
            raise CalibrationError("the calibration has no flat field", "measure the bundle pair")
        first = max(0, (side - COMPARED_SIDE_PX) // 2)
        self._middle = slice(first, side - first), slice(first, side - first)
        self._side = side - 2 * first
        self._lit = (disc(side, COMPARED_DISC * bundle.diameter_px) & self._sectioner.subtracted)[self._middle]
        self._radius_px = bundle.diameter_px / 2
        self._limit_px = max(MIN_MOVED_PX, UNCERTAINTIES * (bundle.alignment_uncertainty_px or 0.0))
        self._spectrum = self._transform((calibration.flat * self._sectioner.inside)[self._middle])

    def displacements(self, frames: Frames) -> tuple[ViewDisplacement | None, ViewDisplacement | None]:
        """Return the displacement of confocal and residual view; None where a view does not show its cores.

        Parameters
        ----------
        frames : sequence of numpy.ndarray
            Raw frames (rows, cols), scanned by the calibration.
        """
        confocal, residual = map(self._displacement, self._views(frames))
        return confocal, residual

    def disagreement(self, frames: Frames) -> CalibrationError | None:
        """Return in which way frames contradict the calibration, with the remedy; None if they do not.

        Parameters
        ----------
        frames : sequence of numpy.ndarray
            Raw frames (rows, cols), scanned by the calibration.
        """
        views = self._views(frames)
        confocal, residual = (self._displacement(view) for view in views)
        if confocal is None or residual is None:  # frames may clearly show the bundle farther away than this searches
            try:
                require_agreement(frames, self._calibration)
            except CalibrationError as error:
                return error
            return None
        if moved := self._moved(confocal, residual):
            return moved
        ratio = self._brightness_ratio(*views)
        # A calibration with advice on the rate says itself that the line is off its slit, and what to do.
        if ratio is None or ratio <= MAX_BRIGHTER or rate_advice(self._calibration):
            return None
        return CalibrationError(
            f"the residual view is {100 * (ratio - 1):.0f} % brighter than the confocal view, by the calibrated gain",
            "is a view shaded, or the line off its slit? measure bundle pair and galvo map again",
        )

    def displacement(self, frames: Frames) -> CalibrationError | None:
        """Return how far views have moved, with the remedy; None if they have not, or do not show their cores.

        Parameters
        ----------
        frames : sequence of numpy.ndarray
            Raw frames (rows, cols), scanned by the calibration.
        """
        confocal, residual = self.displacements(frames)
        return None if confocal is None or residual is None else self._moved(confocal, residual)

    def _moved(self, confocal: ViewDisplacement, residual: ViewDisplacement) -> CalibrationError | None:
        rows, cols = residual.rows - confocal.rows, residual.cols - confocal.cols
        if self._too_far(rows, cols):
            return CalibrationError(
                f"the residual view has moved by {rows:z.1f} rows and {cols:z.1f} columns against the confocal view "
                "since the calibration, as if the tilt mirror was turned",
                "measure slit offset and bundle pair again",
            )
        if self._too_far(confocal.rows, confocal.cols):
            return CalibrationError(
                f"the bundle has moved by {confocal.rows:z.1f} rows and {confocal.cols:z.1f} columns since the "
                "calibration",
                "measure the bundle pair again",
            )
        return None

    def _views(self, frames: Frames) -> tuple[Image, Image]:
        """Return the middle of the mean confocal and residual view of some frames."""
        mean = mean_frame(frames)
        residual = self._sectioner.residual(mean)[self._middle]
        return self._sectioner.ls(mean)[self._middle], np.nan_to_num(residual)

    def _too_far(self, rows: float, cols: float) -> bool:
        return max(abs(rows), abs(cols)) > self._limit_px

    def _transform(self, view: Image) -> NDArray[np.complex64]:
        """Return the spectrum of a view's core pattern, of unit power in the compared disc."""
        contrast = np.where(self._lit, core_contrast(view, self._radius_px, SMOOTHING_PX), 0)
        contrast -= self._lit * (contrast.sum() / max(np.count_nonzero(self._lit), 1))
        return np.asarray(fft.rfft2(contrast / max(float(np.linalg.norm(contrast)), 1e-9)))

    def _displacement(self, view: Image) -> ViewDisplacement | None:
        side = self._side
        matches = fft.irfft2(np.conj(self._spectrum) * self._transform(view), (side, side))
        near = np.roll(matches, (REACH_PX, REACH_PX), (0, 1))[: 2 * REACH_PX + 1, : 2 * REACH_PX + 1]
        row, col = (int(at) for at in np.unravel_index(np.argmax(near), near.shape))
        best, away = float(near[row, col]), np.hypot(*(np.indices(near.shape) - np.reshape((row, col), (2, 1, 1))))
        clear = best > MIN_CORRELATION and best > MIN_PEAK_RATIO * float(near[away > CORE_PX].max())
        if not clear or not (0 < row < 2 * REACH_PX and 0 < col < 2 * REACH_PX):
            return None
        rows, cols = _vertex(*near[row - 1 : row + 2, col]), _vertex(*near[row, col - 1 : col + 2])
        return ViewDisplacement(float(row + rows - REACH_PX), float(col + cols - REACH_PX), best)

    def _brightness_ratio(self, confocal: Image, residual: Image) -> float | None:
        """Return the brightness of the residual over the confocal view where little is in focus; None in the dark."""
        at = np.arange(self._side) * TILES // self._side
        tile = (at[:, None] * TILES + at)[self._lit]
        pixels, light, other = (
            np.bincount(tile, weights, TILES**2) for weights in (None, confocal[self._lit], residual[self._lit])
        )
        lit = (pixels > pixels.max() / 2) & (light > MIN_LIGHT_DN * pixels) & (light > np.median(light) / 2)
        if np.count_nonzero(lit) < MIN_TILES:
            return None
        return float(np.percentile(other[lit] / light[lit], BRIGHT_SHARE))


def agreement_note(frames: Frames, calibration: Calibration) -> str:
    """Return in which way frames contradict a calibration, with the remedy, or "".

    Their grey levels are compared (:func:`grey_level_note`), and where the views lie, by the cores.

    Parameters
    ----------
    frames : Frames
        Raw frames (rows, cols) that the calibration is applied to; a few of them are averaged.
    calibration : Calibration
        With the bundle section.

    Raises
    ------
    CalibrationError
        If they are frames of another rig (:func:`require_agreement`) or bit depth.
    """
    if not len(frames):
        return ""
    some = [np.asarray(frames[number]) for number in averaged_frames(len(frames))]  # read once for all comparisons
    require_agreement(some, calibration)
    note = grey_level_note(some, calibration)
    try:
        moved = CoreAgreement(calibration, some[0].shape).displacement(some)
    except CalibrationError:  # of one that does not show the cores
        return note
    return "; ".join(filter(None, (note, "" if moved is None else str(moved))))


def _vertex(before: float, at: float, after: float) -> float:
    """Return the place of the vertex of a parabola through three points at -1, 0 and 1."""
    return 0.5 * (before - after) / min(before - 2 * at + after, -1e-12)
