"""The parking position: 100 um off the lit bundle, off the rows swept while they are exposed, within the limits."""

from __future__ import annotations

import re

import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.scan.clearance import check_parking
from napari_elsplus.hardware.scan.timing import ScanTiming
from napari_elsplus.hardware.scan.waveform import GalvoLimits, els_waveform, exposed_rows
from napari_elsplus.hardware.virtual.bench import OpticalBench, Simulation
from napari_elsplus.hardware.virtual.card.card import VirtualCard
from napari_elsplus.hardware.virtual.simulated_rig import parking_voltage
from napari_elsplus.hardware.virtual.timeline import BenchClock
from napari_elsplus.instrument.calibration import Calibration, OpticsSection
from napari_elsplus.instrument.optics import HALO_UM, PRESETS
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.truth import true_calibration

LIMITS = GalvoLimits()
INSTRUMENTS = [Instrument.of(name, offset_um=offset_um) for name in PRESETS for offset_um in (-29, 0, 29)]


def volts_at(calibration: Calibration, um: float) -> float:
    """Voltage at which the line is so far above the rim of the lit bundle."""
    galvo, bundle = calibration.galvo, calibration.bundle
    row = bundle.confocal_centre[0] - bundle.diameter_px / 2 - um / calibration.optics.um_per_px
    return galvo.volts_at_row_zero + galvo.volts_per_row * row


@pytest.mark.parametrize("instrument", INSTRUMENTS, ids=lambda one: f"{one.preset.name} {one.offset_um:.0f} um")
def test_every_preset_of_the_simulated_rig_parks_clear_of_bundle_and_scan(instrument: Instrument) -> None:
    calibration = true_calibration(instrument)
    check_parking(calibration.galvo.park_v, calibration, LIMITS)
    timing = ScanTiming(instrument.optics.line_period_s, instrument.optics.line_periods_per_frame, 3)
    low, high = els_waveform(calibration, timing, LIMITS).exposed_v
    assert not low <= calibration.galvo.park_v <= high
    clock = BenchClock()
    optics = OpticalBench(Simulation(offset_um=instrument.offset_um), VirtualCard(clock), clock)
    check_parking(parking_voltage(optics), calibration, LIMITS)


@pytest.mark.parametrize("um", [99.0, 50.0, 1.0, -1.0, -300.0])
def test_a_parking_voltage_on_the_bundle_or_within_its_halo_is_refused_and_one_that_would_do_is_named(um) -> None:
    """Before: 1 um off the bundle was enough."""
    calibration = true_calibration(INSTRUMENTS[0])
    with pytest.raises(InputError) as refused:
        check_parking(volts_at(calibration, um), calibration, LIMITS)
    named = re.search(r"park_v = (-?[\d.]+)", str(refused.value))
    assert named is not None
    check_parking(float(named[1]), calibration, LIMITS)
    assert "\n" not in str(refused.value)


def test_a_halo_s_width_is_enough_on_either_side() -> None:
    calibration = true_calibration(INSTRUMENTS[0])
    check_parking(volts_at(calibration, HALO_UM + 0.01), calibration, LIMITS)
    diameter_um = calibration.bundle.diameter_px * calibration.optics.um_per_px
    check_parking(volts_at(calibration, -diameter_um - HALO_UM - 0.01), calibration, LIMITS)


def test_without_a_scale_the_exposed_rows_alone_are_refused() -> None:
    calibration = true_calibration(INSTRUMENTS[0]).model_copy(update={"optics": OpticsSection()})
    galvo = calibration.galvo
    first, _ = exposed_rows(calibration.bundle)
    check_parking(galvo.volts_at_row_zero + galvo.volts_per_row * (first - 1), calibration, LIMITS)
    with pytest.raises(InputError, match="park_v = "):
        check_parking(galvo.volts_at_row_zero + galvo.volts_per_row * (first + 1), calibration, LIMITS)


def test_limits_that_leave_no_place_to_park_are_named() -> None:
    calibration = true_calibration(INSTRUMENTS[0])
    with pytest.raises(InputError, match=r"no voltage within -0.1 to 0.1 V"):
        check_parking(0.0, calibration, GalvoLimits(min_v=-0.1, max_v=0.1))


@pytest.mark.parametrize("section", ["galvo", "bundle"])
def test_what_is_not_calibrated_is_not_checked(section) -> None:
    check_parking(0.0, true_calibration(INSTRUMENTS[0]).model_copy(update={section: None}), LIMITS)
    check_parking(0.0, None, LIMITS)
