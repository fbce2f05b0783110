"""The real driver on the virtual card: hold, sweep, scan, ELSA, park, and every way in which a card fails.

What counts is the voltage that the card last put out.
"""

from __future__ import annotations

import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest

from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.daq.output import CardSettings
from napari_elsplus.hardware.daq.scanner import DaqScanner
from napari_elsplus.hardware.protocols import Scanner
from napari_elsplus.hardware.scan.timing import ScanTiming
from napari_elsplus.hardware.scan.waveform import GalvoLimits, Waveform, els_waveform, elsa_waveform
from napari_elsplus.hardware.virtual.timeline import StrobeTrain, volts_at

PERIOD_S = 1 / 240
TIMING = ScanTiming(1 / 130_750.6, 130_750.6 / 240, 3)
PARK_V = -0.7


@pytest.fixture
def ramp(calibration) -> Waveform:
    return els_waveform(calibration(), TIMING, GalvoLimits())


def parked(bench) -> bool:
    return bench.card.last_volts == PARK_V


def test_the_whole_sequence(cards, calibration, ramp, wait_for) -> None:
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        assert isinstance(scanner, Scanner)
        assert parked(bench)
        scanner.hold(0.25)
        assert bench.card.last_volts == 0.25
        for volts in np.linspace(-0.3, 0.6, 7):  # a sweep is a hold at each voltage
            scanner.hold(float(volts))
            assert bench.card.last_volts == pytest.approx(volts)
        scanner.scan(ramp)
        train = bench.strobe_now()
        wait_for(lambda: scanner.ramps_begun > 4)
        times = train.start_s + 3 * PERIOD_S + (np.arange(ramp.samples_per_ramp) + 0.5) / ramp.sample_rate_hz
        np.testing.assert_allclose(volts_at(bench.card.programs(), times), ramp.volts)
        both = elsa_waveform(calibration(), TIMING, bench.limits)
        bench.card.strobe(None)
        scanner.scan(both)
        train = bench.strobe_now()
        wait_for(lambda: scanner.ramps_begun > 4)
        for frame in range(4):  # confocal, residual, confocal, residual
            sample = 500
            at = train.start_s + frame * PERIOD_S + np.array([(sample + 0.5) / both.sample_rate_hz])
            wanted = both.volts.reshape(2, -1)[frame % 2][sample]
            assert volts_at(bench.card.programs(), at)[0] == pytest.approx(wanted)
        scanner.check()
        scanner.park()
        assert parked(bench)
        scanner.hold(0.1)
    assert parked(bench)


def test_a_galvo_that_was_closed_parked_stays_so_whoever_parks_it_again(cards) -> None:
    """Before: 1.5 s later it was stated not to be parked, though nothing drives it any more."""
    bench = cards()
    scanner = DaqScanner(bench.settings, bench.limits)
    scanner.close()
    scanner.park()
    with pytest.raises(DeviceError, match="was closed"):
        scanner.park_at(PARK_V - 0.1)
    assert scanner.park_state.parked
    assert scanner.park_v == PARK_V
    assert parked(bench)


def test_another_place_to_park_is_taken_at_once_by_a_parked_mirror_and_later_by_one_that_scans(
    cards, ramp, wait_for
) -> None:
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.park_at(-0.9)
        assert bench.card.last_volts == -0.9
        with pytest.raises(InputError, match="parking position"):
            scanner.park_at(-3.0)
        assert scanner.park_v == -0.9
        scanner.scan(ramp)
        bench.strobe_now()
        wait_for(lambda: scanner.ramps_begun > 2)
        scanner.park_at(-0.8)
        wait_for(lambda: scanner.ramps_begun > 4)
        scanner.park()
        assert bench.card.last_volts == -0.8
    assert bench.card.last_volts == -0.8


def test_the_waveform_is_repeated_as_often_as_the_strobe_comes_and_no_more(cards, ramp, wait_for) -> None:
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.scan(ramp)
        train = bench.strobe_now()
        wait_for(lambda: time.perf_counter() > train.start_s + 20.5 * PERIOD_S)
        came_before = (time.perf_counter() - train.start_s) / PERIOD_S
        begun = scanner.ramps_begun
        came_after = (time.perf_counter() - train.start_s) / PERIOD_S
        assert came_before - 3 < begun < came_after + 3


def test_a_scan_does_not_depend_on_a_computer_that_refills_buffers(cards, ramp, wait_for) -> None:
    bench = cards()
    bench.card.inject(host_stalls=True)
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.scan(ramp)
        bench.strobe_now()
        wait_for(lambda: scanner.ramps_begun > 4)
        scanner.check()


def test_a_missed_strobe_shows_in_the_count_of_ramps(cards, ramp, wait_for) -> None:
    """The same ramps, one of them late: the count is tied to what the card did, not to what it should have done."""
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.scan(ramp)
        begin = time.perf_counter() + 1e-3
        bench.card.strobe(StrobeTrain(begin, PERIOD_S, begin + 9.5 * PERIOD_S, frozenset({4})))
        wait_for(lambda: time.perf_counter() > begin + 11 * PERIOD_S)
        assert scanner.ramps_begun == 9


def test_a_lost_strobe_stops_the_scan_and_parks(cards, ramp, wait_for) -> None:
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.scan(ramp)
        train = bench.strobe_now()
        wait_for(lambda: scanner.ramps_begun > 3)
        bench.card.strobe(StrobeTrain(train.start_s, PERIOD_S, time.perf_counter()))
        assert wait_for(lambda: parked(bench)) < 0.5
        wait_for(lambda: _fault(scanner) is not None)
        assert "no strobe" in str(_fault(scanner))
        assert "PFI0" in str(_fault(scanner))
        scanner.hold(0.2)  # and it can go on
        scanner.check()


@pytest.mark.parametrize("code", [-200621, -200290])
def test_an_underrun_parks_and_says_so(cards, ramp, wait_for, code) -> None:
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.scan(ramp)
        bench.strobe_now()
        wait_for(lambda: scanner.ramps_begun > 3)
        bench.card.break_with(code)
        assert wait_for(lambda: parked(bench)) < 0.5
        wait_for(lambda: _fault(scanner) is not None)
        assert f"({code})" in str(_fault(scanner))
        assert "ran out of samples" in str(_fault(scanner))


def test_a_card_that_is_gone_is_told_and_let_go_without_hanging(cards, ramp, wait_for) -> None:
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.scan(ramp)
        bench.strobe_now()
        wait_for(lambda: scanner.ramps_begun > 3)
        bench.card.break_with(-201003)
        wait_for(lambda: _fault(scanner) is not None)
        assert "does not answer" in str(_fault(scanner))
        with pytest.raises(DeviceError, match="plug it in"):
            scanner.park()


def test_a_card_in_use_an_unknown_card_and_a_wrong_channel_have_their_own_messages(cards) -> None:
    bench = cards()
    bench.card.break_with(-50103)
    with pytest.raises(DeviceError, match="in use by another program"):
        DaqScanner(bench.settings, bench.limits)
    bench.card.break_with(0)
    with pytest.raises(DeviceError, match="no such card"):
        DaqScanner(cards(device="Dev9").settings, bench.limits)
    with pytest.raises(DeviceError, match="no such channel"):
        DaqScanner(cards(output="ao7").settings, bench.limits)


def test_without_nis_driver_that_is_said() -> None:
    with pytest.raises(DeviceError, match="NI's driver is not installed"):
        DaqScanner(CardSettings(PARK_V), GalvoLimits())


def test_out_of_range_is_refused_before_the_card_sees_it(cards, ramp) -> None:
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        before = bench.card.version
        for volts in (2.01, -2.5, float("nan"), float("inf")):
            with pytest.raises(InputError, match="V for the galvo"):
                scanner.hold(volts)
        wild = Waveform(ramp.volts * 20, 1, ramp.sample_rate_hz, PERIOD_S)
        with pytest.raises(InputError, match="limits"):
            scanner.scan(wild)
        assert bench.card.version == before
    with pytest.raises(InputError, match="parking position"):
        DaqScanner(cards(device="Dev1").settings, GalvoLimits(min_v=-0.5))


def test_the_card_too_is_told_the_limits(cards) -> None:
    """If our own check were missing, the channel's range would still refuse."""
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        with pytest.raises(DeviceError, match="-200561"):
            scanner._output.put(2.5)
        assert parked(bench)


def test_a_hold_that_goes_on_too_long_parks(cards, wait_for) -> None:
    bench = cards(hold_limit_s=0.1)
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.hold(0.3)
        took = wait_for(lambda: parked(bench))
        assert took > 0.05
        wait_for(lambda: _fault(scanner) is not None)
        assert "hold_limit_s" in str(_fault(scanner))


def test_a_scan_whose_strobe_never_comes_counts_as_a_hold(cards, ramp, wait_for) -> None:
    bench = cards(hold_limit_s=0.1)
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.scan(ramp)
        wait_for(lambda: parked(bench))


def test_a_hold_keeps_the_slew_limit(cards) -> None:
    bench = cards()
    limits = GalvoLimits(max_slew_v_per_s=200.0)
    with DaqScanner(bench.settings, limits) as scanner:
        scanner.hold(0.3)
        steps = np.diff([program.resting_v for program in bench.card.programs()][1:])
    assert np.abs(steps[:5]).max() <= 0.2 + 1e-9


def test_an_exception_in_the_caller_parks(cards, ramp, wait_for) -> None:
    bench = cards()
    scanner = DaqScanner(bench.settings, bench.limits)

    def caller() -> None:
        with scanner:
            scanner.scan(ramp)
            bench.strobe_now()
            wait_for(lambda: scanner.ramps_begun > 2)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        caller()
    assert parked(bench)
    with pytest.raises(DeviceError, match="closed"):
        scanner.hold(0.1)


def test_a_program_that_ends_without_closing_parks_at_exit() -> None:
    code = """
        from napari_elsplus.hardware.daq.output import CardSettings
        from napari_elsplus.hardware.daq.scanner import DaqScanner
        from napari_elsplus.hardware.virtual.card.card import VirtualCard
        from napari_elsplus.hardware.virtual.card.grpc_server import CardServer
        from napari_elsplus.hardware.scan.waveform import GalvoLimits
        import atexit
        card = VirtualCard()
        atexit.register(lambda: print(card.last_volts))
        server = CardServer(card)
        scanner = DaqScanner(CardSettings(-0.7, address=server.address), GalvoLimits())
        scanner.hold(0.3)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.split() == ["-0.7"]


def _fault(scanner: DaqScanner) -> DeviceError | None:
    try:
        scanner.check()
    except DeviceError as fault:
        return fault
    return None
