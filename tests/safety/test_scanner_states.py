"""Commands, faults and recoveries in any order, on simulated time: a galvo is never reported parked that is not.

The scanner, the interlocks and the guardian's takeover are the real ones, above nidaqmx's production interpreter; the
card is the virtual one. Threads and clocks are simulated, so that nothing sleeps.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from nidaqmx import Task

from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware import parking as parking_module
from napari_elsplus.hardware import takeover as takeover_module
from napari_elsplus.hardware.daq import calls as calls_module
from napari_elsplus.hardware.daq import scanner as scanner_module
from napari_elsplus.hardware.daq.calls import STUCK_S
from napari_elsplus.hardware.daq.output import CardSettings
from napari_elsplus.hardware.daq.scanner import DaqScanner
from napari_elsplus.hardware.parking import Parking
from napari_elsplus.hardware.scan.timing import ScanTiming
from napari_elsplus.hardware.scan.waveform import GalvoLimits, els_waveform
from napari_elsplus.hardware.takeover import ParkOrder
from napari_elsplus.hardware.virtual.card import card as card_module
from napari_elsplus.hardware.virtual.card.card import CardError, VirtualCard
from napari_elsplus.hardware.virtual.timeline import StrobeTrain
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.truth import park_volts, true_calibration
from ni_library import replacing_ni_library
from simulated_time import SimulatedBenchClock, SimulatedTime

INSTRUMENT = Instrument.of("240hz", offset_um=-29)
PARK_V = park_volts(INSTRUMENT)
PERIOD_S = INSTRUMENT.optics.frame_period_s
TIMING = ScanTiming(INSTRUMENT.optics.line_period_s, INSTRUMENT.optics.line_periods_per_frame, 3)
RAMP = els_waveform(true_calibration(INSTRUMENT), TIMING, GalvoLimits())
CENTRE_V = INSTRUMENT.volts_at_row_zero + INSTRUMENT.volts_per_row * INSTRUMENT.confocal_centre[0]
ON_BUNDLE_V = st.sampled_from([CENTRE_V - 0.2, CENTRE_V, CENTRE_V + 0.2])
TIMES_S = st.one_of(st.floats(0.001, 0.7), st.sampled_from([0.02, 0.28125, 0.3, 0.5]))
CALL_S = 2.0
"""Longest simulated time that a call may take."""
NOTICED_S = 0.25
"""Time in which a reset by another program has to be noticed; half of that in which it is parked again."""
PARKED_S = 0.5
"""Time in which a card that accepts has to be parked."""


@pytest.fixture(autouse=True)
def _tasks_of_killed_processes() -> Iterator[None]:
    """Tasks of a process that was killed are not closed, and nidaqmx warns of that."""
    with patch.object(Task, "__del__", lambda _: None):
        yield
        gc.collect()


class Scanning(RuleBasedStateMachine):
    """A scanner, its card, its strobe and its guardian."""

    def __init__(self) -> None:
        super().__init__()
        self.world = SimulatedTime()
        self.held = ExitStack()
        stand_in: Any = self.world
        for module in (scanner_module, calls_module, parking_module, takeover_module, card_module):
            for name in ("threading", "time"):
                if hasattr(module, name):
                    self.held.enter_context(patch.object(module, name, stand_in))
        parking = partial(Parking, now_s=self.world.perf_counter)
        self.held.enter_context(patch.object(scanner_module, "Parking", parking))
        quiet = SimpleNamespace(register=lambda _: None, unregister=lambda _: None)
        self.held.enter_context(patch.object(scanner_module, "atexit", quiet))
        self.card = VirtualCard(SimulatedBenchClock(self.world))
        self.held.enter_context(replacing_ni_library(self.card))
        self.wired = False
        self.frames = 0.0
        self.open()

    def open(self) -> None:
        """Open a scanner on a card that accepts."""
        self.scanner = DaqScanner(CardSettings(PARK_V), GalvoLimits(), self.world.perf_counter)
        self.closed = False
        self.scanner.watch_frames(lambda: int(self.world.now_s / PERIOD_S) if self.camera_runs else 0)
        self.camera_runs = False

    # commands

    def call(self, command: Any, *arguments: Any) -> None:
        """Call the scanner; it may refuse, and returns in time."""
        begun_s = self.world.now_s
        try:
            command(*arguments)
        except DeviceError:
            pass
        finally:
            assert self.world.now_s - begun_s <= CALL_S, f"{command.__name__} took {self.world.now_s - begun_s} s"
        self.never_falsely_parked()

    @precondition(lambda self: not self.closed)
    @rule(volts=ON_BUNDLE_V)
    def hold(self, volts: float) -> None:
        self.call(self.scanner.hold, volts)

    @precondition(lambda self: not self.closed)
    @rule()
    def scan(self) -> None:
        self.camera_runs = True
        self.card.strobe(StrobeTrain(self.world.now_s + 0.01, PERIOD_S))
        self.call(self.scanner.scan, RAMP)

    @precondition(lambda self: not self.closed)
    @rule()
    def park(self) -> None:
        self.call(self.scanner.park)

    @precondition(lambda self: not self.closed)
    @rule(volts=st.sampled_from([PARK_V, PARK_V - 0.2]))
    def park_at(self, volts: float) -> None:
        self.call(self.scanner.park_at, volts)

    @precondition(lambda self: not self.closed)
    @rule()
    def check(self) -> None:
        self.call(self.scanner.check)

    @precondition(lambda self: not self.closed)
    @rule()
    def close(self) -> None:
        self.call(self.scanner.close)
        self.closed = True

    @rule(seconds=TIMES_S)
    def wait(self, seconds: float) -> None:
        self.world.sleep(seconds)

    # faults, and their ends

    @rule(seconds=TIMES_S)
    def refuse(self, seconds: float) -> None:
        self.card.inject(refuse_s=seconds)

    @rule(fails=st.integers(1, 4))
    def fail_to_clear(self, fails: int) -> None:
        self.card.inject(clear_errors=fails)

    @rule()
    def underrun(self) -> None:
        self.card.break_with(-200621)

    @rule()
    def lend_to_another_program(self) -> None:
        self.card.break_with(-50103)

    @rule()
    def stick(self) -> None:
        self.card.inject(stuck=True)

    @rule(power_up=st.booleans(), seconds=st.sampled_from([0.0, 0.05]))
    def change_reset(self, power_up: bool, seconds: float) -> None:
        self.card.inject(reset_to_power_up=power_up, reset_s=seconds)

    @rule()
    def hang(self) -> None:
        self.card.inject(hangs=True)

    @precondition(lambda self: not self.closed)
    @rule()
    def reset_from_elsewhere(self) -> None:
        """Another program resets the card, which may put it on the bundle: noticed in time."""
        try:
            self.card.reset(self.card.device)
        except CardError:
            return
        self.world.sleep(NOTICED_S)

    @rule()
    def lose_strobe(self) -> None:
        self.card.strobe(None)

    @rule()
    def heal(self) -> None:
        self.card.break_with(0)
        self.card.inject(refuse_until_s=0.0, clear_errors=0, stuck=False, hangs=False)
        with self.card._lock:
            self.card._resets.notify_all()

    @precondition(lambda self: not self.closed)
    @rule(hangs=st.booleans())
    def die(self, hangs: bool) -> None:
        """The process is killed; its guardian parks, around a call that does not return, and another is started."""
        order = ParkOrder(replace(self.scanner.card, park_v=self.scanner.park_v), self.scanner.limits)
        self.world.kill(*(w for w in self.world.workers if w is not self.world.main))
        self.heal()
        self.card.inject(hangs=hangs)
        begun_s = self.world.now_s
        state = order.take_over()
        assert state.parked
        assert self.world.now_s - begun_s <= PARKED_S + hangs * STUCK_S
        assert self.output_is_parked(order.card.park_v)
        self.open()

    # what holds

    def output_is_parked(self, volts: float) -> bool:
        """True if the card stands at a voltage, and no waveform of it waits for a strobe."""
        return abs(self.card.last_volts - volts) < 1e-6 and not len(self.card.programs()[-1].samples)

    @invariant()
    def never_falsely_parked(self) -> None:
        if self.scanner.park_state.parked:
            assert self.output_is_parked(self.scanner.park_v), f"reported parked at {self.card.last_volts} V"
        assert not self.world.errors, self.world.errors

    def teardown(self) -> None:
        """Once all faults end, it is parked in time; nothing is left."""
        try:
            self.heal()
            self.call(self.scanner.close)
            self.world.sleep(PARKED_S)
            assert self.scanner.park_state.parked, self.scanner.park_state
            self.never_falsely_parked()
            self.world.sleep(CALL_S)
            assert self.world.workers == [self.world.main], "a thread was left"
        finally:
            self.world.kill(*(w for w in self.world.workers if w is not self.world.main))
            self.held.close()


COMMON: dict[str, Any] = {"stateful_step_count": 15, "deadline": None, "suppress_health_check": list(HealthCheck)}
TestScanning = Scanning.TestCase
TestScanning.settings = settings(max_examples=200, derandomize=True, **COMMON)


@pytest.mark.slow
def test_scanning_at_length() -> None:
    run_state_machine_as_test(Scanning, settings=settings(max_examples=10_000, **COMMON))


@pytest.fixture
def scanning() -> Iterator[Scanning]:
    machine = Scanning()
    yield machine
    machine.teardown()


def test_a_card_that_accepts_when_parking_would_be_bypassed_stays_parked(scanning: Scanning) -> None:
    scanning.refuse(0.28125)
    scanning.park()


def test_a_parked_galvo_that_another_program_resets_is_parked_again(scanning: Scanning) -> None:
    scanning.card.reset(scanning.card.device)
    assert scanning.card.last_volts == 0.0
    scanning.wait(PARKED_S)
    scanning.never_falsely_parked()


@pytest.mark.parametrize("command", ["hold", "scan"])
def test_a_command_to_a_card_whose_calls_do_not_return_ends_in_time(scanning: Scanning, command: str) -> None:
    scanning.card.inject(hangs=True)
    if command == "hold":
        scanning.hold(CENTRE_V)
    else:
        scanning.scan()


def test_what_this_test_would_find(scanning: Scanning) -> None:
    """A write that the card accepts and does not carry out is no parking; a line on the bundle is not clear."""
    scanning.hold(CENTRE_V)
    assert not scanning.output_is_parked(PARK_V)
    scanning.stick()
    scanning.park()
    assert not scanning.scanner.park_state.parked
    scanning.heal()
    scanning.wait(PARKED_S)
    assert scanning.scanner.park_state.parked
