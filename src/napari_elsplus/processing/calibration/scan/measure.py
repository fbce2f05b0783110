"""The scan at full speed, measured: its lag, the row errors that the lag leaves, and a ramp that corrects them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.calibration.scan.lag import FINE_SHIFTS, ScanLag, fit_lag, take_leads
from napari_elsplus.processing.calibration.scan.learned_ramp import LearnedRamp, RampLearner, Scans, shifted

if TYPE_CHECKING:
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.draft import Setup
    from napari_elsplus.processing.progress import ProgressWrapper


def measure_scan(
    scans: Scans, calibration: Calibration, setup: Setup, frames: int, progress: ProgressWrapper = iter
) -> ScanLag:
    """Measure the scan lag and the row errors; learn the ramp where a row is off by more than a quarter of the slit.

    Parameters
    ----------
    scans : Scans
        Of the rig, on an evenly fluorescent target.
    calibration : Calibration
        With galvo and bundle sections.
    setup : Setup
        Settings of the rig, with the line period.
    frames : int
        Averaged for each lead.
    progress : callable
        Wraps the numbers of each series of scans, to display progress, or to cancel.

    Returns
    -------
    ScanLag

    Raises
    ------
    MeasurementError
        If the signal has no maximum within the leads, and no ramp can be learned.
    """
    period_s = setup.line_period_s
    assert period_s is not None
    calibration = calibration.with_galvo(natural_hz=None, damping=None).model_copy(update={"scan_correction": None})
    learner = RampLearner(scans, calibration, setup.frame.shape, setup.acquired_with.slit_rows_or_default)
    profiles = []

    def signal_at(lead_s: float, shift_rows: float) -> float:
        trial = shifted(calibration.with_galvo(lag_s=lead_s), shift_rows)
        profiles.append(learner.profile(scans.frames(trial, frames)))
        return float(profiles[-1][0, learner.profile.lit[0]].mean())

    leads_s, signal = take_leads(signal_at, period_s, progress)
    centre_s = float(leads_s[-len(FINE_SHIFTS)] - FINE_SHIFTS[0] * period_s)
    errors = learner.confocal_errors(FINE_SHIFTS, np.array(profiles[-len(FINE_SHIFTS) :]))
    try:
        found = fit_lag(leads_s, signal, period_s)
    except MeasurementError as refusal:
        ramp = _learned(learner, float(leads_s[int(np.argmax(signal))]), refusal, progress)
        found = ScanLag(ramp.response.lag_s, ramp.response.lag_uncertainty_s, leads_s, signal)
    else:
        # The signal is that of the middles of the chords.
        found = replace(found, lag_s=found.lag_s - learner.profile.bowed_rows * period_s)
        errors = replace(errors, rows=errors.rows + (found.lag_s - centre_s) / period_s)
        if not errors.count_off(learner.limit_rows):
            return replace(found, row_errors=errors)
        ramp = learner.learn(found.lag_s, progress)
    if ramp.correction is not None:
        found = replace(found, lag_s=ramp.response.lag_s, uncertainty_s=ramp.response.lag_uncertainty_s)
    return replace(found, row_errors=ramp.after, ramp=ramp)


def _learned(learner: RampLearner, lag_s: float, refusal: MeasurementError, progress: ProgressWrapper) -> LearnedRamp:
    """Learn a ramp from the brightest lead where the lag was refused; raise the refusal if that fails, too."""
    try:
        ramp = learner.learn(lag_s, progress)
    except MeasurementError:
        raise refusal from None
    if ramp.correction is None and ramp.highest_rate_hz is None:
        raise refusal
    return ramp
