"""The card's analog output, its clock and the laser's line, as nidaqmx tasks."""

from __future__ import annotations

import contextlib
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final

from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.daq.calls import Calls
from napari_elsplus.hardware.daq.errors import IN_USE, NO_SUCH_CHANNEL
from napari_elsplus.hardware.daq.session import open_session

if TYPE_CHECKING:
    from nidaqmx import Task

    from napari_elsplus.hardware.scan.waveform import GalvoLimits, Waveform

MAX_HOLD_S: Final = 600.0
"""Seconds; chosen: longer than any calibration needs the line at one place."""
READ_BACK_TOLERANCE_V: Final = 0.02
"""Volts; derived: some errors of such a card's input (mV at +-10 V), a fifth of what clears the bundle by 100 um."""
READ_BACK_TIMEOUT_S: Final = 0.5
"""Seconds; chosen: far above the time of one sample."""
CHANNELS: Final = {
    "output": (r"ao\d+", "ao0"),
    "counter": (r"ctr\d+", "ctr0"),
    "laser_line": (r"(port\d+/line\d+)?", "port0/line0"),
}
"""Patterns of the card's channels as NI names them, with an example."""


@dataclass(frozen=True, slots=True)
class CardSettings:
    """Card and wiring; table ``card`` of a rig file.

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
    laser_line : str
        Digital line to a shutter or to the laser's enable input, as ``port0/line0``; empty: none is wired.
    laser_on_high : bool
        Level of that line at which the laser is on. Wire a pull-down (pull-up if False): a reset floats the line.
    address : str
        ``host:port`` of an NI gRPC device server; empty: the driver on this computer.

    Raises
    ------
    InputError
        If a number or a name is impossible.
    """

    __pydantic_config__: ClassVar = {"extra": "forbid"}  # for a rig file, where an unknown key is a misspelling

    park_v: float
    device: str = "Dev1"
    output: str = "ao0"
    counter: str = "ctr0"
    strobe: str = "PFI0"
    falling: bool = True
    hold_limit_s: float = 20.0
    laser_line: str = ""
    laser_on_high: bool = True
    address: str = ""

    def __post_init__(self) -> None:
        if not abs(self.park_v) <= 10:
            raise InputError(f"the parking voltage park_v is {self.park_v:g}", "give a voltage within -10 to 10 V")
        if not 0 < self.hold_limit_s <= MAX_HOLD_S:
            raise InputError(f"hold_limit_s is {self.hold_limit_s:g}", f"give more than 0 and at most {MAX_HOLD_S:g} s")
        for name, (pattern, example) in CHANNELS.items():
            if not re.fullmatch(pattern, getattr(self, name)):
                raise InputError(f"{name} is {getattr(self, name)!r}", f"give a name such as {example}")


class Output:
    """The card's analog output, its clock and the laser's line; one task reserves the output at any time.

    Implements `napari_elsplus.hardware.parking.ParkingOutput`.

    Parameters
    ----------
    card : CardSettings
        Card and wiring.
    limits : GalvoLimits
        Range of the output.
    """

    def __init__(self, card: CardSettings, limits: GalvoLimits) -> None:
        self.card, self.limits = card, limits
        self._session = open_session(card.address)
        self._tasks: list[Task] = []
        self._samples = 0
        self._still: Task | None = None
        self._laser: Task | None = None
        self._reads_back = True
        self.calls = Calls(card.device)
        """The calls that are made to the card; by one thread."""

    def put(self, volts: float) -> None:
        """Put a voltage out, in volts, now."""
        from nidaqmx.stream_writers import AnalogSingleChannelWriter

        try:
            with self.calls():
                if self._still is None:
                    self.clear()
                    self._still, _ = self._voltage_task()
                AnalogSingleChannelWriter(self._still.out_stream, auto_start=True).write_one_sample(volts)
        except DeviceError:
            with contextlib.suppress(DeviceError):  # the first error is raised
                self.clear()
            raise

    def confirm(self, volts: float) -> float | None:
        """Return the voltage that the card reads back from its output; None where it has no such channel.

        Parameters
        ----------
        volts : float
            Voltage of the last `put`.

        Raises
        ------
        DeviceError
            If the write was not completed, or the output is at another voltage.
        """
        with self.calls():
            if self._still is None:
                raise DeviceError(f"card {self.card.device}: nothing holds the output", "park again")
            self._still.stop()  # a write that has not been completed is completed, or raises
            if not self._still.is_task_done():
                raise DeviceError(f"card {self.card.device}: {self.card.output} was not written", "park again")
        measured = self.read_back()
        self._refuse_elsewhere(measured, volts)
        return measured

    def check_still(self, volts: float) -> None:
        """Raise if the output does not stand any more where it was put.

        An input that another program uses at this time is left to it; the task of the output is checked all the same.

        Parameters
        ----------
        volts : float
            Voltage of the last `put`.

        Raises
        ------
        DeviceError
            If the card was reset, is gone, or another program has put out another voltage.
        """
        with self.calls():
            if self._still is None:
                raise DeviceError(f"card {self.card.device}: nothing holds the output", "park again")
            self._still.is_task_done()  # raises where a reset has ended it
        try:
            measured = self.read_back()
        except DeviceError as error:
            if getattr(error.__cause__, "error_code", 0) != IN_USE:
                raise
        else:
            self._refuse_elsewhere(measured, volts)

    def repeat(self, waveform: Waveform) -> None:
        """Put a burst of the waveform out after each strobe, from the card's memory."""
        from nidaqmx.constants import AcquisitionType, Edge, RegenerationMode
        from nidaqmx.stream_writers import AnalogSingleChannelWriter

        card, rate = self.card, waveform.sample_rate_hz
        edge = Edge.FALLING if card.falling else Edge.RISING
        with self.calls():
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
            with self.calls():
                AnalogSingleChannelWriter(ramp.out_stream, auto_start=False).write_many_sample(waveform.volts)
            ramp.start()
            clock.start()
            self._samples = 0

    def samples_done(self) -> int:
        """Count the samples put out since `repeat`; where there are no more than before, raise what stopped them.

        An output that goes on is asked once: each call to a card elsewhere takes half a millisecond.
        """
        with self.calls():
            before, self._samples = self._samples, int(self._tasks[-1].out_stream.total_samp_per_chan_generated)
            if self._samples <= before:
                for task in self._tasks:
                    task.is_task_done()
            return self._samples

    def laser(self, on: bool) -> None:
        """Switch the laser's line `on` or off; does nothing where none is wired."""
        if not self.card.laser_line:
            return
        from nidaqmx.stream_writers import DigitalSingleChannelWriter

        try:
            with self.calls():
                if self._laser is None:
                    self._laser = self._session.task()
                    self._laser.do_channels.add_do_chan(f"{self.card.device}/{self.card.laser_line}")
                level = on == self.card.laser_on_high
                DigitalSingleChannelWriter(self._laser.out_stream, auto_start=True).write_one_sample_one_line(level)
        except DeviceError:
            self._forget(self._laser)  # the next attempt makes it anew
            self._laser = None
            raise

    def laser_off(self) -> None:
        """Switch the laser's line off."""
        self.laser(False)

    def reset(self) -> None:
        """Reset the card, which aborts its tasks; its outputs may go to their power-up voltage (0 V, or the last)."""
        tasks, self._tasks, self._still = [*self._tasks, self._laser], [], None
        self._laser = None
        with self.calls():
            self._session.system().devices[self.card.device].reset_device()
        for task in tasks:
            self._forget(task)

    def clear(self) -> None:
        """Delete every task of the output, whatever errors others raise; the card keeps the last voltage."""
        tasks, self._tasks, self._still = self._tasks, [], None
        with self.calls(), contextlib.ExitStack() as each:
            for task in tasks:
                each.callback(task.close)  # the last one first

    def release(self) -> None:
        """Delete every task, and close the channel to a card elsewhere, whatever errors a card raises that is gone."""
        self._forget(self._laser)
        self._laser = None
        with contextlib.suppress(DeviceError):
            self.clear()
        self._session.close()

    def read_back(self) -> float | None:
        """Measure the output in volts by the card's internal channel; None where it has none."""
        if not self._reads_back:
            return None
        from nidaqmx.errors import DaqError
        from nidaqmx.stream_readers import AnalogSingleChannelReader

        task = None
        with self.calls():
            try:
                task = self._session.task()
                channel = f"{self.card.device}/_{self.card.output}_vs_aognd"
                task.ai_channels.add_ai_voltage_chan(channel, min_val=-10.0, max_val=10.0)
                return float(AnalogSingleChannelReader(task.in_stream).read_one_sample(READ_BACK_TIMEOUT_S))
            except DaqError as error:
                if error.error_code not in NO_SUCH_CHANNEL:
                    raise
                self._reads_back = False
                return None
            finally:
                self._forget(task)

    def _refuse_elsewhere(self, measured: float | None, volts: float) -> None:
        if measured is not None and not abs(measured - volts) <= READ_BACK_TOLERANCE_V:
            raise DeviceError(
                f"card {self.card.device}: {self.card.output} is at {measured:.3g} V instead of {volts:.3g} V",
                "check what is wired to the output",
            )

    def _forget(self, task: Task | None) -> None:
        """Delete a task whose errors do not matter any more."""
        if task is not None:
            with contextlib.suppress(DeviceError), self.calls():
                task.close()

    def _task(self) -> Task:
        with self.calls():
            task = self._session.task()
        self._tasks.append(task)
        return task

    def _voltage_task(self) -> tuple[Task, Any]:
        task = self._task()
        name = f"{self.card.device}/{self.card.output}"
        with self.calls():
            channel = task.ao_channels.add_ao_voltage_chan(name, min_val=self.limits.min_v, max_val=self.limits.max_v)
        return task, channel
