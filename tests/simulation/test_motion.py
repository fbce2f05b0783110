"""What motion does to sequential and to simultaneous subtraction (paper, Sec. 3.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.specimen.trajectories import Straight


@dataclass
class Later:
    """A path run later: what a view read earlier by so much would see."""

    path: Straight
    by_s: float

    def positions_um(self, times_s: np.ndarray) -> np.ndarray:
        return self.path.positions_um(times_s - self.by_s)


def errors(um_per_frame: float, rate_hz: float) -> tuple[float, float]:
    """Share of the residual's RMS by which it is wrong for ELSA and for ELS+, against one seen when confocal was."""
    instrument = Instrument.of("120hz", rate_hz=rate_hz)
    path = Straight(um_per_frame * rate_hz, direction_deg=30)
    lag_s = instrument.offset_rows * instrument.optics.line_period_s
    moving = Renderer(instrument, scene("fibres"), path, noise=False)
    at_confocal_time = Renderer(instrument, scene("fibres"), Later(path, lag_s), noise=False)
    truth = at_confocal_time.core_values(0)[1].copy()
    simultaneous = moving.core_values(0)[1].copy()
    sequential = moving.core_values(1)[1].copy()
    rms = np.sqrt((truth**2).mean())
    return tuple(float(np.sqrt(((seen - truth) ** 2).mean()) / rms) for seen in (sequential, simultaneous))  # type: ignore[return-value]


def test_sequential_error_grows_with_the_shift() -> None:
    elsa = [errors(um, 120.0)[0] for um in (1.0, 4.0, 16.0)]
    assert elsa[1] > 3 * elsa[0] > 0.03
    assert elsa[2] > 1.5 * elsa[1]


@pytest.mark.parametrize("rate_hz", [10.0, 120.0])
def test_simultaneous_error_is_smaller_by_frame_period_over_lag(rate_hz: float) -> None:
    optics = Instrument.of("120hz", rate_hz=rate_hz).optics
    lag_s = abs(Instrument.of("120hz").offset_rows) * optics.line_period_s
    elsa, els_plus = errors(1.0, rate_hz)
    assert elsa / els_plus == pytest.approx(optics.frame_period_s / lag_s, rel=0.2)
