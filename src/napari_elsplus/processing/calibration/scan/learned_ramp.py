"""A ramp learned from what the camera sees: scan, find each row's error, fit the galvo's response, correct, scan again.

A galvo that differs from the rig's file follows the ramp only after a transient, which at full frame rate lasts over
many rows. The first correction inverts a response fitted to the row errors; what remains is taken off the path itself,
in the manner of iterative learning control (Bristow et al. 2006, https://doi.org/10.1109/MCS.2006.1636313).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.processing.calibration.scan.galvo_response import ScanRecord, fit_galvo_response
from napari_elsplus.processing.calibration.scan.row_errors import RowErrors, RowProfile, find_row_errors, join_views

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.scan.galvo_response import Drive, GalvoResponse
    from napari_elsplus.processing.images.sectioning import Frames
    from napari_elsplus.processing.progress import ProgressWrapper

    Floats = NDArray[np.float64]

TOLERATED_SLIT_SHARE: Final = 0.25
"""Largest row error over the slit's width; chosen: a line as wide as it then loses a hundredth of its light."""
WIDE_ROWS: Final = 60.0
"""Shifts to either side that show the errors of an unknown galvo; chosen: farther rows follow from the fit."""
CORRECTED_ROWS: Final = (20.0, 8.0, 8.0, 8.0)
"""Shifts to either side after each correction, in rows; chosen, beyond the errors that the one before leaves."""
AIM: Final = 0.5
"""Share of the limit at which the corrections end; chosen: what is measured is itself uncertain by some hundredths."""
SHIFT_STEP_ROWS: Final = 1.5
"""From one shift to the next; chosen: several shifts across the line."""
WIDE_STRIDE: Final = 2
"""Of these steps, from one shift to the next before the first correction; chosen: two shifts across the line show to a
fraction of a row where it is, and the shifts after the correction measure what is left."""
MIN_SHIFTS: Final = 5
"""Within the galvo's limits, for the errors of a view; chosen: a parabola has three parameters."""
MIN_SEEN: Final = 0.4
"""Share of the lit rows whose error must be known for a fit; chosen: the transient and some of the ramp."""


class Scans(Protocol):
    """Scans by trial calibrations, as a step that estimates the scan takes them from a rig."""

    def frames(self, calibration: Calibration, count: int) -> Frames:
        """Take a count of frames of a scan by a calibration, once the galvo's motion repeats."""

    def drive(self, calibration: Calibration) -> Drive:
        """Return the drive of a scan by a calibration; raise an InputError if the galvo's limits do not allow it."""

    def highest_rate_hz(self, calibration: Calibration) -> float:
        """Return the highest frame rate at which the galvo's limits allow a scan by a calibration; 0 for none."""


@dataclass(frozen=True, slots=True)
class LearnedRamp:
    """Correction of a ramp, and the row errors without and with it.

    Parameters
    ----------
    before, after : RowErrors
        Of the scans without and with the correction.
    limit_rows : float
        Error beyond which a row misses the slit: a quarter of it.
    response : GalvoResponse
        Of the galvo, as far as these scans show it.
    correction : numpy.ndarray, optional
        Rows that are added to the path of the line at each row, shape (rows,); None if no scan was better.
    frames : int
        Number of frames that were taken.
    highest_rate_hz : float, optional
        Frame rate that the galvo can follow, if it cannot follow the present one; 0 if it can follow none.
    """

    before: RowErrors
    after: RowErrors
    limit_rows: float
    response: GalvoResponse
    correction: Floats | None
    frames: int
    highest_rate_hz: float | None

    @property
    def off_before(self) -> int:
        """Number of rows that miss the slit without the correction."""
        return self.before.count_off(self.limit_rows)

    @property
    def off(self) -> int:
        """Number of rows that miss the slit with the correction."""
        return self.after.count_off(self.limit_rows)


def shifted(calibration: Calibration, rows: float) -> Calibration:
    """Return a calibration by which the line is a number of rows lower at all times."""
    galvo = calibration.measured_galvo
    return calibration.with_galvo(volts_at_row_zero=galvo.volts_at_row_zero + rows * galvo.volts_per_row)


def corrected(calibration: Calibration, response: GalvoResponse, correction: Floats) -> Calibration:
    """Return a calibration whose ramp compensates a galvo's response and adds a correction in rows, shape (rows,)."""
    driven = calibration.with_galvo(lag_s=response.lag_s, natural_hz=response.natural_hz, damping=response.damping)
    return driven.model_copy(update={"scan_correction": correction.astype(np.float32)})


class RampLearner:
    """Measures the row errors of scans by trial calibrations, and corrects the ramp.

    Parameters
    ----------
    scans : Scans
        Of the rig.
    calibration : Calibration
        With galvo and bundle sections.
    shape : tuple of int
        Rows and columns of a frame.
    slit_rows : float
        Slit width.
    """

    def __init__(self, scans: Scans, calibration: Calibration, shape: tuple[int, int], slit_rows: float) -> None:
        self._scans, self._calibration = scans, calibration
        bow_rows = 0.0 if calibration.galvo is None else calibration.galvo.bow_rows or 0.0
        self.profile = RowProfile(calibration.measured_bundle, shape, bow_rows)
        self.limit_rows = TOLERATED_SLIT_SHARE * slit_rows
        self.frames = 0

    def confocal_errors(self, shifts_rows: Floats, profiles: Floats) -> RowErrors:
        """Return the row errors of the confocal view alone, from its profiles at shifts in rows, shape (n, 2, rows)."""
        lit = self.profile.lit[0]
        confocal = find_row_errors(shifts_rows, profiles[:, 0], lit) + self.profile.bowed_rows
        return join_views(confocal, np.full_like(confocal, np.nan), lit)

    def learn(self, lag_s: float, progress: ProgressWrapper = iter) -> LearnedRamp:
        """Correct the ramp until no row is off by more than the limit; keep the best.

        Parameters
        ----------
        lag_s : float
            Lead of the scan without a correction.
        progress : callable
            Wraps the numbers of each series of scans.

        Raises
        ------
        MeasurementError
            If the line is on the slit, or near it, in too few rows to learn from.
        """
        start = self._calibration.with_galvo(lag_s=lag_s)
        before = self._measure(start, WIDE_ROWS, progress, WIDE_STRIDE)
        if before.seen_share < MIN_SEEN:
            raise MeasurementError(
                f"the line passes the slit in {100 * before.seen_share:.0f} % of the rows only: no ramp to learn from",
                "put the probe onto something that fluoresces evenly, and check the galvo map",
            )
        scans = [ScanRecord(self._scans.drive(start), before.rows)]
        best, best_scan = before, None
        kept: tuple[GalvoResponse, Floats | None] | None = None
        response, highest_rate_hz = None, None
        for reach_rows in CORRECTED_ROWS:
            response = fit_galvo_response(scans, response)
            left = 0.0 if best_scan is None else _filled(best_scan.unexplained(response))
            correction = np.asarray(-response.static_rows - left, np.float64)
            trial = corrected(start, response, correction)
            try:
                self._scans.drive(trial)
            except InputError:
                if best is before:
                    highest_rate_hz = self._scans.highest_rate_hz(trial)
                break
            errors = self._measure(trial, reach_rows, progress)
            if errors.seen_share < MIN_SEEN and best is before:
                highest_rate_hz = self._measurable_rate_hz(trial)
                break
            scans.append(ScanRecord(self._scans.drive(trial), errors.rows))
            if errors.cost < best.cost:
                best, best_scan, kept = errors, scans[-1], (response, correction)
            if best.count_off(AIM * self.limit_rows) == 0:
                break
        assert response is not None
        learned, applied = kept or (response, None)
        return LearnedRamp(before, best, self.limit_rows, learned, applied, self.frames, highest_rate_hz)

    def _measure(self, trial: Calibration, reach_rows: float, progress: ProgressWrapper, stride: int = 1) -> RowErrors:
        """Measure row errors with shifts about those at which the confocal, and the residual view is brightest."""
        reach, offset = (
            stride * round(rows / SHIFT_STEP_ROWS / stride) for rows in (reach_rows, self.profile.offset_rows)
        )
        steps = np.arange(-reach, reach + 1, stride)
        numbers = self._allowed(trial, np.union1d(steps, steps - offset))
        profiles = {}
        for number in progress(range(len(numbers))):
            frames = self._scans.frames(shifted(trial, SHIFT_STEP_ROWS * numbers[number]), 1)
            profiles[numbers[number]] = self.profile(frames)
            self.frames += len(frames)
        found = []
        for view, centre in enumerate((0, -offset)):
            near = np.intersect1d(centre + steps, numbers)
            if len(near) < MIN_SHIFTS:
                found.append(np.full(self.profile.lit.shape[1], np.nan))
                continue
            stack = np.array([profiles[number][view] for number in near])
            shifts = np.asarray(SHIFT_STEP_ROWS * near, np.float64)
            found.append(find_row_errors(shifts, stack, self.profile.lit[view]) + self.profile.bowed_rows)
        return join_views(found[0], found[1] - self.profile.offset_rows, np.asarray(self.profile.lit.any(axis=0)))

    def _allowed(self, trial: Calibration, numbers: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the numbers of those shifts of a trial that the galvo's limits allow: both ends may be beyond them."""
        first, stop = 0, len(numbers)
        while first < stop and not self._fits(trial, numbers[first]):
            first += 1
        while first < stop and not self._fits(trial, numbers[stop - 1]):
            stop -= 1
        return numbers[first:stop]

    def _measurable_rate_hz(self, trial: Calibration) -> float | None:
        """Return the highest frame rate at which the galvo's limits allow the shifts of a trial; None if they do."""
        ends = [shifted(trial, side * CORRECTED_ROWS[-1]) for side in (-1, 1)]
        rates_hz = [self._scans.highest_rate_hz(end) for end in ends if not self._fits(end, 0)]
        return min(rates_hz, default=None)

    def _fits(self, trial: Calibration, number: int) -> bool:
        try:
            self._scans.drive(shifted(trial, SHIFT_STEP_ROWS * number))
        except InputError:
            return False
        return True


def _filled(errors: Floats) -> Floats:
    """Return the errors with unknown rows interpolated, and held beyond the known ones; zero without any."""
    known = np.flatnonzero(np.isfinite(errors))
    if not len(known):
        return np.zeros_like(errors)
    return np.asarray(np.interp(np.arange(len(errors)), known, errors[known]), np.float64)
