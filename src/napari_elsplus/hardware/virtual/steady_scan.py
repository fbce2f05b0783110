"""Line positions of a scan that repeats: the drive of a rig file's galvo, followed by the galvo as it moves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.hardware.scan.timing import ScanTiming
from napari_elsplus.hardware.scan.waveform import GalvoLimits, els_waveform
from napari_elsplus.hardware.virtual.galvo import STEADY_AFTER, GalvoModel, imperfect_galvo
from napari_elsplus.hardware.virtual.timeline import Program, StrobeTrain
from napari_elsplus.simulation.truth import true_calibration

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.simulation.model.instrument import Instrument


def steady_line_rows(instrument: Instrument) -> NDArray[np.float64]:
    """Return the line positions (rows,) of a periodic ELS+ scan, as :meth:`Renderer.render` takes them.

    The drive compensates the simulated rig's galvo and the true galvo's lag behind a steady ramp, as one that was
    measured with a single lag does.

    Parameters
    ----------
    instrument : Instrument
        The instrument; its imperfections state how the galvo moves.

    Raises
    ------
    InputError
        If the flyback does not fit the frame.
    """
    galvo = GalvoModel()
    limits = GalvoLimits(natural_hz=galvo.natural_hz, damping=galvo.damping)
    lagging = true_calibration(instrument).with_galvo(lag_s=imperfect_galvo(galvo, instrument.imperfections).lag_s)
    return driven_line_rows(instrument, lagging, limits, galvo)


def driven_line_rows(
    instrument: Instrument, calibration: Calibration, limits: GalvoLimits, galvo: GalvoModel
) -> NDArray[np.float64]:
    """Return the line positions (rows,) of the periodic ELS+ scan that a calibration drives.

    Parameters
    ----------
    instrument : Instrument
        The instrument; its imperfections state how the galvo moves.
    calibration : Calibration
        With galvo map, lag and bundle.
    limits : GalvoLimits
        What the rig states about its galvo.
    galvo : GalvoModel
        The galvo, but for its imperfections.

    Raises
    ------
    InputError
        If the flyback does not fit the frame.
    """
    optics, slit_rows = instrument.optics, round(instrument.slit_rows)
    timing = ScanTiming(optics.line_period_s, optics.line_periods_per_frame, slit_rows)
    drive = els_waveform(calibration, timing, limits)
    train = StrobeTrain(0.0, timing.frame_period_s)
    output = Program(
        0.0, float(drive.volts[0]), drive.volts, drive.samples_per_ramp, drive.sample_rate_hz, strobe=train
    )
    strobe_s = STEADY_AFTER * timing.frame_period_s
    rows = np.arange(instrument.frame_shape[0], dtype=np.float64)
    middles_s = np.asarray(strobe_s + timing.row_zero_s + (rows - timing.slit_rows / 2) * timing.line_period_s)
    moved = imperfect_galvo(galvo, instrument.imperfections)
    return instrument.line_row(moved.position([output], middles_s, strobe_s))
