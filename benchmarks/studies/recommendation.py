"""Predicted sectioning of the line that was calibrated, against simulated scans of depths at random settings."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from napari_elsplus.simulation.calibration_scenes import line_volts, standing_line
from napari_elsplus.simulation.model.axial_response import LINE_MODELS
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.truth import true_calibration
from napari_elsplus.workflows.axial import measure_axial_response
from napari_elsplus.workflows.calibration import calibrate
from napari_elsplus.workflows.recommendation.line_estimate import calibrated_line
from napari_elsplus.workflows.recommendation.recommend import predict_line, prediction_sigmas
from napari_elsplus.workflows.simulated import simulate_axial_scan

if TYPE_CHECKING:
    from napari_elsplus.instrument.calibration import Calibration


class Setting(NamedTuple):
    """State of the line, slit offset (um) and slit (rows)."""

    state: str
    offset_um: float
    slit_rows: float


class Compared(NamedTuple):
    """A predicted and a measured value, and the standard deviation of their difference."""

    predicted: float
    measured: float
    sigma: float

    @property
    def error(self) -> float:
        """Relative error of the prediction."""
        return self.predicted / self.measured - 1

    @property
    def sigmas(self) -> float:
        """Error over its standard deviation, without sign."""
        return abs(self.predicted - self.measured) / self.sigma


@cache
def calibrated(state: str, seed: int = 5) -> Calibration:
    """Return the calibration of a rig whose line was measured on frames of it standing still."""
    instrument = replace(Instrument.of("120hz"), line=LINE_MODELS[state])
    found = calibrate(line=list(standing_line(instrument, line_volts(instrument), seed=seed)))
    return true_calibration(instrument).model_copy(update={"offset": found.calibration.offset})


def random_settings(count: int, seed: int) -> list[Setting]:
    """Return settings drawn at random: both lines, offsets of 12 to 80 um, slits of 1 to 6 rows."""
    random = np.random.default_rng(seed)
    return [
        Setting(str(random.choice(["a", "b"])), float(random.uniform(12, 80)), float(random.integers(1, 7)))
        for _ in range(count)
    ]


def compare_prediction(setting: Setting) -> dict[str, Compared]:
    """Return 3 dB and 10 dB distance (um) and signal kept, predicted and measured in raw frames of a scan."""
    state, offset_um, slit_rows = setting
    slit_um = slit_rows * Instrument.of("120hz").optics.um_per_px
    estimate = calibrated_line(calibrated(state))
    found = predict_line(estimate.line, offset_um, slit_um, 100.0)
    near = np.linspace(0.75, 1.3, 5)
    depths = np.unique(np.r_[0.0, 3.0, 6.0, found.drop_3db_um * near, found.drop_10db_um * near].round(1))
    scan = simulate_axial_scan(slit_um=slit_um, offset_um=offset_um, state=state, depth_um=depths, seed=6)
    seen = measure_axial_response(scan, scan.calibration, depths)
    sigmas = prediction_sigmas(list(estimate.draws(32)), found, offset_um, slit_um, 100.0)
    measured = {
        "drop_3db_um": (seen.els_3db.um, seen.els_3db.uncertainty_um),
        "drop_10db_um": (seen.els_10db.um, seen.els_10db.uncertainty_um),
        "signal_kept": (seen.signal_kept, seen.signal_kept_uncertainty),
    }
    return {
        name: Compared(getattr(found, name), value, float(np.hypot(sigmas[name], sigma)))
        for name, (value, sigma) in measured.items()
    }
