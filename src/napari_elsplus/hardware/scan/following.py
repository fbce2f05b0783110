"""The drive as the galvo's response is fitted to it, and the frame rate that a galvo can follow."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.scan.waveform import els_waveform
from napari_elsplus.processing.calibration.scan.galvo_response import Drive

if TYPE_CHECKING:
    from napari_elsplus.hardware.scan.timing import ScanTiming
    from napari_elsplus.hardware.scan.waveform import GalvoLimits, Waveform
    from napari_elsplus.instrument.calibration import Calibration, GalvoSection

STEPS: Final = 1024
"""Of the drive over a frame period; chosen: steps of 4 to 8 us at the presets' rates."""
RATE_STEP_HZ: Final = 1.0
"""Resolution of the highest frame rate; chosen."""


def drive_of(waveform: Waveform, galvo: GalvoSection, timing: ScanTiming) -> Drive:
    """Return the drive of a waveform of one ramp over a frame period, in rows of a galvo map.

    Parameters
    ----------
    waveform : Waveform
        Repeated in every frame; its last sample is held until the next strobe.
    galvo : GalvoSection
        Volts of the rows.
    timing : ScanTiming
        Exposure times of the rows.
    """
    period = timing.frame_period_s
    ends = np.r_[np.arange(len(waveform.volts)) / waveform.sample_rate_hz, period]
    area = np.r_[0.0, np.cumsum(waveform.volts * np.diff(ends))]
    edges = np.linspace(0.0, period, STEPS + 1)
    volts = np.diff(np.interp(edges, ends, area)) * STEPS / period
    return Drive(np.asarray(galvo.row(volts)), period, timing.time_s(0.0), timing.line_period_s)


def highest_rate_hz(calibration: Calibration, timing: ScanTiming, limits: GalvoLimits) -> float:
    """Return the highest frame rate up to the present one at which the limits allow a scan; 0 if none does.

    Parameters
    ----------
    calibration : Calibration
        With galvo and bundle sections.
    timing : ScanTiming
        From the camera.
    limits : GalvoLimits
        From the rig.
    """
    rates_hz = np.arange(np.floor(1 / timing.frame_period_s), 0, -RATE_STEP_HZ)
    slower = (replace(timing, line_periods_per_frame=1 / (rate * timing.line_period_s)) for rate in rates_hz)
    return next((1 / slow.frame_period_s for slow in slower if _fits(calibration, slow, limits)), 0.0)


def _fits(calibration: Calibration, timing: ScanTiming, limits: GalvoLimits) -> bool:
    try:
        els_waveform(calibration, timing, limits)
    except InputError:
        return False
    return True
