"""Errors of a calibration, an image or a track against the ground truth of the simulation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.processing.analysis.image_quality import USED_DIAMETER
from napari_elsplus.processing.images.sectioning import Mode, Sectioner, disc
from napari_elsplus.simulation.truth import residual_to_confocal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.io import TrackPoint
    from napari_elsplus.simulation.model.instrument import Instrument

SMOOTHING_PX: Final = 1.5
"""Sigma, px, of the Gaussian applied before images are compared; chosen: it removes the cores, not the structure."""

WRONG_PX: Final = 3.0
"""Error of a displacement, camera px, beyond which a registration counts as wrong; chosen, about a core pitch."""


@dataclass(frozen=True, slots=True)
class CalibrationErrors:
    """Errors of a calibration: measured minus true.

    Attributes
    ----------
    offset_rows : float
        Slit offset.
    galvo_slope_percent : float
        Volts per row.
    galvo_intercept_rows : float
        Volts at row zero, in rows.
    centre_px : float
        Distance between the confocal centres.
    pair_alignment_px : float
        Largest error of the view alignment at the bundle's centre and four points of its rim.
    residual_gain_percent : float
        Gain of the residual view.
    """

    offset_rows: float
    galvo_slope_percent: float
    galvo_intercept_rows: float
    centre_px: float
    pair_alignment_px: float
    residual_gain_percent: float


def calibration_errors(calibration: Calibration, instrument: Instrument) -> CalibrationErrors:
    """Return the errors of a calibration against the true instrument.

    Raises
    ------
    CalibrationError
        If offset, galvo or bundle was not measured.
    """
    offset, galvo, bundle = calibration.measured_offset, calibration.measured_galvo, calibration.measured_bundle
    rim = instrument.diameter_px / 2 * np.array([(0, 0), (0, 1), (1, 0), (0, -1), (-1, 0)])
    places = np.column_stack([instrument.residual_centre + rim, np.ones(len(rim))])
    misplaced = places @ np.subtract(bundle.residual_to_confocal, residual_to_confocal(instrument)).T
    intercept_v = galvo.volts_at_row_zero - instrument.volts_at_row_zero
    return CalibrationErrors(
        offset_rows=offset.rows - instrument.offset_rows,
        galvo_slope_percent=100 * (galvo.volts_per_row / instrument.volts_per_row - 1),
        galvo_intercept_rows=intercept_v / instrument.volts_per_row,
        centre_px=float(np.hypot(*np.subtract(bundle.confocal_centre, instrument.confocal_centre))),
        pair_alignment_px=float(np.hypot(*misplaced.T).max()),
        residual_gain_percent=100 * (bundle.residual_gain / instrument.residual_view.gain - 1),
    )


def correlation_with_focal_plane(
    raw: NDArray[np.generic], in_focus: NDArray[np.generic], calibration: Calibration, mode: Mode
) -> float:
    """Return the correlation of an image with the confocal view of the focal plane alone.

    Parameters
    ----------
    raw, in_focus : numpy.ndarray
        Raw frames (rows, cols) of the whole scene, and of its focal plane without noise.
    calibration : Calibration
        With its bundle section.
    mode : Mode
        LS, residual or ELS+.

    Returns
    -------
    float
        Pearson's, inside 90 % of the disc, after a Gaussian of 1.5 px.
    """
    rows, cols = raw.shape
    sectioner = Sectioner(calibration, (rows, cols))
    used = disc(sectioner.side, USED_DIAMETER * sectioner.diameter_px)
    image = sectioner.section(raw, raw, mode)
    expected = sectioner.ls(in_focus)
    pair = [cv2.GaussianBlur(picture, (0, 0), SMOOTHING_PX)[used] for picture in (image, expected)]
    return float(np.corrcoef(*pair)[0, 1])


@dataclass(frozen=True, slots=True)
class TrackErrors:
    """Errors of a track against the true path.

    Attributes
    ----------
    frames, tracked, segments : int
        Frames of the recording; those that were tracked; segments that they form.
    median_pair_error_px : float
        Error of the displacement between successive tracked frames of a segment.
    wrong_links : int
        Displacements between tracked frames that are more than 3 px off.
    end_error_percent_of_path : float
        Sum over the segments of the error from first to last frame, over the path within them.
    path_px : float
        Length of the whole path.
    """

    frames: int
    tracked: int
    segments: int
    median_pair_error_px: float
    wrong_links: int
    end_error_percent_of_path: float
    path_px: float


def track_errors(rows: Sequence[TrackPoint], true_px: NDArray[np.float64]) -> TrackErrors:
    """Return the errors of a track, its rows, against the true path.

    Parameters
    ----------
    rows : sequence of TrackPoint
        One for each frame.
    true_px : numpy.ndarray
        (T, 2) true positions, row and column in camera pixels, when the middle row of the bundle was read.

    Examples
    --------
    >>> from types import SimpleNamespace as Row
    >>> rows = [Row(segment=0, row_px=0, col_px=k, state="tracked") for k in range(5)]
    >>> errors = track_errors(rows, np.array([(0, 1.01 * k) for k in range(5)]))
    >>> round(errors.median_pair_error_px, 3), round(errors.end_error_percent_of_path, 2)
    (0.01, 0.99)
    """
    found = np.array([(row.row_px, row.col_px) for row in rows], float)
    segment = np.array([row.segment for row in rows])
    tracked = np.array([row.state == "tracked" for row in rows])
    step = np.diff(true_px, axis=0)
    linked = tracked[1:] & tracked[:-1] & (segment[1:] == segment[:-1])
    error_px = np.hypot(*(np.diff(found, axis=0) - step).T)[linked]
    length_px = np.hypot(*step.T)
    end_error_px = path_px = 0.0
    for number in np.unique(segment[tracked]):
        frames = np.flatnonzero(tracked & (segment == number))
        first, last = frames[0], frames[-1]
        end_error_px += float(np.hypot(*(found[last] - found[first] - true_px[last] + true_px[first])))
        path_px += float(length_px[first:last].sum())
    return TrackErrors(
        frames=len(rows),
        tracked=int(tracked.sum()),
        segments=len(np.unique(segment[tracked])),
        median_pair_error_px=float(np.median(error_px)) if len(error_px) else float("nan"),
        wrong_links=int((error_px > WRONG_PX).sum()),
        end_error_percent_of_path=100 * end_error_px / path_px if path_px else float("nan"),
        path_px=float(length_px.sum()),
    )
