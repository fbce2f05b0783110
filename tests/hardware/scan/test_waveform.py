"""The ramp puts the line on the slit while anything is exposed, and flies back only while nothing is."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.hardware.scan.timing import ScanTiming, StrobePhase
from napari_elsplus.hardware.scan.waveform import (
    REARM_S,
    GalvoLimits,
    Waveform,
    els_waveform,
    elsa_waveform,
    exposed_rows,
    flyback_rows,
    ramp_waveform,
)
from napari_elsplus.hardware.virtual.galvo import STEP_S, GalvoModel
from napari_elsplus.hardware.virtual.timeline import Program, StrobeTrain, mean_volts

LINE_PERIOD_S = 1 / 130_750.6
GALVO = GalvoModel()
KNOWN = GalvoLimits(natural_hz=GALVO.natural_hz, damping=GALVO.damping)
HZ240 = ScanTiming(LINE_PERIOD_S, 544.794, 3)
HZ120 = ScanTiming(LINE_PERIOD_S, 1089.588, 3)


def line_error_rows(waveform: Waveform, timing: ScanTiming, rows: tuple[float, float], slope: float, frame: int = 6):
    """How far the mirror's line is from the slit, over the rows exposed in one frame of a running scan."""
    train = StrobeTrain(0.0, timing.frame_period_s)
    program = Program(-1.0, 0.0, waveform.volts, waveform.samples_per_ramp, waveform.sample_rate_hz, train)
    strobe = frame * timing.frame_period_s
    begins = strobe + STEP_S * np.arange(-1000, round(timing.frame_period_s / STEP_S))
    mirror = (GALVO.follow(mean_volts([program], begins, STEP_S)) + 0.459) / slope
    which = np.arange(np.ceil(rows[0]), np.floor(rows[1]) + 1)
    exposed = strobe + timing.row_zero_s + (which - timing.slit_rows / 2) * timing.line_period_s
    return np.interp(exposed, begins + STEP_S, mirror) - which


@pytest.mark.parametrize("offset", [-22.0, 22.0, 0.0])
@pytest.mark.parametrize("strobe", list(StrobePhase))
def test_at_240_hz_the_mirror_is_on_the_slit_from_the_first_exposed_row_to_the_last(
    offset, strobe, calibration
) -> None:
    timing = ScanTiming(LINE_PERIOD_S, 544.794, 3, strobe)
    known = calibration(offset, centre=262 - offset / 2, lag_s=GALVO.lag_s)
    waveform = els_waveform(known, timing, KNOWN)
    error = line_error_rows(waveform, timing, exposed_rows(known.bundle), 0.00175)
    assert np.abs(error).max() < 0.15


def test_with_time_to_spare_the_lag_alone_is_enough(calibration) -> None:
    known = calibration(-30, 645, 540, 0.00126, lag_s=GALVO.lag_s)
    waveform = els_waveform(known, HZ120, GalvoLimits())
    error = line_error_rows(waveform, HZ120, exposed_rows(known.bundle), 0.00126)
    assert np.abs(error).max() < 0.5
    assert np.abs(error[100:]).max() < 0.01


def test_without_the_lag_the_line_misses_the_slit_by_29_rows(calibration) -> None:
    known = calibration(-30, 645, 540, 0.00126, lag_s=0.0)
    waveform = els_waveform(known, HZ120, KNOWN)
    error = line_error_rows(waveform, HZ120, exposed_rows(known.bundle), 0.00126)
    assert np.median(error) == pytest.approx(-GALVO.lag_s / LINE_PERIOD_S, abs=0.05)
    assert round(np.median(error)) == -29


def test_elsas_second_ramp_is_the_first_one_shifted_by_the_offset(calibration) -> None:
    known = calibration(lag_s=GALVO.lag_s)
    waveform = elsa_waveform(known, HZ240, KNOWN)
    assert waveform.ramps == 2
    rows = exposed_rows(known.bundle, residual=False)
    confocal = line_error_rows(waveform, HZ240, rows, 0.00175, frame=6)
    residual = line_error_rows(waveform, HZ240, rows, 0.00175, frame=7)
    assert np.abs(confocal).max() < 0.15
    assert np.abs(residual - known.offset.rows).max() < 0.15


def test_one_row_more_of_exposure_moves_the_target_by_half_a_row() -> None:
    """With the strobe at the start of readout, so that only the slit's centre moves."""
    narrow, wide = (ScanTiming(LINE_PERIOD_S, 1089.588, n, StrobePhase.READOUT) for n in (3, 4))
    assert wide.slit_row(np.array([0.004]))[0] - narrow.slit_row(np.array([0.004]))[0] == pytest.approx(0.5)


@pytest.mark.parametrize("sign", [-1, 1])
def test_240_hz_with_an_offset_of_77_um_is_refused_and_says_which_offset_would_fit(sign, calibration) -> None:
    um_per_px = 3.2 / 2.4
    offset = sign * 77 / um_per_px
    with pytest.raises(InputError, match="neither image is exposed") as refused:
        els_waveform(calibration(offset, 620 / um_per_px, 262 - offset / 2, 0.00175), HZ240, GalvoLimits())
    assert "0.14 ms" in str(refused.value) or "0.15 ms" in str(refused.value)
    fits = int(re.search(r"at most (\d+) rows", str(refused.value))[1])
    assert 25 < fits < 50
    els_waveform(calibration(sign * fits, 465, 262 - sign * fits / 2, 0.00175), HZ240, GalvoLimits())
    with pytest.raises(InputError):
        els_waveform(calibration(sign * (fits + 1.5), 465, 262, 0.00175), HZ240, GalvoLimits())
    rate = int(re.search(r"fits (\d+) frames", str(refused.value))[1])
    slower = ScanTiming(LINE_PERIOD_S, 1 / (rate * LINE_PERIOD_S), 3)
    els_waveform(calibration(offset, 620 / um_per_px, 262 - offset / 2, 0.00175), slower, GalvoLimits())


def test_the_time_to_fly_back_is_what_physics_says(calibration) -> None:
    """rows_per_frame - (diameter + |offset| + slit): 3.1 ms at 120 Hz and 29 um, 0.43 ms at 240 Hz."""
    for line_periods_per_frame, um_per_px, free_ms in ((1089.588, 3.63 / 3.778, 3.1), (544.794, 3.2 / 2.4, 0.43)):
        span = 620 / um_per_px + 29 / um_per_px + 3
        assert (line_periods_per_frame - span) * LINE_PERIOD_S * 1e3 == pytest.approx(free_ms, abs=0.06)
        assert flyback_rows(calibration().galvo, span, GalvoLimits(), HZ240) < line_periods_per_frame - span


def test_slew_and_acceleration_of_every_accepted_scan_keep_the_limits(calibration) -> None:
    limits = GalvoLimits()
    volts = els_waveform(calibration(), HZ240, limits).volts
    rate = 250e3
    whole = np.tile(volts, 2)
    slew = np.abs(np.diff(whole))[:-40].max() * rate
    assert slew < limits.max_slew_v_per_s
    with pytest.raises(InputError, match="fly"):
        els_waveform(calibration(), HZ240, GalvoLimits(max_slew_v_per_s=slew * 0.9))


def test_a_voltage_outside_the_limits_is_refused_before_the_card_sees_it(calibration) -> None:
    with pytest.raises(InputError, match="V for the scan"):
        els_waveform(calibration(), HZ240, GalvoLimits(max_v=0.2))


@pytest.mark.parametrize("rate_hz", [240.0, 120.0, 60.0, 24.0, 10.0])
def test_slow_frames_fit_the_cards_memory_and_its_rearming(rate_hz, calibration) -> None:
    timing = ScanTiming(LINE_PERIOD_S, 1 / (rate_hz * LINE_PERIOD_S), 3)
    for build in (els_waveform, elsa_waveform):
        waveform = build(calibration(lag_s=GALVO.lag_s), timing, KNOWN)
        assert len(waveform.volts) <= KNOWN.card_samples
        assert waveform.samples_per_ramp / waveform.sample_rate_hz <= timing.frame_period_s - REARM_S + 1e-9
        error = line_error_rows(waveform, timing, (100, 400), 0.00175, frame=6)
        assert np.abs(error).max() < 0.15


def test_too_slow_for_the_cards_memory_is_refused(calibration) -> None:
    with pytest.raises(InputError, match="at least"):
        els_waveform(calibration(), ScanTiming(LINE_PERIOD_S, 1 / LINE_PERIOD_S, 3), KNOWN)


def test_an_unmeasured_galvo_is_named(calibration) -> None:
    with pytest.raises(CalibrationError, match="galvo"):
        els_waveform(calibration().model_copy(update={"galvo": None}), HZ240, KNOWN)


@settings(max_examples=60, deadline=None)
@given(
    offset=st.floats(-200, 200), diameter=st.floats(50, 900), centre=st.floats(0, 1048), lag_s=st.floats(-1e-3, 1e-3),
    slope=st.floats(-0.01, 0.01).filter(lambda a: abs(a) > 1e-5), line_periods_per_frame=st.floats(540, 20000),
    slit=st.integers(1, 40),
)  # fmt: skip
def test_whatever_is_asked_is_refused_or_safe(
    offset, diameter, centre, slope, lag_s, line_periods_per_frame, slit, calibration
) -> None:
    limits = GalvoLimits(natural_hz=1000)
    try:
        known = calibration(offset, diameter, centre, slope, lag_s)
        waveform = els_waveform(known, ScanTiming(LINE_PERIOD_S, line_periods_per_frame, slit), limits)
    except (InputError, CalibrationError):
        return
    assert np.isfinite(waveform.volts).all()
    assert limits.min_v <= waveform.volts.min()
    assert waveform.volts.max() <= limits.max_v
    assert len(waveform.volts) <= limits.card_samples


def test_a_ramp_over_the_left_image_alone_flies_back_through_the_residual_image(calibration) -> None:
    known = calibration(lag_s=GALVO.lag_s)
    left = exposed_rows(known.bundle, residual=False)
    waveform = ramp_waveform(known.galvo, left, HZ240, KNOWN)
    error = line_error_rows(waveform, HZ240, exposed_rows(known.bundle), 0.00175)
    assert np.abs(error[:12]).max() > 20  # the residual image stands 22 rows higher
    assert np.abs(error[30:]).max() < 0.2
