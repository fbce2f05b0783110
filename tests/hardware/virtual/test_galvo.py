"""The virtual galvo moves by its own dynamics, which may differ from what the rig states."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.hardware.virtual.galvo import STEP_S, GalvoModel, imperfect_galvo
from napari_elsplus.hardware.virtual.steady_scan import steady_line_rows
from napari_elsplus.hardware.virtual.timeline import Program, StrobeTrain
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument


@pytest.mark.parametrize(
    "galvo", [GalvoModel(), GalvoModel(500.0, 0.3), GalvoModel(2000.0, 1.5), GalvoModel(delay_s=2e-4)]
)
def test_a_galvo_lags_behind_a_ramp_by_its_lag_and_settles_within_its_time(galvo: GalvoModel) -> None:
    rate = 1 / STEP_S
    ramp = Program(0.0, 0.0, np.arange(20_000) / rate, 20_000, rate, strobe=StrobeTrain(0.0, 1.0))
    times = np.linspace(0.05, 0.06, 100)
    position = galvo.position([ramp], times, times[0])
    np.testing.assert_allclose(times - position, galvo.lag_s + STEP_S / 2, atol=1e-6)


def test_a_galvo_as_stated_keeps_the_line_on_the_slit_and_another_one_does_not() -> None:
    ideal = steady_line_rows(Instrument.of("240hz"))
    off = ideal - np.arange(len(ideal))
    lit = slice(100, 440)
    assert np.abs(off[lit]).max() < 0.1
    slow = Instrument.of("240hz", imperfections=Imperfections.parse("galvo-resonance=800"))
    off = steady_line_rows(slow) - np.arange(len(ideal))
    assert np.abs(off[lit]).max() > 1.5


def test_imperfections_replace_what_the_rig_states() -> None:
    galvo = imperfect_galvo(GalvoModel(1000.0, 0.7), Imperfections.parse("galvo-damping=0.4,galvo-delay=50"))
    assert (galvo.natural_hz, galvo.damping, galvo.delay_s) == pytest.approx((1000.0, 0.4, 50e-6))
