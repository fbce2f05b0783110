"""Volts to rows, in the face of dark frames, outliers and a galvo that is not straight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.instrument.calibration import Calibration, FrameSection, OffsetSection
from napari_elsplus.processing.calibration.draft import Draft, Setup
from napari_elsplus.processing.calibration.galvo import GalvoMap, fit_galvo, visible_line
from napari_elsplus.processing.calibration.line.location import Line, locate_line
from napari_elsplus.processing.calibration.measurements import map_galvo
from napari_elsplus.processing.calibration.summaries import summarize_galvo
from napari_elsplus.simulation.calibration_scenes import standing_line
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument

ROWS = np.linspace(40, 260, 200)


def line(row: float, chord: float = 200.0, slope: float = 0.0) -> Line:
    half = chord / 2
    return Line(
        row=row,
        column=150.0,
        slope=slope,
        width_rows=2.0,
        amplitude=100.0,
        level=0.0,
        ramp=0.0,
        columns=(int(150 - half), int(150 + half)),
        profile=np.zeros(3),
        profile_rows=np.arange(3.0),
        influence=np.full((4, 2), 0.01),
    )


def fitted(rows: np.ndarray, volts: np.ndarray, column: float | None = None, slope: float = 0.0) -> GalvoMap:
    return fit_galvo(volts, [line(row, slope=slope) for row in rows], column)


@pytest.mark.parametrize("share", [0.05, 0.2, 0.28])
def test_a_galvo_that_stops_at_its_limit_leaves_the_map_true(share: float) -> None:
    """With 28 % of the voltages beyond the limit the slope was 4 % off."""
    noisy = ROWS + np.random.default_rng(0).normal(0, 0.02, ROWS.shape)
    stopped = np.minimum(noisy, np.quantile(ROWS, 1 - share))
    found = fitted(stopped, 1e-3 * ROWS)
    assert found.volts_per_row == pytest.approx(1e-3, rel=1e-3)
    assert found.volts_at_row_zero == pytest.approx(0, abs=1e-4)


@given(
    volts_per_row=st.floats(2e-4, 1e-2),
    falling=st.booleans(),
    at_zero=st.floats(-5, 5),
    backwards=st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_any_straight_map_is_recovered(volts_per_row: float, falling: bool, at_zero: float, backwards: bool) -> None:
    volts_per_row = -volts_per_row if falling else volts_per_row
    rows = ROWS[::-1] if backwards else ROWS
    found = fitted(rows, at_zero + volts_per_row * rows)
    assert found.volts_per_row == pytest.approx(volts_per_row, rel=1e-9)
    assert found.volts_at_row_zero == pytest.approx(at_zero, abs=1e-6 * abs(volts_per_row) + 1e-12)
    assert found.r_squared == pytest.approx(1)
    assert not found.curved


def test_stated_uncertainty_is_the_scatter_of_repeats() -> None:
    random = np.random.default_rng(0)
    repeats = [fitted(ROWS + random.normal(0, 0.05, ROWS.size), 0.001 * ROWS) for _ in range(200)]
    for name in ("volts_per_row", "volts_at_row_zero"):
        scatter = np.std([getattr(found, name) for found in repeats])
        stated = np.median([getattr(found, f"{name}_uncertainty") for found in repeats])
        assert stated == pytest.approx(scatter, rel=0.2)


def test_few_runs_that_agree_by_chance_are_not_overrated() -> None:
    """By runs of voltages alone 1.6 % of the errors of jittering lines were beyond three standard deviations."""
    random = np.random.default_rng(7)
    repeats = [fitted(ROWS + random.normal(0, 0.3, ROWS.size), 0.001 * ROWS) for _ in range(500)]
    errors = np.array([found.row(0.15) - 150 for found in repeats])
    stated = np.array([found.middle_uncertainty_rows for found in repeats])
    assert np.mean(np.abs(errors) < 3 * stated) >= 0.995
    assert 0.60 <= np.mean(np.abs(errors) < stated) <= 0.76


def test_the_middle_of_a_curved_galvo_is_as_uncertain_as_its_scatter() -> None:
    """A straight line through a cubic leaves rows over that repeat in every sweep: they are no scatter."""
    random = np.random.default_rng(5)
    u = np.linspace(-1, 1, ROWS.size)
    curved = ROWS + 2 * 1.5 * np.sqrt(3) * (u - u**3)
    repeats = [fitted(curved + random.normal(0, 0.1, ROWS.size), 0.001 * ROWS) for _ in range(100)]
    assert all(found.curved for found in repeats)
    scatter = np.std([found.row(0.001 * ROWS.mean()) for found in repeats])
    assert np.median([found.middle_uncertainty_rows for found in repeats]) == pytest.approx(scatter, rel=0.3)


def test_a_dozen_voltages_do_and_five_lines_that_agree_by_chance_are_not_overrated() -> None:
    """The influence of these lines is 0.02 rows; what five of them leave over is often much less."""
    random = np.random.default_rng(2)
    rows = np.linspace(80, 220, 5)
    for _ in range(50):
        found = fitted(rows + random.normal(0, 0.02, rows.size), 0.001 * rows)
        assert found.lines == 5
        assert abs(found.volts_per_row - 0.001) < 4 * found.volts_per_row_uncertainty
        assert abs(found.volts_at_row_zero) < 4 * found.volts_at_row_zero_uncertainty
    with pytest.raises(MeasurementError, match="4 of 4 frames, 5 are needed"):
        fitted(rows[:4], 0.001 * rows[:4])


def test_dark_frames_and_short_lines_are_left_out() -> None:
    volts = 0.001 * ROWS
    lines: list[Line | None] = [line(row) for row in ROWS]
    lines[:30] = [None] * 30
    lines[30:50] = [line(row + 3, chord=80) for row in ROWS[30:50]]
    found = fit_galvo(volts, lines)
    assert (found.lines, found.dark, found.outliers) == (150, 50, 0)
    assert found.volts_per_row == pytest.approx(0.001, rel=1e-9)


def test_a_galvo_that_follows_a_sweep_there_and_back_a_frame_late_is_warned_of() -> None:
    """The lines of the shorter way were left out without a word, the map one step of the sweep off."""
    wanted = np.r_[np.linspace(80, 220, 150), np.linspace(217, 83, 50)]
    found = fitted(np.r_[wanted[0], wanted[:-1]], 0.001 * wanted)
    summary = summarize_galvo(found, Draft(), Setup(FrameSection(shape=(320, 640))))
    assert any("51 of 200 lines lie beside" in warning for warning in summary.warnings)
    straight = summarize_galvo(fitted(wanted, 0.001 * wanted), Draft(), Setup(FrameSection(shape=(320, 640))))
    assert not any("lie beside" in warning for warning in straight.warnings)


def test_outliers_are_thrown_out_and_counted() -> None:
    random = np.random.default_rng(2)
    rows = ROWS + random.normal(0, 0.03, ROWS.size)
    wrong = random.choice(ROWS.size, 40, replace=False)
    rows[wrong] += random.choice([-1, 1], 40) * random.uniform(2, 80, 40)
    found = fitted(rows, 0.001 * ROWS)
    assert found.outliers == 40
    assert found.volts_per_row == pytest.approx(0.001, rel=2e-4)
    assert set(np.flatnonzero(~found.used)) == set(wrong)


@pytest.mark.parametrize("lost", [60, 100, 140])
@pytest.mark.parametrize("falling", [False, True])
def test_a_sweep_that_lost_a_frame_is_refused(lost: int, falling: bool) -> None:
    """The slope was off by up to 2 %, or the row by a whole step, with uncertainties of a tenth of that."""
    random = np.random.default_rng(lost)
    volts = (-1e-3 if falling else 1e-3) * ROWS
    rows = ROWS + random.normal(0, 0.05, len(ROWS))
    fitted(rows, volts)
    shifted = np.concatenate([rows[:lost], rows[lost + 1 :], rows[-1:]])
    with pytest.raises(MeasurementError, match=rf"jumps by 1.* rows at frame {lost} of the sweep: was a frame lost"):
        fitted(shifted, volts)
    curved = rows + 2e-6 * (ROWS - 150) ** 3 + 0.5 * np.sin(ROWS / 20)
    assert fitted(curved, volts).lines == len(ROWS)


@pytest.mark.parametrize("lost", [6, 12, 55])
def test_a_sweep_that_lost_a_frame_early_or_late_is_refused(lost: int) -> None:
    """The lines of its shorter part were left out: the map was a step off, by 18 to 95 standard deviations."""
    rows = np.linspace(80, 220, 70) + np.random.default_rng(lost).normal(0, 0.02, 70)
    shifted = np.concatenate([rows[:lost], rows[lost + 1 :], [rows[-1] + 2]])
    with pytest.raises(MeasurementError, match=rf"jumps by 2.* rows at frame {lost} of the sweep: was a frame lost"):
        fitted(shifted, 1e-3 * np.linspace(80, 220, 70))


def test_a_map_is_not_fitted_to_three_of_five_lines() -> None:
    """A repeated frame among eight voltages left three lines, through which a map was put 37 rows off."""
    rows = np.array([80.0, 115.0, 150.0, 185.0, 220.0])
    with pytest.raises(MeasurementError, match="in 3 of 5 frames"):
        fitted(rows + np.array([0, -35, 0, 0, -35]), 1e-3 * rows)


def test_a_galvo_whose_way_back_lies_beside_the_way_there_lost_no_frame() -> None:
    there_and_back = np.concatenate([ROWS[::2], ROWS[1::2][::-1]])
    beside = np.repeat([0.4, -0.4], len(ROWS) // 2) + np.random.default_rng(3).normal(0, 0.05, len(ROWS))
    found = fitted(there_and_back + beside, 1e-3 * there_and_back)
    assert found.row(0.15) == pytest.approx(150, abs=0.1)


def test_a_bent_galvo_is_detected_and_a_straight_one_is_not_accused() -> None:
    random = np.random.default_rng(3)
    along = np.linspace(-1, 1, ROWS.size)
    noise = random.normal(0, 0.05, ROWS.size)
    bent = fitted(ROWS + 0.6 * along**3 + noise, 0.001 * ROWS)
    assert bent.curved
    assert bent.curvature_rows == pytest.approx(0.24, abs=0.08)
    assert not fitted(ROWS + noise, 0.001 * ROWS).curved


def test_rows_are_taken_at_the_column_asked_for() -> None:
    found = fitted(ROWS, 0.001 * ROWS, column=250.0, slope=0.02)
    assert found.row(0.1) == pytest.approx(100 + 0.02 * 100)
    assert found.tilt_deg == pytest.approx(np.degrees(np.arctan(0.02)))


def test_the_parking_voltage_stands_the_line_outside() -> None:
    for volts_per_row, at_zero in ((0.001, -0.15), (-0.001, 0.4), (0.002, 1.0)):
        found = fitted(ROWS, at_zero + volts_per_row * ROWS)
        row = found.row(found.park_v(20.0, 280.0))
        assert row <= 20 + 1e-6 or row >= 280 - 1e-6


def test_what_is_no_sweep_is_refused() -> None:
    volts = 0.001 * ROWS
    lines: list[Line | None] = [line(row) for row in ROWS]
    random = np.random.default_rng(4)
    with pytest.raises(InputError, match="199 voltages for 200 frames"):
        fit_galvo(volts[1:], lines)
    with pytest.raises(InputError, match="voltage 7 is not finite"):
        fit_galvo(np.where(np.arange(200) == 7, np.nan, volts), lines)
    with pytest.raises(MeasurementError, match="visible in 0 of 200 frames"):
        fit_galvo(volts, [None] * 200)
    with pytest.raises(InputError, match=r"voltages of frames with a line span 0 V"):
        fit_galvo(np.full(200, 0.5), lines)
    with pytest.raises(InputError, match=r"voltage of the sweep is 1e\+30 V"):
        fit_galvo(np.where(np.arange(200) == 7, 1e30, volts), lines)
    with pytest.raises(InputError, match=r"voltage of the sweep is 260 V: give volts, at most 20"):
        fit_galvo(1e3 * volts, lines)
    with pytest.raises(InputError, match=r"span 2\.2e-301 V"):
        fit_galvo(1e-300 * volts, lines)
    with pytest.raises(MeasurementError, match=r"moves 0\.0 rows"):
        fit_galvo(volts, [line(100.0)] * 200)
    with pytest.raises(MeasurementError, match=r"off a line in .* of 200 frames: do the voltages belong"):
        fit_galvo(random.permutation(volts), lines)


def test_frames_of_few_voltages_are_no_sweep() -> None:
    """Three frames at each of two voltages passed for a sweep, through which a cubic bent by 75 rows was put."""
    rows = np.repeat(np.linspace(80, 220, 4), 3)
    with pytest.raises(MeasurementError, match="the 12 frames with a line have 4 different voltages, 5 are needed"):
        fitted(rows, 0.001 * rows)
    with pytest.raises(MeasurementError, match="the 6 frames with a line have 2 different voltages, 5 are needed"):
        fitted(np.repeat((100.0, 110.0), 3), np.repeat((0.1, 0.11), 3))


def test_repeated_frames_of_few_voltages_do_not_make_a_galvo_seem_curved() -> None:
    """What the cores move a line by is common to its frames: 60 of 100 straight galvos were reported as curved."""
    random, rows, curved = np.random.default_rng(6), np.linspace(80, 220, 5), 0
    for _ in range(100):
        shared = np.repeat(rows + random.normal(0, 0.2, 5), 8)
        curved += fitted(shared + random.normal(0, 0.02, 40), 0.001 * np.repeat(rows, 8)).curved
    assert curved < 20


@pytest.mark.parametrize("column", [90.0, 210.0])
def test_a_map_taken_at_another_column_is_the_map_fitted_there(column: float) -> None:
    volts = 0.002 * ROWS - 0.3
    here, there = (fitted(ROWS, volts, column=at, slope=0.01) for at in (150.0, column))
    moved = here.at_column(column)
    assert moved.row(0.1) == pytest.approx(there.row(0.1), abs=1e-9)
    assert moved.rows == pytest.approx(there.rows, abs=1e-9)
    assert abs(moved.row(0.1) - here.row(0.1)) == pytest.approx(0.6, abs=1e-6)


@pytest.mark.parametrize("bow_rows", [3.0, -3.0])
def test_a_bowed_line_is_measured_and_makes_no_galvo_seem_curved(bow_rows: float) -> None:
    """The intercept was 0.76 rows off, and the galvo reported as curved."""
    instrument = replace(Instrument.of("240hz"), imperfections=Imperfections(line_bow_rows=bow_rows))
    centre, radius = instrument.confocal_centre[0], instrument.diameter_px / 2
    rows = np.linspace(centre - 1.1 * radius, centre + 1.1 * radius, 40)
    volts = instrument.volts_at_row_zero + instrument.volts_per_row * rows
    found = map_galvo(list(standing_line(instrument, volts, seed=91)), volts)
    assert found.bow_rows == pytest.approx(bow_rows, abs=0.1)
    assert abs(found.bow_rows - bow_rows) < 3 * found.bow_uncertainty_rows
    assert found.row(instrument.volts_at_row_zero) == pytest.approx(0, abs=0.1)
    assert not found.curved
    summary = summarize_galvo(found, Draft(), Setup(FrameSection(shape=(524, 1328))))
    assert any("the line is bowed" in warning for warning in summary.warnings)


def test_light_that_falls_towards_the_rim_does_not_stretch_the_map() -> None:
    """The side of a line that lies farther inside is brighter: slopes were 0.02 to 0.04 % too small, 3 to 5 sigma."""
    rows, cols = np.mgrid[:320, :300] + 0.0
    lit = np.hypot(rows - 160, cols - 150) < 140
    light = lit * (1 - 0.4 * np.square((rows - 160) / 140))
    at = np.linspace(60, 260, 50)
    lines = [locate_line(100 * light * (np.exp(-0.5 * np.square((rows - row) / 5)) + 0.05)) for row in at]
    found = fit_galvo(1e-3 * at, lines, 150.0)
    assert found.volts_per_row == pytest.approx(1e-3, rel=1e-4)
    assert found.row(0.160) == pytest.approx(160, abs=0.01)


def test_rows_of_cores_of_different_light_do_not_draw_the_lines() -> None:
    """They stood 0.07 to 0.09 rows off, and the slope was off by 0.007 %."""
    scatter, steeper = [], []
    for seed in range(8):
        rows, at = np.arange(320.0)[:, None], np.linspace(60, 260, 250)
        cores = np.interp(rows, np.arange(0, 322, 4.0), np.random.default_rng(seed).normal(1, 0.06, 81))
        lines = [locate_line(cores * 100 * np.exp(-0.5 * np.square((rows - row) / 3)) + np.zeros(160)) for row in at]
        found = fit_galvo(1e-3 * at, lines, 80.0)
        scatter.append(found.rms_rows)
        steeper.append(found.volts_per_row / 1e-3 - 1)
    assert np.max(scatter) < 0.02
    assert np.sqrt(np.mean(np.square(steeper))) < 2e-5


def test_a_halo_that_the_rim_cuts_does_not_stretch_the_map() -> None:
    """Lines near the rim stood 0.02 rows farther out: the slope was 0.012 % too small."""
    rows, cols = np.mgrid[:320, :320] - 160.0
    lit, at = 100 * (np.hypot(rows, cols) < 150), np.linspace(-140, 140, 100)
    away = [rows - row for row in at]
    frames = [lit * (np.exp(-np.square(u) / 32) + 0.25 * np.exp(-np.square(u) / 800)) for u in away]
    found = fit_galvo(1e-3 * at, [visible_line(frame) for frame in frames], 160.0)
    assert found.volts_per_row == pytest.approx(1e-3, rel=5e-5)


@pytest.mark.parametrize(("offset_rows", "warned"), [(-4.0, True), (4.0, True), (-21.7, False), (-2.0, False)])
def test_a_bow_that_reaches_the_slit_of_the_residual_view_is_warned_of(offset_rows: float, warned: bool) -> None:
    """ELS+ correlated by 0.83 instead of 0.99; an offset below the slit has a warning of its own."""
    found = replace(fitted(ROWS, 1e-3 * ROWS), bow_rows=2.2)
    calibration = Calibration(offset=OffsetSection(rows=offset_rows, uncertainty_rows=0.01))
    summary = summarize_galvo(found, Draft(calibration), Setup(FrameSection(shape=(524, 1328))))
    assert any("the bow reaches the slit" in warning for warning in summary.warnings) == warned


def test_a_straight_line_has_no_bow() -> None:
    instrument = Instrument.of("240hz")
    centre = instrument.confocal_centre[0]
    volts = instrument.volts_at_row_zero + instrument.volts_per_row * np.linspace(centre - 200, centre + 200, 24)
    found = map_galvo(list(standing_line(instrument, volts, seed=92)), volts)
    assert found.bow_rows == 0
    assert 0 < found.bow_uncertainty_rows < 0.1


def test_bows_that_are_outliers_leave_a_short_sweep_its_map() -> None:
    bends = (9e-4, 1e-5, -1e-5, 2e-5, -9e-4, 0.0)
    rows, volts = np.linspace(100, 200, 6), 1e-3 * np.linspace(100, 200, 6)
    lines: list[Line | None] = [
        replace(line(row), bend=bend, mean_square_px=3300.0) for row, bend in zip(rows, bends, strict=True)
    ]
    found = fit_galvo(volts, lines, 150.0)
    assert found.volts_per_row == pytest.approx(1e-3, rel=1e-3)
    assert found.bow_rows == 0


def test_light_that_scatters_from_line_to_line_is_stated_as_such() -> None:
    """It counted as if twenty lines had it in common: uncertainties were 4.5 times the errors."""
    random, at, errors = np.random.default_rng(7), np.linspace(80, 220, 400), []
    for _ in range(200):
        light = 100 * np.exp(random.normal(0, 0.3, len(at)))
        rows = at + random.normal(0, 0.005, len(at))
        lines = [
            replace(line(row), amplitude=each, influence=np.full((4, 2), 1e-4))
            for row, each in zip(rows, light, strict=True)
        ]
        found = fit_galvo(1e-3 * at, lines)
        errors.append((found.volts_per_row - 1e-3) / found.volts_per_row_uncertainty)
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.2
