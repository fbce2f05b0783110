"""Scatter of a standing line from frame to frame, without a whole fit of each frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from napari_elsplus.processing.calibration.line.location import locate_line
from napari_elsplus.processing.calibration.line.scatter import LineShifts, common_scatter_rows
from napari_elsplus.simulation.calibration_scenes import line_volts, standing_line
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument


@pytest.mark.parametrize("imperfection", ["line-jitter=0.3", "power-noise=5"])
def test_shifts_are_those_of_fits_of_single_frames(imperfection: str) -> None:
    instrument = replace(Instrument.of("240hz"), imperfections=Imperfections.parse(imperfection))
    volts = line_volts(instrument)[:5]
    confocal = slice(0, round(instrument.confocal_centre[1] + instrument.residual_centre[1]) // 2)
    views = [np.asarray(frame[:, confocal], np.float32) for frame in standing_line(instrument, volts, seed=7301)]
    mean = np.mean(views, axis=0)
    line = locate_line(mean)
    shifts = np.array([LineShifts(mean, line).shifts_rows(view).sum() for view in views])
    fitted = np.array([locate_line(view).row_at(line.column) for view in views])
    assert np.std(fitted) > 0.03
    assert shifts == pytest.approx(fitted - fitted.mean(), rel=0.1, abs=0.02)


def test_noise_of_single_columns_is_no_common_scatter() -> None:
    """It is in the residuals of the fit to the mean: counted twice, 87 % of offsets were within one sigma."""
    random = np.random.default_rng(7302)
    apart = random.normal(0, 0.01, (400, 10, 32))
    of_mean = 0.01 * np.sqrt(32 / 10)
    found = np.array([common_scatter_rows(shifts) for shifts in apart])
    assert np.sqrt(np.mean(np.square(found))) < 0.6 * of_mean
    both = [common_scatter_rows(shifts + random.normal(0, 0.01, (10, 1))) for shifts in apart]
    assert np.median(both) == pytest.approx(0.01 * 32 / np.sqrt(10), rel=0.15)
