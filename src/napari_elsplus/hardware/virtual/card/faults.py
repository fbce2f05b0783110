"""Faults of the virtual card."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf


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
    host_stalls : bool
        The computer does not refill buffers, so that an output which depends on it underflows.
    """

    refuse_until_s: float = -inf
    clear_errors: int = 0
    reset_to_power_up: bool = True
    reset_s: float = 0.0
    strobe_unwired: bool = False
    reads_back: bool = True
    stuck: bool = False
    hangs: bool = False
    host_stalls: bool = False
