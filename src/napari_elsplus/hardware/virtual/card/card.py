"""The virtual card: DAQmx tasks on one analog output and one counter, as far as a line scan needs them."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.hardware.virtual.timeline import BenchClock, Program, StrobeTrain, volts_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

POWER_ON_V: Final = 0.0
"""Volts of the output when the card is switched on."""
MAX_PROGRAMS: Final = 64
"""Programs kept; chosen: more than a frame of holds, 1 ms each."""
ON_DEMAND, CONTINUOUS, FINITE = 10390, 10123, 10178
"""Sample modes of NIDAQmx.h."""
MESSAGES: Final = {
    -50103: "The specified resource is reserved. The operation could not be completed as specified.",
    -200088: "Task specified is invalid or does not exist.",
    -200170: "Physical channel specified does not exist on this device.",
    -200220: "Device identifier is invalid.",
    -200077: "Requested value is not a supported value for this property.",
    -200290: "The generation has stopped to prevent the regeneration of old samples.",
    -200479: "Specified operation cannot be performed while the task is running.",
    -200478: "Specified operation cannot be performed when there are no channels in the task.",
    -200561: "Attempted writing analog data that is too large or too small.",
    -200621: "Onboard device memory underflow.",
    -201003: "Device cannot be accessed. It may have been disconnected.",
}
"""NI's text of each status code."""


class CardError(Exception):
    """A DAQmx status code, as the driver would return it."""

    def __init__(self, code: int) -> None:
        super().__init__(MESSAGES.get(code, "unknown"))
        self.code = code


@dataclass
class VirtualTask:
    """One DAQmx task."""

    name: str
    kind: str = ""
    """``output``, ``counter``, ``input`` or ``line``: what the task reserves while it runs."""
    low_v: float = -10.0
    high_v: float = 10.0
    mode: int = ON_DEMAND
    rate_hz: float = 0.0
    samples: int = 1
    clock: str = ""
    trigger: str = ""
    retriggerable: bool = False
    volts: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    running: bool = False


@dataclass(frozen=True)
class CardFaults:
    """Faults to inject, and how the card behaves on a reset.

    Parameters
    ----------
    refuse_until_s : float
        Every call of the driver is refused (-50103) until then, on the bench's clock.
    clear_errors : int
        So many calls of ClearTask fail, and leave their task running.
    reset_to_power_up : bool
        A reset sets the output to `POWER_ON_V`, as on NI's M, C and X Series; False: it keeps its voltage, as on E and
        S Series.
    reset_s : float
        Seconds that a reset takes.
    strobe_unwired : bool
        The camera's strobe is not wired to the card.
    reads_back : bool
        The card has an internal channel that measures its output.
    stuck : bool
        Writes succeed and leave the output as it is.
    hangs : bool
        Calls on tasks do not return until a reset aborts them.
    """

    refuse_until_s: float = -np.inf
    clear_errors: int = 0
    reset_to_power_up: bool = True
    reset_s: float = 0.0
    strobe_unwired: bool = False
    reads_back: bool = True
    stuck: bool = False
    hangs: bool = False


class VirtualCard:
    """A card with an analog output and a counter, one of its terminals wired to the strobe.

    Parameters
    ----------
    clock : BenchClock, optional
        Clock of the bench; that of the computer by default.
    device : str
        Name of the card.
    """

    def __init__(self, clock: BenchClock | None = None, device: str = "Dev1") -> None:
        self.clock, self.device = clock or BenchClock(), device
        self._lock = threading.RLock()
        self._resets = threading.Condition(self._lock)
        self.faults = CardFaults()
        self.laser_on = False
        """Level of the digital line to the laser."""
        self._tasks: dict[int, VirtualTask] = {}
        self._last_handle = 0
        self._strobe: StrobeTrain | None = None
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
            running = self._programs[-1]
            if not len(running.samples):
                return
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

    def add_output(self, handle: int, channel: str, low_v: float, high_v: float) -> None:
        """Add the analog output to a task.

        Parameters
        ----------
        handle : int
            The task.
        channel : str
            ``device/ao0``.
        low_v, high_v : float
            Range in volts.
        """
        self._find(channel, "ao0")
        if not -10 <= low_v < high_v <= 10:
            raise CardError(-200077)
        task = self.task(handle)
        task.kind, task.low_v, task.high_v = "output", low_v, high_v

    def add_counter(self, handle: int, channel: str, rate_hz: float) -> None:
        """Add the counter's pulses to a task.

        Parameters
        ----------
        handle : int
            The task.
        channel : str
            ``device/ctr0``.
        rate_hz : float
            Pulses per second.
        """
        self._find(channel, "ctr0")
        task = self.task(handle)
        task.kind, task.rate_hz = "counter", rate_hz

    def add_input(self, handle: int, channel: str) -> None:
        """Add the input that measures the output to a task.

        Parameters
        ----------
        handle : int
            The task.
        channel : str
            ``device/_ao0_vs_aognd``.
        """
        self._find(channel, "_ao0_vs_aognd" if self.faults.reads_back else "")
        self.task(handle).kind = "input"

    def add_line(self, handle: int, line: str) -> None:
        """Add the digital line to the laser to a task.

        Parameters
        ----------
        handle : int
            The task.
        line : str
            ``device/port0/line0``.
        """
        self._find(line, "port0/line0")
        self.task(handle).kind = "line"

    def start_task(self, handle: int) -> None:
        """Start the task of a handle; bursts begin once both the output and its clock run."""
        with self._lock:
            task = self.task(handle)
            self._reach()
            if not task.kind:
                raise CardError(-200478)
            busy = any(t.running and t.kind == task.kind for t in self._tasks.values() if t is not task)
            if busy or self._fault == -50103:
                raise CardError(-50103)
            task.running = True
            clock = next(
                (t for t in self._tasks.values() if t.running and t.kind == "counter" and t.retriggerable), None
            )
            ramp = next(
                (t for t in self._tasks.values() if t.running and t.kind == "output" and t.mode == CONTINUOUS), None
            )
            if clock and ramp and ramp.clock.endswith("InternalOutput"):
                now, resting = self.clock.now_s(), self.last_volts
                self._append(Program(now, resting, ramp.volts.copy(), clock.samples, clock.rate_hz, self._strobe))

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
            if not (np.all(volts >= task.low_v) and np.all(volts <= task.high_v)):
                raise CardError(-200561)
            task.volts = np.array(volts, np.float64)
            if auto_start and not task.running:
                self.start_task(handle)
            if task.mode == ON_DEMAND and task.running and not self.faults.stuck:
                self._append(Program(self.clock.now_s(), float(task.volts[-1])))
            return len(volts)

    def is_done(self, handle: int) -> bool:
        """Return True if the task of a handle has ended; raise the status code that ended it."""
        with self._lock:
            self._reach()
            task = self.task(handle)
            return not task.running or task.mode == ON_DEMAND

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
            self.task(handle)
            self._reach()
            return int(self._programs[-1].samples_by(np.array([self.clock.now_s()]))[0])

    def reset(self, device: str) -> None:
        """Abort every task of the device; output and line go to their power-up state, or the output stays."""
        with self._lock:
            self._find(device, "")
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

    def _find(self, channel: str, wanted: str) -> None:
        device, _, terminal = channel.strip("/").partition("/")
        if device != self.device:
            raise CardError(-200220)
        if terminal != wanted:
            raise CardError(-200170)

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
        if task.running and (task.kind == "counter" or task.mode == CONTINUOUS):
            self._halt()
        task.running = False

    def _halt(self) -> None:
        if len(self._programs[-1].samples):
            self._append(Program(self.clock.now_s(), self.last_volts))

    def _append(self, program: Program) -> None:
        self._programs = [*self._programs[1 - MAX_PROGRAMS :], program]
        self.version += 1
