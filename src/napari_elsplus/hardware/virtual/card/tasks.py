"""DAQmx tasks of the virtual card: what may be configured when, and what is refused when a task starts.

After NI's help, "Task State Model" and "Buffering", and NIDAQmx.h; codes and texts are NI's.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

ON_DEMAND, CONTINUOUS, FINITE = 10390, 10123, 10178
"""Sample modes."""
RISING, FALLING = 10280, 10171
"""Edges."""
REGENERATE, DO_NOT_REGENERATE = 10097, 10158
"""Regeneration modes."""
ON_BOARD_ONLY, REGENERATION, RETRIGGERABLE = 0x183A, 0x1453, 0x190F
"""Attributes: use only on-board memory; regeneration mode; start trigger is retriggerable."""
MAX_RATE_HZ: Final = 250_000.0
"""Updates per second of one output of a USB-621x (NI 371931)."""
ON_BOARD_SAMPLES: Final = 8191
"""Samples of the output's on-board memory (NI 371931)."""
MESSAGES: Final = {
    -50103: "The specified resource is reserved. The operation could not be completed as specified.",
    -89120: "Source terminal to be routed could not be found on the device.",
    -200077: "Requested value is not a supported value for this property.",
    -200088: "Task specified is invalid or does not exist.",
    -200170: "Physical channel specified does not exist on this device.",
    -200220: "Device identifier is invalid.",
    -200262: "Specified sample mode is not supported with a start trigger: timing is on demand.",
    -200290: "The generation has stopped to prevent the regeneration of old samples.",
    -200295: "Writing data after the task has been started is not supported when only on-board memory is used.",
    -200341: "Onboard memory is too small for the data.",
    -200450: "Specified property cannot be set while the task is running.",
    -200452: "Specified property is not supported by the device or is not applicable to the task.",
    -200478: "Specified operation cannot be performed when there are no channels in the task.",
    -200479: "Specified operation cannot be performed while the task is running.",
    -200539: "Writing multiple samples per channel is not supported for on-demand timing.",
    -200561: "Attempted writing analog data that is too large or too small.",
    -200621: "Onboard device memory underflow.",
    -200656: "Regeneration must be allowed when only on-board memory is used.",
    -200846: "Write cannot be performed when auto start is false, the task is not running, and timing is on demand.",
    -200858: "Write to the task before it is started: its timing is a sample clock.",
    -201003: "Device cannot be accessed. It may have been disconnected.",
}
"""NI's text of each status code, shortened."""


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
    """``output``, ``counter``, ``input`` or ``line``."""
    channel: str = ""
    """Physical channel without the device, which the task reserves while it runs."""
    low_v: float = -10.0
    high_v: float = 10.0
    pulse_hz: float = 0.0
    mode: int = ON_DEMAND
    rate_hz: float = 0.0
    samples: int = 1
    clock: str = ""
    trigger: str = ""
    edge: int = RISING
    retriggerable: bool = False
    regenerates: bool = True
    on_board_only: bool = False
    volts: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    running: bool = False
    since_s: float = 0.0
    """When it was started, on the bench's clock."""

    def add(self, kind: str, channel: str) -> None:
        """Add a channel.

        Parameters
        ----------
        kind : str
            What it is.
        channel : str
            Its name without the device.
        """
        self._refuse_running(-200479)
        self.kind, self.channel = kind, channel

    def time_by_clock(self, source: str, rate_hz: float, mode: int, samples: int) -> None:
        """Time by a sample clock.

        Parameters
        ----------
        source : str
            Terminal; empty: the on-board clock.
        rate_hz : float
            Samples per second, or the largest rate that is expected of the source.
        mode, samples : int
            Finite or continuous; number of samples, or size of the buffer.
        """
        self._refuse_unprepared()
        if not 0 < rate_hz <= MAX_RATE_HZ * (1 + 1e-9):
            raise CardError(-200077)
        self.clock, self.rate_hz, self.mode, self.samples = source or "OnboardClock", rate_hz, mode, samples

    def time_implicitly(self, mode: int, samples: int) -> None:
        """Time pulses by their own frequency: `mode` finite or continuous, number of `samples`."""
        self._refuse_unprepared()
        if self.kind != "counter":
            raise CardError(-200452)
        self.mode, self.samples = mode, samples

    def start_by_edge(self, source: str, edge: int) -> None:
        """Start at an `edge` on the `source` terminal."""
        self._refuse_unprepared()
        if edge not in (RISING, FALLING):
            raise CardError(-200077)
        self.trigger, self.edge = source, edge

    def set_attribute(self, attribute: int, value: int) -> None:
        """Set an attribute by its number to a value."""
        self._refuse_running(-200450)
        if attribute == RETRIGGERABLE and self.trigger:
            self.retriggerable = bool(value)
        elif attribute == ON_BOARD_ONLY and self.kind == "output":
            self.on_board_only = bool(value)
        elif attribute == REGENERATION and value in (REGENERATE, DO_NOT_REGENERATE):
            self.regenerates = value == REGENERATE
        else:
            raise CardError(-200452)

    def write(self, volts: NDArray[np.float64], auto_start: bool) -> None:
        """Write samples.

        Parameters
        ----------
        volts : numpy.ndarray
            Samples.
        auto_start : bool
            The task is started, if it does not run.
        """
        if self.kind != "output":
            raise CardError(-200478 if not self.kind else -200452)
        if not (np.all(volts >= self.low_v) and np.all(volts <= self.high_v)):
            raise CardError(-200561)
        if self.mode == ON_DEMAND:
            if len(volts) > 1:
                raise CardError(-200539)
            if not (auto_start or self.running):
                raise CardError(-200846)
        elif self.running and self.on_board_only:
            raise CardError(-200295)
        self.volts = np.array(volts, np.float64)

    def verify(self, terminals: Iterable[str]) -> None:
        """Refuse a task that cannot start: with no channel, no data, or terminals that the card does not have."""
        if not self.kind:
            raise CardError(-200478)
        if {self.clock, self.trigger} - {*terminals, "", "OnboardClock"}:
            raise CardError(-89120)
        if self.kind != "output":
            return
        if self.mode == ON_DEMAND:
            if self.trigger:
                raise CardError(-200262)
            return
        if not len(self.volts):
            raise CardError(-200858)
        if self.on_board_only and not self.regenerates:
            raise CardError(-200656)
        if self.on_board_only and len(self.volts) > ON_BOARD_SAMPLES:
            raise CardError(-200341)

    @property
    def limit(self) -> int | None:
        """Samples after which the output stands; None: without end."""
        if self.mode == FINITE:
            return self.samples
        return None if self.regenerates else len(self.volts)

    def _refuse_unprepared(self) -> None:
        self._refuse_running(-200479)
        if not self.kind:
            raise CardError(-200478)

    def _refuse_running(self, code: int) -> None:
        if self.running:
            raise CardError(code)
