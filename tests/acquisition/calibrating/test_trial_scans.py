"""Trial scans: frames are taken once the galvo repeats its motion."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.acquisition.calibrating.live import unsteady_ramps
from napari_elsplus.hardware.scan.waveform import GalvoLimits
from napari_elsplus.hardware.virtual import steady_scan
from napari_elsplus.hardware.virtual.galvo import GalvoModel, imperfect_galvo
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.truth import true_calibration

WIDE = GalvoLimits(min_v=-3.0, max_v=3.0)


@pytest.mark.parametrize(
    ("galvo", "rate_hz"),
    [
        ("galvo-resonance=500,galvo-damping=0.3", 230.0),
        ("galvo-resonance=540,galvo-damping=0.4", 237.0),
        ("galvo-resonance=650,galvo-damping=0.34", 240.0),
        ("galvo-resonance=500,galvo-damping=0.3", 120.0),
    ],
)
def test_frames_of_a_trial_are_those_of_the_scan_that_lasts(
    monkeypatch: pytest.MonkeyPatch, galvo: str, rate_hz: float
) -> None:
    """Before: the second ramp of slow galvos was taken at 240 Hz, 3 to 12 rows beside those that follow."""
    instrument = Instrument.of("240hz", imperfections=Imperfections.parse(galvo), rate_hz=rate_hz)
    moved = imperfect_galvo(GalvoModel(), instrument.imperfections)
    known = true_calibration(instrument).with_galvo(
        lag_s=moved.lag_s, natural_hz=moved.natural_hz, damping=moved.damping
    )

    def rows(ramp: int) -> np.ndarray:
        monkeypatch.setattr(steady_scan, "STEADY_AFTER", ramp)
        lit = np.abs(np.arange(instrument.frame_shape[0]) - instrument.confocal_centre[0]) < instrument.diameter_px / 2
        return np.asarray(steady_scan.driven_line_rows(instrument, known, WIDE, GalvoModel())[lit])

    lasting, ramps = rows(12), unsteady_ramps(1 / rate_hz)
    assert np.abs(rows(ramps) - lasting).max() < instrument.slit_rows / 20
    assert np.abs(rows(0) - lasting).max() > instrument.slit_rows / 4
