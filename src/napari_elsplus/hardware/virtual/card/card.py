"""The virtual card: DAQmx tasks on one analog output and one counter, as far as a line scan needs them."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.hardware.virtual.card.faults import CardFaults
from napari_elsplus.hardware.virtual.card.tasks import CONTINUOUS, FALLING, FINITE, ON_DEMAND, CardError, VirtualTask
from napari_elsplus.hardware.virtual.timeline import BenchClock, Program, StrobeTrain, volts_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

POWER_ON_V: Final = 0.0
"""Volts of the output when the card is switched on."""
MAX_PROGRAMS: Final = 64
"""Programs kept; chosen: more than a frame of holds, 1 ms each."""
STROBE: Final = "PFI0"
"""Terminal to which the camera's strobe is wired: low while the sensor is exposed, so that it falls first."""
OUTPUT: Final = "ao0"
"""Output to which the galvo is wired."""
CHANNELS: Final = {
    "output": ("ao0", "ao1"),
    "counter": ("ctr0", "ctr1"),
    "input": ("_ao0_vs_aognd", "_ao1_vs_aognd"),
    "line": ("port0/line0", "port0/line1"),
}
"""Physical channels of the card by kind."""
ENDLESS: Final = 1 << 60
"""Clocks of a counter that does not stop."""
FOREVER_S: Final = 1e9
"""Period of edges of which only the first matters."""


class VirtualCard:
    """A card with an analog output and a counter, one of its terminals wired to the strobe.

    Parameters
    ----------
    clock : BenchClock, optional
        Clock of the bench; that of the computer by default.

    Attributes
    ----------
    device : str
        Its name.
    """

    device = "Dev1"

    def __init__(self, clock: BenchClock | None = None) -> None:
        self.clock = clock or BenchClock()
        self._lock = threading.RLock()
        self._resets = threading.Condition(self._lock)
        self.faults = CardFaults()
        self.laser_on = False
        """Level of the digital line to the laser."""
        self._tasks: dict[int, VirtualTask] = {}
        self._last_handle = 0
        self._strobe: StrobeTrain | None = None
        self._clock: VirtualTask | None = None
        """Counter that clocks the running program."""
        self._programs = [Program(self.clock.now_s(), POWER_ON_V)]
        self._fault = 0
        self.version = 0

    # The bench's side.

    def strobe(self, train: StrobeTrain | None) -> None:
        """Wire a train of edges to the strobe's terminal; a train changed in its end only goes on."""
        with self._lock:
            if self.faults.strobe_unwired:
                train = None
            self._strobe = train
            running, clock = self._programs[-1], self._clock
            if not len(running.samples) or clock is None or not clock.trigger:
                return
            train = self._edges(clock, running.since_s)
            if train is None or running.strobe is None or train.start_s == running.strobe.start_s:
                self._programs[-1] = replace(running, strobe=train)
                self.version += 1
                return
            now = self.clock.now_s()
            begun = -(-int(running.samples_by(np.array([now]))[0]) // running.burst) * running.burst
            self._append(replace(running, since_s=now, resting_v=self.last_volts, strobe=train, begun=begun))

    def programs(self) -> list[Program]:
        """Return the last programs of the output, oldest first."""
        with self._lock:
            return list(self._programs)

    @property
    def last_volts(self) -> float:
        """The voltage on the output now."""
        with self._lock:
            return float(volts_at(self._programs, np.array([self.clock.now_s()]))[0])

    def break_with(self, code: int) -> None:
        """Inject a fault by its status code.

        -200621 and -200290 stop the output, -201003 unplugs the card, -50103 lends it to another program; 0 ends the
        fault.
        """
        with self._lock:
            self._fault = code
            if code in (-200621, -200290, -201003):
                self._halt()

    def inject(self, refuse_s: float = 0.0, **changes: Any) -> None:
        """Change the faults.

        Parameters
        ----------
        refuse_s : float
            Seconds from now in which every call of the driver is refused.
        **changes
            Fields of `CardFaults`.
        """
        with self._lock:
            if refuse_s:
                changes["refuse_until_s"] = self.clock.now_s() + refuse_s
            self.faults = replace(self.faults, **changes)
            self._resets.notify_all()

    # The driver's side.

    def create_task(self, name: str) -> int:
        """Create a task of that name, and return its handle."""
        with self._lock:
            self._refuse()
            self._last_handle += 1
            self._tasks[self._last_handle] = VirtualTask(name or f"_unnamedTask<{self._last_handle}>")
            return self._last_handle

    def clear_task(self, handle: int) -> None:
        """Stop and delete the task of a handle."""
        with self._lock:
            task = self.task(handle)
            if self.faults.clear_errors:
                self.faults = replace(self.faults, clear_errors=self.faults.clear_errors - 1)
                raise CardError(-200479)
            self._refuse()
            self._stop(task)
            del self._tasks[handle]

    def task(self, handle: int) -> VirtualTask:
        """Return the task of a handle."""
        try:
            return self._tasks[handle]
        except KeyError:
            raise CardError(-200088) from None

    def add_channel(self, handle: int, kind: str, channel: str) -> VirtualTask:
        """Add a channel to a task, and return the task.

        Parameters
        ----------
        handle : int
            The task.
        kind : str
            One of `CHANNELS`.
        channel : str
            Its name with the device.
        """
        name = self._find(channel, CHANNELS[kind] if kind != "input" or self.faults.reads_back else ())
        task = self.task(handle)
        task.add(kind, name)
        return task

    def add_output(self, handle: int, channel: str, low_v: float, high_v: float) -> None:
        """Add an analog output to a task.

        Parameters
        ----------
        handle : int
            The task.
        channel : str
            ``device/ao0``.
        low_v, high_v : float
            Range in volts.
        """
        if not -10 <= low_v < high_v <= 10:
            raise CardError(-200077)
        task = self.add_channel(handle, "output", channel)
        task.low_v, task.high_v = low_v, high_v

    def add_counter(self, handle: int, channel: str, rate_hz: float) -> None:
        """Add a counter's pulses to a task.

        Parameters
        ----------
        handle : int
            The task.
        channel : str
            ``device/ctr0``.
        rate_hz : float
            Pulses per second.
        """
        self.add_channel(handle, "counter", channel).pulse_hz = rate_hz

    def start_task(self, handle: int) -> None:
        """Start the task of a handle; bursts begin once both the output and its clock run."""
        with self._lock:
            task = self.task(handle)
            self._reach()
            if task.running:
                return
            task.verify(self._terminals())
            busy = any(t.running and t.channel == task.channel for t in self._tasks.values() if t is not task)
            if busy or self._fault == -50103:
                raise CardError(-50103)
            task.running, task.since_s = True, self.clock.now_s()
            if task.channel == OUTPUT and task.mode == ON_DEMAND:
                self._put_out(task)
            elif task.kind in ("output", "counter"):
                self._begin_clocked_output()

    def stop_task(self, handle: int) -> None:
        """Stop the task of a handle; the output keeps its voltage."""
        with self._lock:
            self._reach()
            self._stop(self.task(handle))

    def write(self, handle: int, volts: NDArray[np.float64], auto_start: bool) -> int:
        """Write samples, which a task without timing puts out at once.

        Parameters
        ----------
        handle : int
            The task.
        volts : numpy.ndarray
            Samples.
        auto_start : bool
            Start the task.
        """
        with self._lock:
            task = self.task(handle)
            self._reach()
            task.write(volts, auto_start)
            if auto_start and not task.running:
                self.start_task(handle)
            elif task.channel == OUTPUT and task.mode == ON_DEMAND:
                self._put_out(task)
            return len(volts)

    def is_done(self, handle: int) -> bool:
        """Return True if the task of a handle has ended; raise the status code that ended it."""
        with self._lock:
            self._reach()
            task = self.task(handle)
            if task.kind == "counter":  # a retriggerable one is never done
                return not task.running or (task.mode == ON_DEMAND and not task.trigger)
            return not task.running or task.mode == ON_DEMAND or self._samples_out(task) == task.limit

    def read(self, handle: int) -> float:
        """Measure the output by the task of a handle, in volts."""
        with self._lock:
            self.task(handle)
            self._reach()
            return self.last_volts

    def write_line(self, handle: int, level: bool) -> None:
        """Set the digital line of the task of a handle to a level."""
        with self._lock:
            task = self.task(handle)
            self._reach()
            if not task.running:
                self.start_task(handle)
            self.laser_on = level

    def samples_done(self, handle: int) -> int:
        """Count the samples that the task of a handle put out."""
        with self._lock:
            task = self.task(handle)
            self._reach()
            return self._samples_out(task)

    def reset(self, device: str) -> None:
        """Abort every task of the device; output and line go to their power-up state, or the output stays."""
        with self._lock:
            self._find(device, ("",))
            self._refuse()
            if self._fault == -201003:
                raise CardError(-201003)
            for task in self._tasks.values():
                self._stop(task)
            self._tasks.clear()
            self._fault, self.laser_on = 0, False
            self.faults = replace(self.faults, hangs=False)
            if self.faults.reset_to_power_up:
                self._append(Program(self.clock.now_s(), POWER_ON_V))
            self._resets.notify_all()
        self.clock.wait_until(self.clock.now_s() + self.faults.reset_s)

    def _find(self, channel: str, known: tuple[str, ...]) -> str:
        """Return the name of a channel without the device."""
        device, _, name = channel.strip("/").partition("/")
        if device != self.device:
            raise CardError(-200220)
        if name not in known:
            raise CardError(-200170)
        return name

    def _terminals(self) -> list[str]:
        names = [*(f"PFI{number}" for number in range(16)), "Ctr0InternalOutput", "Ctr1InternalOutput"]
        return [f"/{self.device}/{name}" for name in names]

    def _put_out(self, task: VirtualTask) -> None:
        if len(task.volts) and not self.faults.stuck:
            self._append(Program(self.clock.now_s(), float(task.volts[-1])))

    def _begin_clocked_output(self) -> None:
        """Begin the program of a timed output that runs, if its clock runs as well."""
        running = [task for task in self._tasks.values() if task.running]
        ramp = next((task for task in running if task.channel == OUTPUT and task.mode != ON_DEMAND), None)
        if ramp is None or len(self._programs[-1].samples):
            return
        now = self.clock.now_s()
        if ramp.clock == "OnboardClock":
            clock, burst, rate_hz = None, ENDLESS, ramp.rate_hz
            edges: StrobeTrain | None = StrobeTrain(now, FOREVER_S)
        else:
            names = {f"/{self.device}/{task.channel.capitalize()}InternalOutput": task for task in running}
            clock = names.get(ramp.clock)
            if clock is None:
                return
            burst = {FINITE: clock.samples, CONTINUOUS: ENDLESS}.get(clock.mode, 1)
            edges, rate_hz = self._edges(clock, now), clock.pulse_hz
        self._clock = clock
        self._append(Program(now, self.last_volts, ramp.volts.copy(), burst, rate_hz, edges, limit=ramp.limit))

    def _edges(self, clock: VirtualTask, since_s: float) -> StrobeTrain | None:
        """Return the edges that start a counter: of its terminal, the wired polarity, the first only or all."""
        if not clock.trigger:
            return StrobeTrain(since_s, FOREVER_S)
        train = self._strobe if clock.trigger == f"/{self.device}/{STROBE}" else self._pulses(clock.trigger)
        if train is None:
            return None
        if clock.edge != FALLING:
            train = replace(train, start_s=train.start_s + train.width_s)
        if not clock.retriggerable:
            first_s = train.start_s + train.first_after(since_s) * train.period_s
            train = replace(train, end_s=min(train.end_s, first_s + train.period_s / 2))
        return train

    def _pulses(self, terminal: str) -> StrobeTrain | None:
        """Return the pulses of the counter whose output is a terminal: high first, for half of their period."""
        for task in self._tasks.values():
            named = f"/{self.device}/{task.channel.capitalize()}InternalOutput" == terminal
            if named and task.running and task.mode == CONTINUOUS:
                half_s = 0.5 / task.pulse_hz
                return StrobeTrain(task.since_s + half_s, 2 * half_s, width_s=half_s)
        return None

    def _samples_out(self, task: VirtualTask) -> int:
        """Count the samples that a task put out; raise what has stopped it."""
        if task.channel != OUTPUT or not task.running:
            return 0
        if task.mode != ON_DEMAND and not task.on_board_only and self.faults.host_stalls:
            raise CardError(-200621)
        done = int(self._programs[-1].samples_by(np.array([self.clock.now_s()]))[0])
        if not task.regenerates and done == task.limit and task.mode == CONTINUOUS:
            raise CardError(-200290)
        return done

    def _refuse(self) -> None:
        if self.clock.now_s() < self.faults.refuse_until_s:
            raise CardError(-50103)

    def _reach(self) -> None:
        self._refuse()
        while self.faults.hangs:
            self._resets.wait()
        if self._fault in (-200621, -200290, -201003):
            code = self._fault
            if code != -201003:
                self._fault = 0  # reported once; the next task starts anew
            raise CardError(code)

    def _stop(self, task: VirtualTask) -> None:
        if task.running and (task is self._clock or (task.channel == OUTPUT and task.mode != ON_DEMAND)):
            self._halt()
        task.running = False

    def _halt(self) -> None:
        self._clock = None
        if len(self._programs[-1].samples):
            self._append(Program(self.clock.now_s(), self.last_volts))

    def _append(self, program: Program) -> None:
        self._programs = [*self._programs[1 - MAX_PROGRAMS :], program]
        self.version += 1
