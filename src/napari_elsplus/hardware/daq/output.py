"""The card's analog output and its clock, as nidaqmx tasks."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any

from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.daq.errors import translate_daq_errors

if TYPE_CHECKING:
    from nidaqmx import GrpcSessionOptions, Task

    from napari_elsplus.hardware.scan.waveform import GalvoLimits, Waveform


@dataclass(frozen=True, slots=True)
class CardSettings:
    """Card and wiring.

    Parameters
    ----------
    device, output, counter, strobe : str
        Names as NI MAX shows them.
    falling : bool
        The strobe's falling edge starts the ramp, as on the authors' rig.
    park_v : float
        Voltage at which the line clears the lit bundle; never assumed, always measured or confirmed by the user.
    hold_limit_s : float
        Longest time for which the line may be held on the bundle, in seconds.
    address : str
        ``host:port`` of an NI gRPC device server; empty: the driver on this computer.

    Raises
    ------
    InputError
        If a number is impossible.
    """

    park_v: float
    device: str = "Dev1"
    output: str = "ao0"
    counter: str = "ctr0"
    strobe: str = "PFI0"
    falling: bool = True
    hold_limit_s: float = 20.0
    address: str = ""

    def __post_init__(self) -> None:
        if not (isfinite(self.park_v) and abs(self.park_v) <= 10):
            raise InputError(f"the parking voltage is {self.park_v}", "give a voltage within -10 to 10 V")
        if not 0 < self.hold_limit_s <= 600:
            raise InputError(f"the hold limit is {self.hold_limit_s} s", "give more than 0 and at most 600 s")


def open_options(address: str) -> GrpcSessionOptions | None:
    """Return nidaqmx's session options for a card at an address; None for the driver on this computer."""
    if not address:
        return None
    import grpc
    from nidaqmx import GrpcSessionOptions

    return GrpcSessionOptions(grpc.insecure_channel(address), "")


class Output:
    """The card's analog output and its clock, as nidaqmx tasks; one of them reserves the output at any time.

    Parameters
    ----------
    card : CardSettings
        Card and wiring.
    limits : GalvoLimits
        Range of the output.
    """

    def __init__(self, card: CardSettings, limits: GalvoLimits) -> None:
        self.card, self.limits = card, limits
        self._options = open_options(card.address)
        self._tasks: list[Task] = []
        self._still: Task | None = None

    def put(self, volts: float) -> None:
        """Put a voltage out, in volts, now."""
        from nidaqmx.stream_writers import AnalogSingleChannelWriter

        try:
            with translate_daq_errors(self.card.device):
                if self._still is None:
                    self.clear()
                    self._still, _ = self._voltage_task()
                AnalogSingleChannelWriter(self._still.out_stream, auto_start=True).write_one_sample(volts)
        except DeviceError:
            with contextlib.suppress(DeviceError):  # the first error is raised
                self.clear()
            raise

    def repeat(self, waveform: Waveform) -> None:
        """Put a burst of the waveform out after each strobe, from the card's memory."""
        from nidaqmx.constants import AcquisitionType, Edge, RegenerationMode
        from nidaqmx.stream_writers import AnalogSingleChannelWriter

        card, rate = self.card, waveform.sample_rate_hz
        edge = Edge.FALLING if card.falling else Edge.RISING
        with translate_daq_errors(card.device):
            self.clear()
            clock = self._task()
            clock.co_channels.add_co_pulse_chan_freq(f"{card.device}/{card.counter}", freq=rate)
            clock.timing.cfg_implicit_timing(AcquisitionType.FINITE, waveform.samples_per_ramp)
            clock.triggers.start_trigger.cfg_dig_edge_start_trig(f"/{card.device}/{card.strobe}", edge)
            clock.triggers.start_trigger.retriggerable = True
            ramp, channel = self._voltage_task()
            channel.ao_use_only_on_brd_mem = True
            source = f"/{card.device}/{card.counter.capitalize()}InternalOutput"
            ramp.timing.cfg_samp_clk_timing(
                rate, source, sample_mode=AcquisitionType.CONTINUOUS, samps_per_chan=len(waveform.volts)
            )
            ramp.out_stream.regen_mode = RegenerationMode.ALLOW_REGENERATION
            AnalogSingleChannelWriter(ramp.out_stream, auto_start=False).write_many_sample(waveform.volts)
            ramp.start()
            clock.start()

    def samples_done(self) -> int:
        """Count the samples put out since `repeat`; raise the error that stopped the output, if any."""
        with translate_daq_errors(self.card.device):
            for task in self._tasks:
                task.is_task_done()
            return int(self._tasks[-1].out_stream.total_samp_per_chan_generated)

    def clear(self) -> None:
        """Delete every task, whatever errors others raise; the card keeps the last voltage."""
        tasks, self._tasks, self._still = self._tasks, [], None
        with contextlib.ExitStack() as each, translate_daq_errors(self.card.device):
            for task in reversed(tasks):
                each.callback(task.close)

    def close(self) -> None:
        """Delete every task, and close the channel to a card elsewhere before its server ends."""
        try:
            self.clear()
        finally:
            if self._options is not None:
                self._options.grpc_channel.close()

    def _task(self) -> Task:
        from nidaqmx import Task

        task = Task(grpc_options=self._options) if self._options else Task()
        self._tasks.append(task)
        return task

    def _voltage_task(self) -> tuple[Task, Any]:
        task = self._task()
        name = f"{self.card.device}/{self.card.output}"
        channel = task.ao_channels.add_ao_voltage_chan(name, min_val=self.limits.min_v, max_val=self.limits.max_v)
        return task, channel
