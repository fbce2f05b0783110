"""Measurements of the calibration: from frames to a slit offset, galvo map, bundle pair, background or flat field.

(i) slit offset, (ii) galvo map, (iii) bundle pair are those of the paper's System Calibration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.processing.analysis.uncertainty import newey_west_sigma
from napari_elsplus.processing.calibration.bundle import location as bundles
from napari_elsplus.processing.calibration.bundle.laser_gain import MAX_OFFSET_CHANGE_ROWS, LightCollector
from napari_elsplus.processing.calibration.bundle.view_alignment import Alignment, align_views
from napari_elsplus.processing.calibration.frame_regions import (
    MAX_SATURATED,
    brightest,
    column_between_views,
    largest_level,
    mean_frame,
    saturated_share,
    unlit_pixels,
)
from napari_elsplus.processing.calibration.galvo import GalvoMap, fit_galvo, visible_line
from napari_elsplus.processing.calibration.line.location import Line, LineParts, locate_line, parts_of
from napari_elsplus.processing.calibration.line.scatter import common_scatter_rows, relative_shifts
from napari_elsplus.processing.images.row_reference import RowReference
from napari_elsplus.processing.images.sectioning import Sectioner, disc
from napari_elsplus.processing.images.warping import polynomial_terms

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.sectioning import Frames

    Image = NDArray[np.float32]

MAX_SATURATED_BUNDLE: Final = 0.05
"""Largest saturated share of the bundle's image; chosen: saturated pixels are left out of the gain."""
SATURATION_LEVEL: Final = 0.98
"""Share of the largest grey level; chosen: reached by the mean of a pixel that is saturated in most frames."""
MAX_DRIFT: Final = 0.05
"""Largest relative change of the mean level between halves of the frames; chosen, above that of a warm laser."""
MAX_CHORD: Final = 1.1
"""Length of a line over the bundle's diameter; chosen: the rim's blur, and what a threshold makes of it."""
LIT_FRAMES: Final = 400
"""Frames of a sweep from which the light of the line is collected; chosen: all of the paper's sweep, since power noise
gives each line a gain of its own."""
SAMPLING_ROWS: Final = 0.003
"""Rows; part of the offset's uncertainty that no residual shows: the views' pixels sample the cores at other phases.
Measured: bright lines on the presets' bundles are off by 0.0062 rows at 240 Hz (16 bundles) and 0.0020 at 120 Hz (5),
RMS, of which residuals show 0.0042 and 0.0034; with it 72 % of 90 random rigs (seeds 1000 to 1089) are within a sigma
of the truth."""
MIN_SCATTER_FRAMES: Final = 3
"""Frames of a standing line below which their scatter is not estimated; chosen."""
_NEIGHBOURS: Final = 4
"""Runs of columns whose errors are correlated; chosen: the cores of the two views differ by fewer columns."""


@dataclass(frozen=True, slots=True)
class SlitOffset:
    """Row of a standing line in the residual view minus its row in the confocal view.

    Parameters
    ----------
    rows, uncertainty_rows : float
        The offset and its standard deviation; errors that both views share, from the cores, do not add to it.
    confocal, residual : Line
        The line in each view; columns count in the view, which begins at ``split`` for the residual one.
    split : int
        Column of the frame between the views.
    unsteady_rows : float
        Part of the standard deviation by scatter from frame to frame.
    parts : LineParts, optional
        Core and halo of the line in the confocal view; None where its profile does not show both.
    """

    rows: float
    uncertainty_rows: float
    confocal: Line
    residual: Line
    split: int
    unsteady_rows: float = 0.0
    parts: LineParts | None = None

    @property
    def view_offset(self) -> tuple[float, float, float]:
        """Rows and columns of the frame from the line in the confocal view to the residual one; difference in slope."""
        columns = self.split + self.residual.column - self.confocal.column
        return self.rows, columns, self.residual.slope - self.confocal.slope

    @property
    def lit_columns(self) -> list[tuple[int, int]]:
        """First lit column of the frame and the one after the last, in each view."""
        views = ((self.confocal, 0), (self.residual, self.split))
        return [(start + line.columns[0], start + line.columns[1]) for line, start in views]


@dataclass(frozen=True, slots=True)
class BundlePair:
    """Both bundle images and their alignment.

    Parameters
    ----------
    confocal, residual : Disc
        The bundle's image in each view.
    alignment : Alignment
        Map from the residual to the confocal image, and the gain.
    image : numpy.ndarray
        Mean frame (rows, cols) in which they were located, float32.
    saturated : float
        Share of the frame that is saturated.
    """

    confocal: bundles.Disc
    residual: bundles.Disc
    alignment: Alignment
    image: Image
    saturated: float = 0.0

    @property
    def shows_flat_field(self) -> bool:
        """True if the frame may serve as a flat field."""
        return self.saturated <= MAX_SATURATED

    @property
    def split(self) -> int:
        """Column of the frame between the views."""
        return round((self.confocal.centre[1] + self.residual.centre[1]) / 2)

    @property
    def view_offset(self) -> tuple[float, float, float]:
        """Rows and columns from the confocal to the residual image's centre; slope there of a level line."""
        down, across = np.linalg.solve(self.alignment.residual_to_confocal[:, :2], (0.0, 1.0))
        return self.offset_rows, self.residual.centre[1] - self.confocal.centre[1], float(down / across)

    @property
    def offset_rows(self) -> float:
        """Row of the residual bundle image minus that of the confocal: the slit offset, independent of the line."""
        return self.residual.centre[0] - self.confocal.centre[0]

    @property
    def offset_uncertainty_rows(self) -> float:
        """One standard deviation of :attr:`offset_rows`."""
        return float(np.hypot(self.residual.centre_uncertainty_px, self.confocal.centre_uncertainty_px))


@dataclass(frozen=True, slots=True)
class Background:
    """Mean frame of the dark tube.

    Parameters
    ----------
    mean : numpy.ndarray
        (rows, cols) float32.
    frames : int
        Number of frames that were averaged; the paper averages 50.
    drift : float
        Relative change of the mean level from the first half of the frames to the second.
    """

    mean: Image
    frames: int
    drift: float


def measure_background(frames: Frames) -> Background:
    """Average the frames of a dark tube with the laser on.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols).

    Raises
    ------
    MeasurementError
        If more than 1 % is saturated, or the level drifts by more than 5 %.
    """
    mean, drift = mean_frame(frames), _drift(frames, "background")
    saturated_share(frames[0], "background")
    return Background(mean, len(frames), drift)


def _drift(frames: Frames, name: str) -> float:
    """Return the relative change of the mean level from the first half of the frames to the second, unless large."""
    half = len(frames) // 2
    levels = [float(np.mean(np.asarray(frames[k][::4, ::4], np.float64))) for k in range(len(frames))]
    first, second = (float(np.mean(part)) for part in (levels[: max(half, 1)], levels[half:]))
    drift = (second - first) / max(abs(first), 1.0)
    if abs(drift) > MAX_DRIFT:
        raise MeasurementError(
            f"the {name} drifts by {100 * drift:.1f} % while it is taken", "let laser and camera warm up"
        )
    return drift


def measure_offset(
    frames: Frames, background: Image | None = None, pair: BundlePair | None = None, near: SlitOffset | None = None
) -> SlitOffset:
    """Measure the slit offset from a standing line (step i).

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols) of the line standing near the middle of the bundle, to be averaged.
    background : numpy.ndarray, optional
        Mean frame of the dark tube.
    pair : BundlePair, optional
        The bundle images; without them the offset is taken at the middle of the lit part of the line.
    near : SlitOffset, optional
        The offset of the frame before, near which the lines are searched.

    Raises
    ------
    MeasurementError
        If there is no line in one of the views.
    """
    alone = near is not None and len(frames) == 1
    raw: NDArray[Any] = np.asarray(frames[0]) if alone else mean_frame(frames)
    saturated_share(frames[0], "image of the line")
    reference = RowReference(unlit_pixels(raw, background, _discs(pair), near.lit_columns if near else []), background)
    noisy = reference.some_show_noise(frames)
    frame = reference.without_row_noise(raw) if noisy else raw
    place = near or pair
    if place is None:
        split = column_between_views(np.subtract(frame, 0 if background is None else background, dtype=np.float32))
    else:
        split = place.split
    lines = []
    for name, part in (("confocal", slice(0, split)), ("residual", slice(split, None))):
        dark = None if background is None else background[:, part]
        before = None if near is None else near.confocal if name == "confocal" else near.residual
        try:
            lines.append(locate_line(frame[:, part], dark, before))
        except MeasurementError as error:
            raise MeasurementError(f"{name} view: {error.problem}", error.remedy) from None
    found = _of_lines(lines[0], lines[1], split, pair)
    if alone:
        return found
    of_tube = 0.0 if background is None else background[:, :split]
    found = replace(found, parts=parts_of(lines[0], np.subtract(frame[:, :split], of_tube, dtype=np.float32)))
    if len(frames) < MIN_SCATTER_FRAMES:
        return found
    views = (lines[0], slice(0, split)), (lines[1], slice(split, None))
    single = (reference.without_row_noise(frames[k]) if noisy else frames[k] for k in range(len(frames)))
    shifts = relative_shifts(views, frame, single, background)
    unsteady_rows = common_scatter_rows(shifts)
    uncertainty_rows = float(np.hypot(found.uncertainty_rows, unsteady_rows))
    return replace(found, uncertainty_rows=uncertainty_rows, unsteady_rows=unsteady_rows)


def offset_at(offset: SlitOffset, pair: BundlePair) -> SlitOffset:
    """Return a slit offset at the centres of a bundle pair, by the line and by the pair's cores.

    Both views show the same cores, so that where the residual view shows those under the confocal line, its own must
    be: unlike the line, they do not depend on the laser's power, of which a ripple at a multiple of the frame rate has
    one phase in all frames and moves the line in all of them alike. The line is therefore at least as uncertain as it
    differs from the cores, and both are weighted by their variances. Where they differ by more than a row, the tilt
    mirror was turned since: the pair is out of date, and the line counts alone.

    Parameters
    ----------
    offset : SlitOffset
        Of the line, measured with or without the pair.
    pair : BundlePair
        The bundle images; by their centres alone they do not show where the line is.
    """
    line = _of_lines(offset.confocal, offset.residual, offset.split, pair, offset.unsteady_rows)
    line = replace(line, parts=offset.parts)
    rows, sigma_rows = _offset_of_cores(line, pair)
    away_rows = line.rows - rows
    if pair.alignment.refusal or abs(away_rows) > MAX_OFFSET_CHANGE_ROWS:
        return line
    variances = np.array((max(line.uncertainty_rows**2, away_rows**2 - sigma_rows**2), sigma_rows**2))
    mean_rows = float(np.average((line.rows, rows), weights=1 / variances))
    return replace(line, rows=mean_rows, uncertainty_rows=float(np.sqrt(1 / (1 / variances).sum())))


def _of_lines(
    confocal: Line, residual: Line, split: int, pair: BundlePair | None = None, unsteady_rows: float = 0.0
) -> SlitOffset:
    """Return the offset of the lines alone, at the centres of a pair, or else at the middle of their lit parts."""
    columns = confocal.column, residual.column
    if pair is not None:
        columns = pair.confocal.centre[1], pair.residual.centre[1] - split
    influence = residual.influence_at(columns[1]) - confocal.influence_at(columns[0])
    rows = residual.row_at(columns[1]) - confocal.row_at(columns[0])
    # Where the views differ in light along a bowed line, the straight ones through it lie at different heights.
    bend = (confocal.bend + residual.bend) / 2
    rows += residual.bowed_rows(columns[1], bend) - confocal.bowed_rows(columns[0], bend)
    sigma = float(np.linalg.norm((newey_west_sigma(influence, _NEIGHBOURS), SAMPLING_ROWS, unsteady_rows)))
    return SlitOffset(rows, sigma, confocal, residual, split, unsteady_rows)


def _offset_of_cores(line: SlitOffset, pair: BundlePair) -> tuple[float, float]:
    """Return the slit offset, rows, of the cores under the confocal line, and one standard deviation."""
    centre, alignment, confocal = pair.confocal.centre, pair.alignment, line.confocal
    row = confocal.row_at(centre[1]) + confocal.bowed_rows(centre[1], confocal.bend)
    affine = alignment.residual_to_confocal
    at = np.linalg.solve(affine[:, :2], np.array((row, centre[1])) - affine[:, 2])
    if alignment.distortion is not None:
        place = (row - centre[0]) / (pair.confocal.diameter_px / 2)
        at = at + alignment.distortion @ polynomial_terms(np.array(place), np.zeros(()))
    rows = at[0] + line.residual.slope * (pair.residual.centre[1] - at[1]) - row
    return float(rows), alignment.centre_uncertainty_px


def map_galvo(
    frames: Frames,
    volts: NDArray[np.floating],
    background: Image | None = None,
    pair: BundlePair | None = None,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
    offset: SlitOffset | None = None,
) -> GalvoMap:
    """Fit the voltage that puts the line onto a row of the confocal view (step ii).

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        A raw frame (rows, cols) per voltage.
    volts : numpy.ndarray
        Voltages, shape (frames,).
    background : numpy.ndarray, optional
        Mean frame of the dark tube.
    pair : BundlePair, optional
        The bundle images; without them rows are taken at the middle of the longest lines.
    progress : callable, optional
        Wraps the frames' numbers, to display progress.
    offset : SlitOffset, optional
        Of the same line. Where it or the pair is known, the light of the lines is collected in both views.

    Raises
    ------
    InputError
        If the numbers of voltages and frames differ.
    MeasurementError
        If too few frames show a line.
    """
    if len(volts) != len(frames):
        raise InputError(f"{len(volts)} voltages for {len(frames)} frames of the sweep", "give one voltage per frame")
    painted = brightest(frames, background)
    split = pair.split if pair is not None else column_between_views(painted)
    dark = unlit_pixels(painted, discs=_discs(pair))
    reference, place = RowReference(dark, background), pair or offset
    collector = None if place is None else LightCollector(painted.shape, place.split, place.view_offset)
    max_chord_px = MAX_CHORD * (split - float(dark[0, :split].sum()) if pair is None else pair.confocal.diameter_px)
    every, noisy = -(-len(frames) // LIT_FRAMES), reference.some_show_noise(frames)
    lines = []
    for number in progress(range(len(frames))):
        frame = reference.without_row_noise(frames[number]) if noisy else frames[number]
        line = visible_line(frame[:, :split], None if background is None else background[:, :split])
        lines.append(line)
        if collector is None or line is None or number % every:
            continue
        if line.columns[1] - line.columns[0] <= max_chord_px:
            row = line.row - line.bow * line.mean_square_px
            collector.add(frame, row, line.column, line.slope, line.bow, line.width_rows)
    column, diameter_px = (None, None) if pair is None else (pair.confocal.centre[1], pair.confocal.diameter_px)
    found = fit_galvo(volts, lines, column, diameter_px, max_chord_px)
    return found if collector is None else replace(found, light=collector.swept(dark, background))


def _discs(pair: BundlePair | None) -> list[tuple[tuple[float, float], float]]:
    """Return centre and diameter in pixels of both views; nothing without a pair."""
    return [] if pair is None else [(disc.centre, disc.diameter_px) for disc in (pair.confocal, pair.residual)]


def measure_pair(frames: Frames) -> BundlePair:
    """Locate both bundle images, and measure their alignment and gain (step iii).

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols) of the bundle lit from its far end.

    Raises
    ------
    MeasurementError
        If there are not two bundle images that show the same cores, or the level drifts by more than 5 %.
    """
    frame = mean_frame(frames)
    share = saturated_share(frames[0], "image of the bundle", MAX_SATURATED_BUNDLE)
    confocal, residual = bundles.locate_pair(frame)
    saturated = frame >= SATURATION_LEVEL * largest_level(frames[0])
    pair = BundlePair(confocal, residual, align_views(frame, confocal, residual, saturated), frame, share)
    if pair.shows_flat_field:
        _drift(frames, "flat field")
    return pair


def measure_flat_field(frames: Frames, calibration: Calibration) -> Image:
    """Measure the relative brightness of the confocal view's pixels under uniform light, mean 1 inside the disc.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols) of a uniform scene, or of the bundle lit from its far end.
    calibration : Calibration
        With its bundle section.

    Returns
    -------
    numpy.ndarray
        (n, n) float32, on the grid of :class:`napari_elsplus.processing.images.sectioning.Sectioner`.

    Raises
    ------
    MeasurementError
        If the disc is dark, more than 1 % is saturated, or the level drifts by more than 5 %.
    """
    bundle = calibration.measured_bundle
    frame = mean_frame(frames)
    saturated_share(frames[0], "flat field")
    _drift(frames, "flat field")
    sectioner = Sectioner(calibration, frame.shape)
    image = sectioner.ls(frame)
    inside = disc(len(image), bundle.diameter_px)
    level = float(image[inside].mean())
    if not level > 0.5:
        raise MeasurementError(f"the flat field is dark (mean {level:.2g} grey levels)", "light the scene evenly")
    return np.where(inside, np.maximum(image, 0) / level, 1).astype(np.float32)
