"""The slit offset: how far the line lies from the slit of the residual view (System Calibration, step i of the paper).

The line gives it, and so do the fibre cores under the line, where the bundle pair is known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.analysis.line_parts import LineParts, measure_line_parts
from napari_elsplus.processing.analysis.saturation import saturation_level
from napari_elsplus.processing.analysis.uncertainty import newey_west_sigma
from napari_elsplus.processing.calibration.frame_regions import (
    column_between_views,
    mean_frame,
    sampled,
    saturated_share,
    unlit_pixels,
)
from napari_elsplus.processing.calibration.galvo import visible_line
from napari_elsplus.processing.calibration.line.clipping import MAX_CLIPPED_CORE, clipped_share
from napari_elsplus.processing.calibration.line.location import Line, locate_line
from napari_elsplus.processing.calibration.line.scatter import common_scatter_rows, relative_shifts
from napari_elsplus.processing.calibration.line.view_offset import ViewOffset
from napari_elsplus.processing.images.distortion import polynomial_terms
from napari_elsplus.processing.images.row_reference import RowReference

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.bundle.pair import BundlePair
    from napari_elsplus.processing.images.sectioning import Frames

    Image = NDArray[np.float32]

SAMPLING_ROWS: Final = 0.003
"""Rows; part of the offset's uncertainty that no residual shows: the views' pixels sample the cores at other phases.
Measured: bright lines on the presets' bundles are off by 0.0062 rows at 240 Hz (16 bundles) and 0.0020 at 120 Hz (5),
RMS, of which residuals show 0.0042 and 0.0034; with it 72 % of 90 random rigs (seeds 1000 to 1089) are within a sigma
of the truth."""
MAX_OFFSET_DIFFERENCE_ROWS: Final = 0.5
"""Between the slit offset and that of the bundle images, above which one is out of date; chosen, five times the
uncertainty of a bundle's centre, and twice what a ripple of the laser's power moves a line by."""
MIN_SCATTER_FRAMES: Final = 3
"""Frames of a standing line below which their scatter is not estimated; chosen."""
SEARCH_INTERVAL_FRAMES: Final = 60
"""Frames between searches of the whole view, as the followed line may be a reflection; chosen: half a second."""
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
        Core and halo of the line in the confocal view; None where its profile does not show both, or is saturated.
    clipped : float
        Saturated part of its core, in the frame in which it is largest.
    """

    rows: float
    uncertainty_rows: float
    confocal: Line
    residual: Line
    split: int
    unsteady_rows: float = 0.0
    parts: LineParts | None = None
    clipped: float = 0.0

    def view_offset(self, _line: Line | None = None) -> ViewOffset:
        """Return the offset from a line in the confocal view to that in the residual one.

        It is that of the measured line: without the bundle pair, the views are taken to have the same scale.
        """
        columns = self.split + self.residual.column - self.confocal.column
        return ViewOffset(self.rows, columns, self.residual.slope - self.confocal.slope)

    @property
    def lit_columns(self) -> list[tuple[int, int]]:
        """First lit column of the frame and the one after the last, in each view."""
        views = ((self.confocal, 0), (self.residual, self.split))
        return [(start + line.columns[0], start + line.columns[1]) for line, start in views]


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
    saturated_share(frames, "image of the line")
    discs, lit_columns = [] if pair is None else pair.discs, [] if near is None else near.lit_columns
    reference = RowReference(unlit_pixels(raw, background, discs, lit_columns), background)
    noisy = reference.some_show_noise(frames)
    frame = reference.without_row_noise(raw) if noisy else raw
    place = near or pair
    split = column_between_views(_less(frame, background)) if place is None else place.split
    lines = []
    for name, part in (("confocal", slice(0, split)), ("residual", slice(split, None))):
        dark = None if background is None else background[:, part]
        before = None if near is None else near.confocal if name == "confocal" else near.residual
        try:
            lines.append(locate_line(frame[:, part], dark, before))
        except MeasurementError as error:
            if dark is not None and visible_line(frame[:, part]) is not None:
                raise MeasurementError(
                    f"{name} view: the laser line does not stand out of the background",
                    "is the background that of a dark tube?",
                ) from None
            raise MeasurementError(f"{name} view: {error.problem}", error.remedy) from None
    clipped = max(clipped_share(each, saturation_level(each), lines[0]) for each in sampled(frames))
    found = replace(_of_lines(lines[0], lines[1], split, pair), clipped=clipped)
    if alone:
        return found
    if clipped <= MAX_CLIPPED_CORE:
        of_tube = None if background is None else background[:, :split]
        found = replace(found, parts=parts_of(lines[0], _less(frame[:, :split], of_tube)))
    if len(frames) < MIN_SCATTER_FRAMES:
        return found
    views = (lines[0], slice(0, split)), (lines[1], slice(split, None))
    single = (reference.without_row_noise(frames[k]) if noisy else frames[k] for k in range(len(frames)))
    shifts = relative_shifts(views, frame, single, background)
    unsteady_rows = common_scatter_rows(shifts)
    uncertainty_rows = float(np.hypot(found.uncertainty_rows, unsteady_rows))
    return replace(found, uncertainty_rows=uncertainty_rows, unsteady_rows=unsteady_rows)


def parts_of(line: Line, view: NDArray[np.generic]) -> LineParts | None:
    """Return core and halo of a line; None where its profile does not show both.

    Parameters
    ----------
    line : Line
        The line, near the middle of the bundle.
    view : numpy.ndarray
        (rows, cols) view in which it was located, without its background.
    """
    try:
        return measure_line_parts(view, line.row, line.slope, line.columns, line.width_rows)
    except MeasurementError:
        return None


def _less(frame: NDArray[Any], background: Image | None) -> Image:
    """Return a frame less the background, float32; without one, the frame itself where it is float32."""
    return np.asarray(frame, np.float32) if background is None else np.subtract(frame, background, dtype=np.float32)


def offset_at(offset: SlitOffset, pair: BundlePair) -> SlitOffset:
    """Return a slit offset at the centres of a bundle pair, by the line and by the pair's cores.

    The line may stand beside the centre: where the views differ in scale, the offset there differs from that at the
    centre, by the cores.

    Both views show the same cores, so that where the residual view shows those under the confocal line, its own must
    be: unlike the line, they do not depend on the laser's power, of which a ripple at a multiple of the frame rate has
    one phase in all frames and moves the line in all of them alike. The line is therefore at least as uncertain as it
    differs from the cores, and both are weighted by their variances. Where they differ by more than half a row, the
    tilt mirror was turned since: the pair is out of date, and the line counts alone.

    Parameters
    ----------
    offset : SlitOffset
        Of the line, measured with or without the pair.
    pair : BundlePair
        The bundle images; by their centres alone they do not show where the line is.
    """
    line = _of_lines(offset.confocal, offset.residual, offset.split, pair, offset.unsteady_rows)
    line = replace(line, rows=line.rows + _rows_by_distortion(line.confocal, pair))
    centre, confocal, sigma_rows = pair.confocal.centre, line.confocal, pair.alignment.centre_uncertainty_px
    row = confocal.bent_row_at(centre[1])
    rows, away_rows = _offset_of_cores(line, pair, centre[0]), line.rows - _offset_of_cores(line, pair, row)
    beside_rows = np.linalg.norm(np.linalg.inv(pair.alignment.residual_to_confocal[:, :2])[0] - (1, 0))
    placed_rows = float(beside_rows * pair.confocal.centre_uncertainty_px)  # of a view that is turned or scaled
    line = replace(line, rows=rows + away_rows, parts=offset.parts, clipped=offset.clipped)
    if pair.alignment.refusal or abs(away_rows) > MAX_OFFSET_DIFFERENCE_ROWS:
        return replace(line, uncertainty_rows=float(np.hypot(line.uncertainty_rows, placed_rows)))
    variances = np.array((max(line.uncertainty_rows**2, away_rows**2 - sigma_rows**2), sigma_rows**2))
    mean_rows = float(np.average((line.rows, rows), weights=1 / variances))
    sigma_rows = float(np.sqrt(1 / (1 / variances).sum() + placed_rows**2))
    return replace(line, rows=mean_rows, uncertainty_rows=sigma_rows)


def _of_lines(
    confocal: Line, residual: Line, split: int, pair: BundlePair | None = None, unsteady_rows: float = 0.0
) -> SlitOffset:
    """Return the offset of the lines alone, at the middle of their lit parts, or, by a pair, at the confocal centre.

    In the residual view that is where the cores of this centre lie: the middle of its rim may lie beside, and a tilted
    line is higher or lower there.
    """
    columns = confocal.column, residual.column
    if pair is not None:
        columns = pair.confocal.centre[1], _in_residual(pair, pair.confocal.centre[0])[1] - split
    influence = residual.influence_at(columns[1]) - confocal.influence_at(columns[0])
    rows = residual.row_at(columns[1]) - confocal.row_at(columns[0])
    # Where the views differ in light along a bowed line, the straight ones through it lie at different heights.
    bend = (confocal.bend + residual.bend) / 2
    rows += residual.bowed_rows(columns[1], bend) - confocal.bowed_rows(columns[0], bend)
    sigma = float(np.linalg.norm((newey_west_sigma(influence, _NEIGHBOURS), SAMPLING_ROWS, unsteady_rows)))
    return SlitOffset(rows, sigma, confocal, residual, split, unsteady_rows)


def _rows_by_distortion(line: Line, pair: BundlePair) -> float:
    """Return how far below the straight line through it the distortion of the residual view puts a line at its centre.

    Parameters
    ----------
    line : Line
        In the confocal view.
    pair : BundlePair
        With the distortion.
    """
    if pair.alignment.distortion is None:
        return 0.0
    (row, column), radius_px = pair.confocal.centre, pair.confocal.diameter_px / 2
    at = np.append(np.arange(*line.columns), column)
    rows = np.array([line.bent_row_at(each) for each in at.tolist()])
    bent = pair.alignment.distortion[0] @ polynomial_terms((rows - row) / radius_px, (at - column) / radius_px)
    return float(bent[-1] - np.polynomial.Polynomial.fit(at[:-1], bent[:-1], 1)(column))


def _offset_of_cores(line: SlitOffset, pair: BundlePair, row: float) -> float:
    """Return the slit offset, rows, of the cores under a confocal line on a row, parallel to a given one."""
    centre, at = _in_residual(pair, pair.confocal.centre[0]), _in_residual(pair, row)
    return float(at[0] + line.residual.slope * (centre[1] - at[1]) - row)


def _in_residual(pair: BundlePair, row: float) -> NDArray[np.float64]:
    """Return row and column at which the residual view shows the cores of a row of the confocal centre's column."""
    centre, alignment = pair.confocal.centre, pair.alignment
    affine = alignment.residual_to_confocal
    at = np.linalg.solve(affine[:, :2], np.array((row, centre[1])) - affine[:, 2])
    if alignment.distortion is not None:
        place = (row - centre[0]) / (pair.confocal.diameter_px / 2)
        at = at + alignment.distortion @ polynomial_terms(np.array(place), np.zeros(()))
    return np.asarray(at, np.float64)


class OffsetFollower:
    """Measures the slit offset in one frame after the other, each line searched near its last position.

    Core and halo of the line, which do not depend on the tilt mirror, are fitted whenever the whole view is searched.

    Parameters
    ----------
    background : numpy.ndarray, optional
        Mean frame of the dark tube.
    """

    def __init__(self, background: NDArray[np.float32] | None = None) -> None:
        self._background = background
        self._last: SlitOffset | None = None
        self._followed = 0

    def measure(self, frame: NDArray[np.generic]) -> SlitOffset:
        """Measure the offset in a raw frame (rows, cols).

        Raises
        ------
        MeasurementError
            If there is no line in one of the views.
        """
        last = self._last if self._followed < SEARCH_INTERVAL_FRAMES else None
        self._followed = 0 if last is None else self._followed + 1
        try:
            found = measure_offset([frame], self._background, near=last)
        except MeasurementError:
            self._last = None
            raise
        self._last = found if last is None else replace(found, parts=last.parts)
        return self._last
