"""Parking on the virtual card through the real driver: each fault that was found, by the card's own clock."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from itertools import pairwise

import pytest

from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.daq.output import Output
from napari_elsplus.hardware.daq.scanner import COMPARE_EVERY_S, DaqScanner
from napari_elsplus.hardware.parking import LASER_OFF, RESET_INTERVAL_S, ParkStage
from napari_elsplus.hardware.scan.timing import ScanTiming
from napari_elsplus.hardware.scan.waveform import GalvoLimits, Waveform, els_waveform
from napari_elsplus.hardware.virtual.card.card import POWER_ON_V, VirtualCard
from napari_elsplus.hardware.virtual.timeline import StrobeTrain

PARK_V = -0.7
PERIOD_S = 1 / 240
TIMING = ScanTiming(1 / 130_750.6, 130_750.6 / 240, 3)
LASER = "port0/line0"
SOON_S = 1.5
"""Seconds; generous, for a busy computer: simulated time holds the limits (test_interlock, ../test_parking)."""


@pytest.fixture
def ramp(calibration) -> Waveform:
    return els_waveform(calibration(), TIMING, GalvoLimits())


def parked_s(card: VirtualCard) -> float:
    """When the output came to stand at the parking voltage, by the card's clock; it has to stand there."""
    since_s = None
    for program in card.programs():
        at_rest = not len(program.samples) and program.resting_v == PARK_V
        since_s = (program.since_s if since_s is None else since_s) if at_rest else None
    assert since_s is not None, "it is not parked"
    return since_s


def sweep(scanner: DaqScanner, bench, ramp, wait_for) -> StrobeTrain:
    scanner.scan(ramp)
    train = bench.strobe_now()
    wait_for(lambda: scanner.ramps_begun > 2)
    return train


def fault_of(scanner: DaqScanner) -> str:
    try:
        scanner.check()
    except DeviceError as fault:
        return str(fault)
    return ""


def test_a_card_that_refuses_while_it_is_closed_is_parked_as_soon_as_it_accepts(cards, ramp, wait_for) -> None:
    """Before: counted as parked, and the line stayed on the bundle."""
    bench = cards()
    scanner = DaqScanner(bench.settings, bench.limits)
    sweep(scanner, bench, ramp, wait_for)
    states = []
    scanner.on_park_state(lambda state: states.append((state, bench.card.last_volts)))
    bench.card.inject(refuse_s=0.3)
    accepts_s = bench.card.faults.refuse_until_s
    scanner.close()
    assert scanner.park_state.parked
    assert 0 <= parked_s(bench.card) - accepts_s < SOON_S
    assert states[-1][0].parked
    assert not [state for state, volts in states if state.parked and volts != PARK_V]
    assert any(state.message.startswith(LASER_OFF) for state, _ in states)


def test_a_card_that_refuses_longer_is_not_called_parked_and_nothing_hangs(cards, ramp, wait_for) -> None:
    bench = cards()
    scanner = DaqScanner(bench.settings, bench.limits)
    sweep(scanner, bench, ramp, wait_for)
    bench.card.inject(refuse_s=6.0)  # longer than the two refusals and the closing below may take
    begun_s = time.perf_counter()
    with pytest.raises(DeviceError, match=r"^NOT PARKED: switch the laser off"):
        scanner.park()
    with pytest.raises(DeviceError, match="NOT PARKED"):
        scanner.hold(0.1)
    assert time.perf_counter() - begun_s < 4
    scanner.close()
    assert scanner.park_state.stage is ParkStage.NOT_PARKED
    wait_for(lambda: scanner.park_state.parked, 20)  # it goes on by itself
    assert parked_s(bench.card) - bench.card.faults.refuse_until_s < SOON_S


@pytest.mark.parametrize("power_up", [True, False])
def test_an_error_of_clear_task_ends_with_a_reset(cards, ramp, wait_for, power_up) -> None:
    """Before: a raw error of nidaqmx, and the watching thread was dead."""
    bench = cards(laser_line=LASER)
    with DaqScanner(bench.settings, bench.limits) as scanner:
        sweep(scanner, bench, ramp, wait_for)
        bench.card.inject(clear_errors=2, reset_to_power_up=power_up, reset_s=0.03)
        begun_s = bench.card.clock.now_s()
        scanner.park()
        assert parked_s(bench.card) - begun_s < SOON_S
        state = scanner.park_state
        assert state.resets >= 1
        assert state.reset_s >= 0.03
        assert "power-up" in state.message
        volts = {program.resting_v for program in bench.card.programs() if program.since_s > begun_s}
        assert (POWER_ON_V in volts) == power_up
        scanner.hold(0.1)  # and it can go on
        scanner.check()


class UnprintableError(Exception):
    """A defect whose own text cannot be made."""

    def __str__(self) -> str:
        raise ValueError


@pytest.mark.parametrize("defect", [ZeroDivisionError, UnprintableError, SystemExit])
def test_the_watching_thread_survives_what_nobody_thought_of(cards, ramp, wait_for, monkeypatch, defect) -> None:
    """Before: all but errors that can be printed ended the thread, which neither parked nor tried to again."""

    def fail() -> None:
        raise defect

    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        sweep(scanner, bench, ramp, wait_for)
        monkeypatch.setattr(scanner._output, "samples_done", fail)
        begun_s = bench.card.clock.now_s()
        wait_for(lambda: defect.__name__ in fault_of(scanner))
        wait_for(lambda: scanner.park_state.parked)
        assert parked_s(bench.card) - begun_s < SOON_S
        monkeypatch.undo()
        scanner.hold(0.2)
        scanner.check()


def test_parking_that_a_defect_interrupts_is_tried_again(cards, ramp, wait_for, monkeypatch) -> None:
    """Before: the thread ended, while the message told that parking was retried."""
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        sweep(scanner, bench, ramp, wait_for)
        put, defects = scanner._output.put, [SystemExit(), SystemExit()]

        def put_later(volts: float) -> None:
            if defects:
                raise defects.pop()
            put(volts)

        monkeypatch.setattr(scanner._output, "put", put_later)
        scanner.park()
        parked_s(bench.card)
        assert "SystemExit" in fault_of(scanner)


def test_a_strobe_that_was_never_wired_parks_and_the_wire_is_named(cards, ramp, wait_for) -> None:
    """Before: the line stood on one row of the bundle until the hold limit of 20 s."""
    bench = cards()
    bench.card.inject(strobe_unwired=True)
    with DaqScanner(bench.settings, bench.limits) as scanner:
        begun_s = time.perf_counter()
        scanner.watch_frames(lambda: int((time.perf_counter() - begun_s) / PERIOD_S))
        scanner.scan(ramp)
        bench.strobe_now()
        wait_for(lambda: "no strobe reaches PFI0" in fault_of(scanner))
        wait_for(lambda: scanner.park_state.parked)
        assert parked_s(bench.card) - begun_s < SOON_S


def test_ramps_without_frames_park(cards, ramp, wait_for) -> None:
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.watch_frames(lambda: 7)
        sweep(scanner, bench, ramp, wait_for)
        wait_for(lambda: "no frame has come" in fault_of(scanner))
        wait_for(lambda: scanner.park_state.parked)


def test_an_output_that_does_not_follow_is_not_called_parked(cards) -> None:
    """The card accepts every write, but reads another voltage back."""
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.hold(0.3)
        bench.card.inject(stuck=True)
        with pytest.raises(DeviceError, match=r"at 0.3 V instead of -0.7 V|at 0 V instead"):
            scanner.park()
        assert not scanner.park_state.parked
        bench.card.inject(stuck=False)


def test_a_card_without_the_internal_channel_confirms_by_its_task(cards) -> None:
    bench = cards()
    bench.card.inject(reads_back=False)
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.hold(0.3)
        scanner.park()
        assert scanner.park_state.parked
        assert scanner.park_state.read_back_v is None
        assert bench.card.last_volts == PARK_V


def test_parking_goes_around_a_call_that_does_not_return(cards) -> None:
    """Another thread is stuck in the card, with every lock; parking resets the card, which aborts that call."""
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.hold(0.3)
        bench.card.inject(hangs=True)
        errors: list[DeviceError] = []

        def stuck() -> None:
            try:
                scanner.hold(0.2)
            except DeviceError as error:
                errors.append(error)

        thread = threading.Thread(target=stuck)
        thread.start()
        time.sleep(0.1)
        begun_s = bench.card.clock.now_s()
        scanner.park()
        assert bench.card.clock.now_s() - begun_s < 3
        assert scanner.park_state.parked
        assert bench.card.last_volts == PARK_V
        thread.join(5)
        assert len(errors) == 1


def test_parking_goes_around_an_attempt_that_does_not_return(cards) -> None:
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.hold(0.3)
        bench.card.inject(hangs=True)
        begun_s = bench.card.clock.now_s()
        scanner.park()
        assert scanner.park_state.parked
        assert parked_s(bench.card) - begun_s < 3


def test_a_card_that_hangs_while_it_is_watched_is_parked_by_itself(cards, ramp, wait_for) -> None:
    """Before: only a call of `check` found it, after 2.5 s."""
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        sweep(scanner, bench, ramp, wait_for)
        bench.card.inject(hangs=True)
        wait_for(lambda: scanner.park_state.parked)
        assert bench.card.last_volts == PARK_V
        assert "did not return" in fault_of(scanner)


@pytest.mark.parametrize("drive", ["hold", "scan"])
def test_a_command_to_a_card_that_hangs_fails_within_two_seconds(cards, ramp, wait_for, drive) -> None:
    """Before: it never returned."""
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        bench.card.inject(hangs=True)
        begun_s = time.perf_counter()
        with pytest.raises(DeviceError):
            scanner.hold(0.3) if drive == "hold" else scanner.scan(ramp)
        assert time.perf_counter() - begun_s < 2.0
        wait_for(lambda: scanner.park_state.parked)
        scanner.hold(0.2)  # and it can go on
        scanner.check()


def test_a_card_that_hangs_while_it_is_opened_is_refused_or_parked_within_two_seconds(cards) -> None:
    bench = cards()
    bench.card.inject(hangs=True)
    begun_s = time.perf_counter()
    with suppress(DeviceError):
        DaqScanner(bench.settings, bench.limits).close()
    assert time.perf_counter() - begun_s < 3.0
    assert bench.card.last_volts == PARK_V


@pytest.mark.parametrize("reads_back", [True, False])
def test_a_parked_galvo_that_is_reset_from_elsewhere_is_parked_again_and_that_is_a_fault(
    cards, wait_for, reads_back
) -> None:
    """Before: the line stood on the bundle at 0 V, reported parked."""
    bench = cards()
    bench.card.inject(reads_back=reads_back)
    with DaqScanner(bench.settings, bench.limits) as scanner:
        states = []
        scanner.on_park_state(lambda state: states.append(state.message))
        begun_s = bench.card.clock.now_s()
        bench.card.reset("Dev1")
        wait_for(lambda: bench.card.last_volts == PARK_V)
        assert parked_s(bench.card) - begun_s < SOON_S
        wait_for(lambda: scanner.park_state.parked)
        assert "moved from elsewhere" in fault_of(scanner)
        assert any(message.startswith(LASER_OFF) for message in states)


@pytest.mark.parametrize("reads_back", [True, False])
def test_a_held_galvo_that_is_reset_from_elsewhere_is_parked_and_that_is_a_fault(cards, wait_for, reads_back) -> None:
    """Before: held until the hold limit, 20 s, while the line stood elsewhere."""
    bench = cards()
    bench.card.inject(reads_back=reads_back)
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.hold(0.3)
        time.sleep(2 * COMPARE_EVERY_S)
        assert fault_of(scanner) == ""
        begun_s = bench.card.clock.now_s()
        bench.card.reset("Dev1")
        wait_for(lambda: scanner.park_state.parked)
        assert parked_s(bench.card) - begun_s < SOON_S
        assert "the held galvo was moved from elsewhere" in fault_of(scanner)


def test_a_parked_galvo_is_left_alone_while_another_program_uses_the_input_that_reads_it_back(cards) -> None:
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        other = bench.card.create_task("other")
        bench.card.add_channel(other, "input", "Dev1/_ao0_vs_aognd")
        bench.card.start_task(other)
        version = bench.card.version
        time.sleep(3 * COMPARE_EVERY_S)
        assert scanner.park_state.parked
        assert bench.card.version == version
        assert fault_of(scanner) == ""
        bench.card.clear_task(other)


def test_parking_from_any_thread_ends_a_slow_move_at_once(cards) -> None:
    bench = cards()
    with DaqScanner(bench.settings, GalvoLimits(max_slew_v_per_s=0.5)) as scanner:  # two seconds from park to 0.3 V
        errors: list[DeviceError] = []

        def move() -> None:
            try:
                scanner.hold(0.3)
            except DeviceError as error:
                errors.append(error)

        thread = threading.Thread(target=move)
        thread.start()
        time.sleep(0.3)
        begun_s = bench.card.clock.now_s()
        scanner.park()
        assert parked_s(bench.card) - begun_s < SOON_S
        thread.join(5)
        assert "being parked" in str(errors[0])


@pytest.mark.parametrize("on_high", [True, False])
def test_the_laser_is_on_only_while_the_galvo_is_driven(cards, ramp, wait_for, on_high) -> None:
    bench = cards(laser_line=LASER, laser_on_high=on_high)

    def laser() -> bool:
        return bench.card.laser_on is on_high

    with DaqScanner(bench.settings, bench.limits) as scanner:
        assert not laser()
        scanner.hold(0.2)
        assert laser()
        scanner.park()
        assert not laser()
        train = sweep(scanner, bench, ramp, wait_for)
        assert laser()
        bench.card.strobe(StrobeTrain(train.start_s, PERIOD_S, time.perf_counter()))
        wait_for(lambda: not laser())
        wait_for(lambda: scanner.park_state.parked)
    assert not laser()


def test_a_parking_voltage_on_the_bundle_is_refused_before_anything_moves(cards, ramp) -> None:
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        scanner.park_at(0.2)  # nobody knows yet where the bundle is
        before = bench.card.version
        with pytest.raises(InputError, match=r"parking voltage 0\.2 V is on the bundle"):
            scanner.scan(ramp)
        assert bench.card.version == before


def test_a_parking_voltage_on_the_bundle_is_refused_while_it_is_scanned(cards, ramp, wait_for) -> None:
    """Before: accepted after `scan`, which refuses it, so that the next fault would have parked on the bundle."""
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        sweep(scanner, bench, ramp, wait_for)
        before = scanner.park_v
        with pytest.raises(InputError, match=r"parking voltage 0\.2 V is on the bundle"):
            scanner.park_at(0.2)
        assert scanner.park_v == before


def test_every_error_of_the_driver_is_ours(cards, ramp, wait_for) -> None:
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        for clear_errors in (1, 3):
            sweep(scanner, bench, ramp, wait_for)
            bench.card.inject(clear_errors=clear_errors)
            try:
                scanner.scan(ramp)
            except DeviceError:
                wait_for(lambda: scanner.park_state.parked)


def test_a_park_that_the_cards_thread_completes_at_once_is_not_called_not_parked(cards, ramp, wait_for) -> None:
    """Before: the state went back to parking after the confirmation, with no attempt to follow: a false alarm."""
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        sweep(scanner, bench, ramp, wait_for)

        class TakenUpAtOnce(threading.Event):
            """Set as seen by a commanding thread that then stands still until the attempt is over."""

            def set(self) -> None:
                super().set()
                if threading.current_thread() is threading.main_thread():
                    scanner._card.wake()
                    wait_for(lambda: not self.is_set() and scanner.park_state.parked)

        scanner._parks = TakenUpAtOnce()
        scanner.park()
        assert scanner.park_state.parked


def test_a_card_that_fails_once_while_it_is_opened_is_parked(cards) -> None:
    """Before: refused, and the line stayed where a program that had crashed had left it."""
    bench = cards()
    bench.card.break_with(-200621)
    with DaqScanner(bench.settings, bench.limits) as scanner:
        assert scanner.park_state.parked
        assert bench.card.last_volts == PARK_V


def test_a_card_that_another_program_drives_is_left_to_it_and_that_the_galvo_is_not_parked_is_said(cards) -> None:
    """Before: only that the card is in use."""
    bench = cards()
    bench.card.break_with(-50103)
    with pytest.raises(DeviceError, match=r"in use by another program.*the galvo was not parked"):
        DaqScanner(bench.settings, bench.limits)


def test_while_a_call_does_not_return_resets_stay_apart_although_parking_fails(cards, monkeypatch) -> None:
    """Before: forty a second, each of which may put the line on the bundle."""
    bench = cards()
    with DaqScanner(bench.settings, bench.limits) as scanner:
        returns, resets = threading.Event(), []
        reset, confirm = Output.reset, Output.confirm

        def counted(output: Output) -> None:
            resets.append(time.perf_counter())
            reset(output)

        def unconfirmed(output: Output, volts: float) -> float | None:
            if output is not scanner._output and len(resets) < 4:
                raise DeviceError("the output is elsewhere", "check the wire")
            return confirm(output, volts)

        monkeypatch.setattr(Output, "reset", counted)
        monkeypatch.setattr(Output, "confirm", unconfirmed)

        def stuck() -> None:
            with suppress(DeviceError), scanner._output.calls():
                returns.wait(20)

        thread = threading.Thread(target=lambda: scanner._card.execute(stuck))
        thread.start()
        until = time.perf_counter() + 20
        while len(resets) < 4 and time.perf_counter() < until:
            time.sleep(0.02)
        returns.set()
        thread.join(20)
        gaps_s = [later - earlier for earlier, later in pairwise(resets)]
        assert min(gaps_s) > 0.9 * RESET_INTERVAL_S
