"""The virtual card by NI's documentation: wrong configurations get DAQmx's own error, or another waveform.

The calls are nidaqmx's, not the driver's; what counts is the code, and the voltage on the output.
"""

from __future__ import annotations

from contextlib import ExitStack

import nidaqmx
import numpy as np
import pytest
from nidaqmx.constants import AcquisitionType, Edge, RegenerationMode
from nidaqmx.errors import DaqError
from nidaqmx.stream_writers import AnalogSingleChannelWriter

from napari_elsplus.hardware.virtual.card.card import VirtualCard
from napari_elsplus.hardware.virtual.timeline import BenchClock, StrobeTrain, volts_at
from ni_library import replacing_ni_library

RAMP = np.linspace(-0.5, 0.5, 100)
RATE_HZ, PERIOD_S, WIDTH_S = 100_000.0, 2e-3, 0.3e-3
TRAIN = StrobeTrain(0.01, PERIOD_S, width_s=WIDTH_S)
CYCLE = np.concatenate([RAMP, np.full(100, RAMP[-1])])
"""What the output does from one strobe to the next: 1 ms of ramp, 1 ms of its last sample."""


@pytest.fixture
def card():
    """A card whose time only goes on when a test lets it."""
    card = VirtualCard(BenchClock(real_time=False))
    with replacing_ni_library(card):
        yield card


def scan(held: ExitStack, **changes) -> list[nidaqmx.Task]:
    """Configure ramp and clock as the authors' rig does, but for the changes; and start them."""
    wanted = {
        "trigger": "/Dev1/PFI0", "edge": Edge.FALLING, "retriggerable": True, "clock": "/Dev1/Ctr0InternalOutput",
        "pulses": AcquisitionType.FINITE, "mode": AcquisitionType.CONTINUOUS, "counter": "ctr0", "output": "ao0",
        "regeneration": RegenerationMode.ALLOW_REGENERATION, "on_board": True, "volts": RAMP, "burst": len(RAMP),
        "rate_hz": RATE_HZ, "pulse_hz": RATE_HZ,
    } | changes  # fmt: skip
    clock, ramp = held.enter_context(nidaqmx.Task()), held.enter_context(nidaqmx.Task())
    clock.co_channels.add_co_pulse_chan_freq(f"Dev1/{wanted['counter']}", freq=wanted["pulse_hz"])
    clock.timing.cfg_implicit_timing(wanted["pulses"], wanted["burst"])
    if wanted["trigger"]:
        clock.triggers.start_trigger.cfg_dig_edge_start_trig(wanted["trigger"], wanted["edge"])
        clock.triggers.start_trigger.retriggerable = wanted["retriggerable"]
    channel = ramp.ao_channels.add_ao_voltage_chan(f"Dev1/{wanted['output']}", min_val=-1.0, max_val=1.0)
    channel.ao_use_only_on_brd_mem = wanted["on_board"]
    ramp.timing.cfg_samp_clk_timing(
        wanted["rate_hz"], wanted["clock"], sample_mode=wanted["mode"], samps_per_chan=len(RAMP)
    )
    ramp.out_stream.regen_mode = wanted["regeneration"]
    if wanted["volts"] is not None:
        AnalogSingleChannelWriter(ramp.out_stream, auto_start=False).write_many_sample(wanted["volts"])
    ramp.start()
    clock.start()
    return [clock, ramp]


def cycles(card: VirtualCard, count: int = 4) -> np.ndarray:
    """Return the voltage over as many strobes, (count, 200), sampled in the middle of the card's samples."""
    times = TRAIN.start_s + (np.arange(count * 200) + 0.5) / RATE_HZ
    return volts_at(card.programs(), times).reshape(count, 200)


def test_the_authors_configuration_puts_a_ramp_out_after_every_strobe(card) -> None:
    with ExitStack() as held:
        clock, ramp = scan(held)
        card.strobe(TRAIN)
        np.testing.assert_allclose(cycles(card), np.tile(CYCLE, (4, 1)))
        card.clock.wait_until(TRAIN.start_s + 3.25 * PERIOD_S)
        assert ramp.out_stream.total_samp_per_chan_generated == 351
        assert not ramp.is_task_done()
        assert not clock.is_task_done()


@pytest.mark.parametrize(
    "changes",
    [
        {"trigger": "/Dev1/PFI1"},
        {"trigger": ""},
        {"edge": Edge.RISING},
        {"retriggerable": False},
        {"clock": "/Dev1/Ctr1InternalOutput"},
        {"clock": ""},
        {"counter": "ctr1"},
        {"output": "ao1"},
        {"pulses": AcquisitionType.CONTINUOUS},
        {"mode": AcquisitionType.FINITE},
        {"burst": 50},
        {"pulse_hz": 90_000.0},
        {"regeneration": RegenerationMode.DONT_ALLOW_REGENERATION, "on_board": False},
    ],
)
def test_with_any_other_configuration_the_output_does_something_else(card, changes) -> None:
    with ExitStack() as held:
        scan(held, **changes)
        card.strobe(TRAIN)
        assert np.abs(cycles(card) - CYCLE).max() > 0.05


def test_the_other_counters_pulses_start_ramps_as_well(card) -> None:
    with ExitStack() as held:
        pulses = held.enter_context(nidaqmx.Task())
        pulses.co_channels.add_co_pulse_chan_freq("Dev1/ctr1", freq=1 / PERIOD_S)
        pulses.timing.cfg_implicit_timing(AcquisitionType.CONTINUOUS)
        pulses.start()
        begin_s = card.clock.now_s()
        scan(held, trigger="/Dev1/Ctr1InternalOutput", edge=Edge.RISING)
        times = begin_s + 1.0 * PERIOD_S + (np.arange(400) + 0.5) / RATE_HZ  # idle low: it rises, and falls half later
        np.testing.assert_allclose(volts_at(card.programs(), times).reshape(2, 200), np.tile(CYCLE, (2, 1)), atol=1e-9)


def test_the_other_edge_is_the_end_of_the_exposure(card) -> None:
    with ExitStack() as held:
        scan(held, edge=Edge.RISING)
        card.strobe(TRAIN)
        shifted = np.roll(CYCLE, round(WIDTH_S * RATE_HZ))
        np.testing.assert_allclose(cycles(card)[1:], np.tile(shifted, (3, 1)), atol=1e-9)


def test_without_regeneration_the_generation_stops_with_its_code(card) -> None:
    with ExitStack() as held:
        _, ramp = scan(held, regeneration=RegenerationMode.DONT_ALLOW_REGENERATION, on_board=False)
        card.strobe(TRAIN)
        card.clock.wait_until(TRAIN.start_s + 1.5 * PERIOD_S)
        with pytest.raises(DaqError) as refused:
            ramp.is_task_done()
        assert refused.value.error_code == -200290


def test_a_busy_computer_starves_an_output_that_depends_on_it(card) -> None:
    card.inject(host_stalls=True)
    with ExitStack() as held:
        _, ramp = scan(held)
        card.strobe(TRAIN)
        assert ramp.out_stream.total_samp_per_chan_generated == 0
    with ExitStack() as held:
        _, ramp = scan(held, on_board=False)
        with pytest.raises(DaqError) as refused:
            ramp.is_task_done()
        assert refused.value.error_code == -200621


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"trigger": "PFI0"}, -89120),
        ({"clock": "/Dev1/Ctr7InternalOutput"}, -89120),
        ({"rate_hz": 300_000.0}, -200077),
        ({"volts": None}, -200858),
        ({"volts": np.full(100, 1.5)}, -200561),
        ({"volts": np.zeros(9000)}, -200341),
        ({"regeneration": RegenerationMode.DONT_ALLOW_REGENERATION}, -200656),
        ({"output": "ao2"}, -200170),
        ({"counter": "ctr2"}, -200170),
    ],
)
def test_what_cannot_be_started_is_refused_by_its_code(card, changes, code) -> None:
    with ExitStack() as held, pytest.raises(DaqError) as refused:
        scan(held, **changes)
    assert refused.value.error_code == code


def test_the_task_state_model_holds(card) -> None:
    def code(call) -> int:
        with pytest.raises(DaqError) as refused:
            call()
        return refused.value.error_code

    with ExitStack() as held:
        clock, ramp = scan(held)
        assert code(lambda: ramp.timing.cfg_samp_clk_timing(RATE_HZ)) == -200479
        assert code(lambda: clock.triggers.start_trigger.cfg_dig_edge_start_trig("/Dev1/PFI1")) == -200479
        assert code(lambda: setattr(ramp.out_stream, "regen_mode", RegenerationMode.ALLOW_REGENERATION)) == -200450
        assert code(lambda: AnalogSingleChannelWriter(ramp.out_stream).write_many_sample(RAMP)) == -200295
        other = held.enter_context(nidaqmx.Task())
        assert code(other.start) == -200478
        other.ao_channels.add_ao_voltage_chan("Dev1/ao0", min_val=-1.0, max_val=1.0)
        writer = AnalogSingleChannelWriter(other.out_stream, auto_start=False)
        assert code(lambda: writer.write_one_sample(0.1)) == -200846
        assert code(lambda: writer.write_many_sample(RAMP)) == -200539
        writer.auto_start = True
        assert code(lambda: writer.write_one_sample(0.1)) == -50103  # the ramp's task has reserved the output
        ramp.stop()
        writer.write_one_sample(0.1)
        assert card.last_volts == 0.1
