"""Scans of a running engine by trial calibrations, for the steps that estimate the scan itself."""

from __future__ import annotations

from math import ceil
from typing import TYPE_CHECKING

from napari_elsplus.acquisition.calibrating.capture import MOVED_S, settled_frames
from napari_elsplus.hardware.scan.following import drive_of, highest_rate_hz

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.acquisition.engine.engine import Engine
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.scan.galvo_response import Drive


def unsteady_ramps(frame_period_s: float) -> int:
    """Return the number of ramps, each a `frame_period_s` long, after which a galvo repeats its motion.

    The first begins at rest, and what differs then decays as after any motion.

    Examples
    --------
    >>> [unsteady_ramps(1 / rate_hz) for rate_hz in (240, 230, 120)]
    [2, 2, 1]
    """
    return ceil(MOVED_S / frame_period_s)


class TrialScans:
    """Scans by trial calibrations; see :class:`napari_elsplus.processing.calibration.scan.learned_ramp.Scans`.

    Parameters
    ----------
    engine : Engine
        Streaming.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def frames(self, calibration: Calibration, count: int) -> NDArray[np.uint8]:
        """Take a count of frames (count, rows, cols) by a calibration, without the ramps before its motion repeats."""
        self._engine.scan(calibration)
        period_s = self._engine.galvo.timing.frame_period_s
        return settled_frames(self._engine, count, unsteady_ramps(period_s) * period_s)

    def drive(self, calibration: Calibration) -> Drive:
        """Return the drive of a scan by a calibration; raise an InputError if the galvo's limits do not allow it."""
        calibration.require("galvo", "bundle")
        waveform = self._engine.galvo.waveform(calibration)
        assert waveform is not None
        return drive_of(waveform, calibration.measured_galvo, self._engine.galvo.timing)

    def highest_rate_hz(self, calibration: Calibration) -> float:
        """Return the highest frame rate at which the galvo's limits allow a scan by a calibration; 0 for none."""
        return highest_rate_hz(calibration, self._engine.galvo.timing, self._engine.galvo.limits)
