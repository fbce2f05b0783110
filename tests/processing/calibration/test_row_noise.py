"""Line and sweep in frames whose rows are read with offsets of their own: as without them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.calibration.galvo import fit_galvo
from napari_elsplus.processing.calibration.line.location import locate_line
from napari_elsplus.processing.calibration.measurements import map_galvo, measure_pair
from napari_elsplus.processing.calibration.slit_offset import measure_offset
from napari_elsplus.processing.images.row_reference import RowReference, dark_columns, dark_pixels
from napari_elsplus.simulation.calibration_scenes import standing_line, transmission
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument

VOLTAGES = 24


def noisy(preset: str, row_noise_dn: float) -> Instrument:
    return replace(Instrument.of(preset), imperfections=Imperfections(row_noise_dn=row_noise_dn))


def volts_of(instrument: Instrument, row: float) -> float:
    return instrument.volts_at_row_zero + instrument.volts_per_row * row


@pytest.mark.parametrize("preset", ["240hz", "120hz"])
def test_the_offset_is_found_within_what_is_stated_under_row_noise(preset: str) -> None:
    instrument = noisy(preset, 2.0)
    frames = list(standing_line(instrument, np.full(10, volts_of(instrument, instrument.confocal_centre[0])), seed=77))
    found = measure_offset(frames)
    error = found.rows - (instrument.residual_centre[0] - instrument.confocal_centre[0])
    assert abs(error) < 0.02
    assert abs(error) < 3 * found.uncertainty_rows


def test_views_that_fill_the_frame_leave_a_reference_beside_their_middles() -> None:
    """With the bundle pair located, the offset was off by 0.05 rows, as the line's own rows had no reference."""
    instrument = noisy("120hz", 2.0)
    volts = np.full(3, volts_of(instrument, instrument.confocal_centre[0]))
    pair = measure_pair(list(transmission(instrument, seed=80))[:4])
    true_rows = instrument.residual_centre[0] - instrument.confocal_centre[0]
    for seed in (90, 92, 94):
        found = measure_offset(list(standing_line(instrument, volts, seed=seed)), pair=pair)
        assert abs(found.rows - true_rows) < 0.02


@pytest.mark.parametrize("row_noise_dn", [0.5, 2.0])
def test_a_sweep_under_row_noise_is_mapped_as_without(row_noise_dn: float) -> None:
    """A dark row was the longest line, and the sweep refused."""
    instrument = noisy("240hz", row_noise_dn)
    centre, radius = instrument.confocal_centre[0], instrument.diameter_px / 2
    rows = np.linspace(centre - 1.1 * radius, centre + 1.1 * radius, VOLTAGES)
    volts = np.array([volts_of(instrument, row) for row in rows])
    found = map_galvo(list(standing_line(instrument, volts, seed=78)), volts)
    assert found.lines == (np.abs(rows - centre) < 0.6 * radius).sum()  # others are shorter than 0.8 diameters
    assert found.row(volts_of(instrument, centre)) == pytest.approx(centre, abs=0.02)
    assert found.volts_per_row == pytest.approx(instrument.volts_per_row, rel=3e-4)


def test_frames_without_row_noise_are_left_alone() -> None:
    frame = np.random.default_rng(3).normal(10, 1, (120, 300)).astype(np.float32)
    assert RowReference(np.ones(frame.shape, np.uint8)).without_row_noise(frame) is frame


def test_frames_without_dark_pixels_are_left_alone() -> None:
    frame = (10 + np.random.default_rng(4).normal(0, 3, (120, 1)) + np.zeros(300)).astype(np.float32)
    assert RowReference(np.zeros(frame.shape, np.uint8)).without_row_noise(frame) is frame


def test_the_light_of_the_bundle_is_kept() -> None:
    random = np.random.default_rng(5)
    row, col = np.ogrid[:200, :420]
    light = 50.0 * ((np.hypot(row - 100, col - 110) < 80) | (np.hypot(row - 100, col - 310) < 80))
    offsets = random.normal(0, 2, (200, 1))
    frame = (light + offsets + random.normal(4, 0.5, light.shape)).astype(np.float32)
    for dark in (dark_columns(frame), dark_pixels(frame.shape, [((100, 110), 160), ((100, 310), 160)])):
        assert not (dark * light).any()
        left = RowReference(dark).without_row_noise(frame) - light
        assert left.mean(axis=1).std() < 0.1


def test_a_streak_longer_than_the_bundle_is_no_line_of_a_sweep() -> None:
    rows = np.arange(120)[:, None] - np.array([60.0])
    streak = locate_line(np.broadcast_to(80 * np.exp(-(rows**2) / 18), (120, 400)))
    with pytest.raises(MeasurementError, match="a line is visible in 0 of 8 frames"):
        fit_galvo(np.linspace(0, 1, 8), [streak] * 8, max_chord_px=220.0)


def test_power_noise_of_the_laser_is_part_of_the_stated_offset() -> None:
    """Power that differs from row to row moves the line by more than the cores' residuals show."""
    known = Instrument.of("240hz")
    instrument = replace(known, imperfections=Imperfections(power_noise_percent=5.0))
    volts = np.full(5, volts_of(instrument, instrument.confocal_centre[0]))
    true_rows = instrument.residual_centre[0] - instrument.confocal_centre[0]
    found = [measure_offset(list(standing_line(instrument, volts, seed=seed))) for seed in range(84, 88)]
    assert all(abs(one.rows - true_rows) < 3 * one.uncertainty_rows for one in found)
    steady = measure_offset(list(standing_line(known, volts, seed=84)))
    assert min(one.uncertainty_rows for one in found) > 1.5 * steady.uncertainty_rows
    assert steady.unsteady_rows < steady.uncertainty_rows / 2
