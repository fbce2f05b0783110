"""The state machine of parking, on simulated time: never reported parked when it is not, whatever the card does."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.parking import MANY_ATTEMPTS, RESET_AFTER, RESET_INTERVAL_S, Parking, ParkStage, ParkState

PARK_V = -0.7


@dataclass
class SimulatedOutput:
    """An output with faults, and its clock."""

    now_s: float = 0.0
    volts: float = 0.3
    laser_on: bool = True
    reserved: bool = False
    refuses_until_s: float = 0.0
    clear_fails: int = 0
    stuck: bool = False
    laser_fails: bool = False
    reads_back: bool = True
    power_up_v: float | None = 0.0
    reset_takes_s: float = 0.05
    steps: list[str] = field(default_factory=list)
    on_bundle_s: float = 0.0

    def clock(self) -> float:
        return self.now_s

    def _call(self, step: str, takes_s: float = 0.001) -> None:
        self.steps.append(step)
        if self.laser_on and self.volts != PARK_V:
            self.on_bundle_s += takes_s
        self.now_s += takes_s
        if self.now_s < self.refuses_until_s:
            raise DeviceError("the card is in use", "wait")

    def laser_off(self) -> None:
        self._call("laser off")
        if self.laser_fails:
            raise DeviceError("the line is reserved", "free it")
        self.laser_on = False

    def clear(self) -> None:
        self._call("clear")
        if self.clear_fails:
            self.clear_fails -= 1
            self.reserved = True
            raise DeviceError("ClearTask failed", "try again")

    def put(self, volts: float) -> None:
        self._call("put")
        if self.reserved:
            raise DeviceError("the output is reserved", "reset")
        if not self.stuck:
            self.volts = volts

    def confirm(self, volts: float) -> float | None:
        self._call("confirm")
        if not self.reads_back:
            return None
        if self.volts != volts:
            raise DeviceError(f"the output is at {self.volts}", "check the wires")
        return self.volts

    def reset(self) -> None:
        self._call("reset", self.reset_takes_s)
        self.reserved = False
        if self.power_up_v is not None:
            self.volts = self.power_up_v


def until_parked(parking: Parking, output: SimulatedOutput, within_s: float = 60.0) -> ParkState:
    end_s = output.now_s + within_s
    while not (state := parking.attempt()).parked:
        assert output.now_s < end_s
        output.now_s += state.retry_s
    return state


def test_parked_needs_the_cards_confirmation() -> None:
    output = SimulatedOutput(stuck=True)
    parking = Parking(output, PARK_V, output.clock)
    assert parking.state.stage is ParkStage.UNKNOWN
    state = parking.attempt()
    assert (state.stage, state.parked) == (ParkStage.NOT_PARKED, False)
    assert state.message.startswith("NOT PARKED: switch the laser off")
    assert "at 0.3" in state.message
    output.stuck = False
    assert until_parked(parking, output).read_back_v == PARK_V


def test_a_parked_galvo_whose_laser_line_was_not_switched_off_says_so() -> None:
    """Before: parked, and not a word of a shutter that stayed open."""
    output = SimulatedOutput(laser_fails=True)
    parking = Parking(output, PARK_V, output.clock)
    state = parking.attempt()
    assert state.parked
    assert state.message == "parked, but the laser's line was not switched off (the line is reserved: free it)"
    output.laser_fails = False
    parking.begin(ParkStage.DRIVEN)
    assert parking.attempt().message == ""


@pytest.mark.parametrize("laser_fails", [False, True])
def test_where_calls_do_not_return_the_reset_comes_first_and_not_more_often(laser_fails: bool) -> None:
    output = SimulatedOutput(laser_fails=laser_fails, stuck=True)
    parking = Parking(output, PARK_V, output.clock)
    begun_s = output.now_s
    for _ in range(20):
        output.now_s += parking.attempt(stuck=True).retry_s
    assert output.steps[0] == "reset"
    resets = output.steps.count("reset")
    assert 1 < resets <= 1 + (output.now_s - begun_s) / RESET_INTERVAL_S


def test_a_card_that_cannot_read_back_confirms_by_its_task() -> None:
    output = SimulatedOutput(reads_back=False)
    state = Parking(output, PARK_V, output.clock).attempt()
    assert state.parked
    assert state.read_back_v is None


def test_the_reset_is_the_last_step_with_the_laser_off_before_and_the_write_at_once_after_it() -> None:
    output = SimulatedOutput(clear_fails=1, reserved=True)
    parking = Parking(output, PARK_V, output.clock)
    state = until_parked(parking, output)
    assert state.resets == 1
    assert state.attempts == RESET_AFTER + 1
    reset = output.steps.index("reset")
    assert "laser off" in output.steps[:reset]
    assert output.steps[reset + 1] == "put"
    assert state.reset_s == pytest.approx(output.reset_takes_s + 0.001)
    assert "power-up voltage" in state.message
    assert not output.laser_on


def test_the_time_at_the_power_up_voltage_counts_from_the_first_reset_after_which_nothing_was_written() -> None:
    """Before: from the last reset alone, while the line had stood on the bundle since the first one."""
    output = SimulatedOutput(clear_fails=1, reserved=True)
    parking = Parking(output, PARK_V, output.clock)
    put, refused = output.put, []

    def refuse_after_a_reset(volts: float) -> None:
        if "reset" in output.steps and (not refused or output.now_s - refused[0] < 0.5):
            refused.append(output.now_s)
            raise DeviceError("the card is in use", "wait")
        put(volts)

    output.put = refuse_after_a_reset  # type: ignore[method-assign]
    state = until_parked(parking, output)
    assert state.resets > 1
    assert state.reset_s == pytest.approx(output.now_s - refused[0] + output.reset_takes_s, abs=0.01)


def test_a_reset_that_fails_is_not_counted_as_one() -> None:
    """Before: "reset 4 times" of a card that was unplugged."""
    output = SimulatedOutput(refuses_until_s=1.0)
    state = until_parked(Parking(output, PARK_V, output.clock), output)
    assert output.steps.count("reset") > 2
    assert state.resets <= 1


def test_a_galvo_that_is_to_park_elsewhere_is_not_parked_until_it_is_there() -> None:
    """Before: parked at the new voltage before it had moved."""
    output = SimulatedOutput()
    parking = Parking(output, PARK_V, output.clock)
    assert parking.attempt().parked
    parking.retarget(PARK_V)
    assert parking.state.parked
    parking.retarget(PARK_V - 0.2)
    assert parking.state.stage is ParkStage.PARKING
    assert parking.attempt().read_back_v == PARK_V - 0.2


def test_it_is_retried_without_end_and_parked_soon_after_the_card_accepts_again() -> None:
    output = SimulatedOutput(refuses_until_s=300.0)
    parking = Parking(output, PARK_V, output.clock)
    state = until_parked(parking, output, within_s=400.0)
    assert state.attempts > 10 * MANY_ATTEMPTS
    assert output.now_s - 300.0 < 0.5


def test_an_error_that_no_card_raises_is_a_failed_attempt_too() -> None:
    """Before: it ended the guardian, which nobody replaces once its process has died."""

    class Defective(SimulatedOutput):
        def put(self, volts: float) -> None:
            self.steps.append("put")
            if self.steps.count("put") < 3:
                raise MemoryError
            super().put(volts)

        def clear(self) -> None:
            raise ValueError("a defect")

    output = Defective()
    parking = Parking(output, PARK_V, output.clock)
    assert "MemoryError" in parking.attempt().message
    assert "ValueError: a defect" in parking.attempt().message
    assert until_parked(parking, output).attempts == 3


def test_states_can_be_subscribed_to_and_a_subscriber_that_fails_does_not_stop_parking() -> None:
    output = SimulatedOutput(refuses_until_s=0.01)
    parking = Parking(output, PARK_V, output.clock)
    seen: list[ParkStage] = []
    end = parking.subscribe(lambda state: seen.append(state.stage))
    parking.subscribe(lambda state: 1 // 0)
    parking.begin(ParkStage.DRIVEN)
    until_parked(parking, output)
    assert seen == [ParkStage.DRIVEN, ParkStage.PARKING, *[ParkStage.NOT_PARKED] * (len(seen) - 3), ParkStage.PARKED]
    end()
    parking.begin(ParkStage.DRIVEN)
    assert seen[-1] is ParkStage.PARKED


@pytest.mark.parametrize("command", ["alarm", "revoke", "begin", "retarget"])
def test_a_state_is_tested_and_entered_in_one_step(command) -> None:
    """Before: an attempt that ended between the two was overwritten by the alarm."""
    parking = Parking(SimulatedOutput(), PARK_V)
    parking.begin(ParkStage.PARKING)
    if command == "revoke":
        parking.attempt()
    entered, held = [], threading.Event()
    parking.subscribe(lambda state: entered.append(state.stage))
    arguments = {"alarm": ("no answer",), "revoke": ("moved",), "begin": (ParkStage.PARKING,), "retarget": (-0.8,)}
    with parking._changed:
        other = threading.Thread(target=lambda: (held.set(), getattr(parking, command)(*arguments[command])))
        other.start()
        held.wait()
        time.sleep(0.05)
        parking._state = ParkState(ParkStage.DRIVEN if command == "revoke" else ParkStage.PARKED)
        expected = ParkStage.PARKING if command in ("begin", "retarget") else parking.state.stage
    other.join()
    assert parking.state.stage is expected


class AnyOrder(RuleBasedStateMachine):
    """Commands, faults and recoveries in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.output = SimulatedOutput()
        self.parking = Parking(self.output, PARK_V, self.output.clock)
        self.driven = True

    @rule(volts=st.sampled_from([-0.4, 0.0, 0.5]))
    @precondition(lambda self: self.parking.state.parked or self.driven)
    def drive(self, volts: float) -> None:
        self.parking.begin(ParkStage.DRIVEN)
        self.output.volts, self.output.laser_on, self.driven = volts, True, True

    @rule()
    def park(self) -> None:
        self.driven = False
        self.parking.attempt()

    @rule(seconds=st.floats(0.001, 2.0))
    def refuse(self, seconds: float) -> None:
        self.output.refuses_until_s = self.output.now_s + seconds

    @rule(fails=st.integers(1, 5))
    def fail_to_clear(self, fails: int) -> None:
        self.output.clear_fails = fails

    @rule(stuck=st.booleans())
    def stick(self, stuck: bool) -> None:
        self.output.stuck = stuck

    @rule(volts=st.sampled_from([None, 0.0, -10.0]))
    def change_power_up(self, volts: float | None) -> None:
        self.output.power_up_v = volts

    @rule(seconds=st.floats(0.0, 3.0))
    def wait(self, seconds: float) -> None:
        self.output.now_s += seconds

    @rule()
    def reserve(self) -> None:
        self.output.reserved = True

    @invariant()
    def parked_is_never_reported_of_a_line_that_is_not(self) -> None:
        if self.parking.state.parked:
            assert self.output.volts == PARK_V

    def teardown(self) -> None:
        """Once all faults end, it is parked within half a second."""
        self.output.stuck, self.output.refuses_until_s, self.output.clear_fails = False, 0.0, 0
        healed_s = self.output.now_s
        until_parked(self.parking, self.output)
        assert self.output.now_s - healed_s < 0.5


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(max_examples=200, stateful_step_count=20, deadline=None)


@pytest.mark.slow
def test_any_order_at_length() -> None:
    from hypothesis.stateful import run_state_machine_as_test

    many = settings(max_examples=10_000, stateful_step_count=20, deadline=None)
    run_state_machine_as_test(AnyOrder, settings=many)
