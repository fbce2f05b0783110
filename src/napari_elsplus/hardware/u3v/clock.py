"""The camera's clock against the computer's, by the timestamp latch (GenCP 1.1, ABRM 1F0h and 1F8h)."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from napari_elsplus.hardware.u3v.control import RegisterError

if TYPE_CHECKING:
    from napari_elsplus.hardware.u3v.control import Control

TIMESTAMP, LATCH, INCREMENT = 0x01F0, 0x01F8, 0x01FC
"""Bootstrap registers: latched time, latch, and nanoseconds per tick of the internal clock."""
NANOSECOND: Final = 1e-9
"""Seconds per tick that the standard requires."""
BASELINE_S: Final = 0.02
"""Seconds between the latches that measure a tick; chosen: a hundred times a register access."""
LONG_BASELINE_S: Final = 0.5
"""The same where the first shows no tick that is stated: a busy computer, or a tick that no register states; chosen: a
register access is then a thousandth of it."""
TOLERANCE: Final = 0.2
"""Relative error by which a measured tick may differ from a stated one; chosen: cameras' ticks differ by factors."""
LATCHES: Final = 3
"""Latches of which the tightest counts; chosen: an access that was held up, or sent again, does not count."""


class CameraClock:
    """Seconds per tick, and zero, of a camera's clock.

    Parameters
    ----------
    control : Control
        Control channel of the camera.

    Attributes
    ----------
    tick_s : float
        Seconds per tick, measured: 1 ns where the camera keeps to the standard.
    """

    def __init__(self, control: Control) -> None:
        self._control = control
        self._runs, self.tick_s = True, NANOSECOND
        try:
            self.tick_s = self._measure_tick()
        except RegisterError:
            self._runs = False

    def zero_s(self) -> float | None:
        """Return when the camera's clock was at zero, on the clock of `time.perf_counter`; None where it has none.

        Never later than the truth, and earlier by the time of one register access.
        """
        if not self._runs:
            return None
        return max(before_s - ticks * self.tick_s for before_s, ticks in (self._latch() for _ in range(LATCHES)))

    def _measure_tick(self) -> float:
        stated = (NANOSECOND, self._control.read_number(INCREMENT, 8) * NANOSECOND)
        for baseline_s in (BASELINE_S, LONG_BASELINE_S):
            tick_s = self._tick(baseline_s)
            near = [known for known in stated if abs(known - tick_s) < TOLERANCE * tick_s]
            if near:
                return near[0]
        return tick_s

    def _tick(self, baseline_s: float) -> float:
        """Return seconds per tick; a clock that stands counts as none."""
        begin_s, first = self._latch()
        time.sleep(baseline_s)
        end_s, last = self._latch()
        self._runs = last > first
        return (end_s - begin_s) / (last - first) if self._runs else NANOSECOND

    def _latch(self) -> tuple[float, int]:
        """Return the time before the latch, and the camera's time in ticks."""
        before_s = time.perf_counter()
        self._control.write_number(LATCH, 1)
        return before_s, self._control.read_number(TIMESTAMP, 8)
