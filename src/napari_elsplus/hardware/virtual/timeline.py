"""Strobes and output voltages as functions of time.

They need no thread of their own, and another process can evaluate the output without a request per sample.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from math import ceil, inf
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Times = NDArray[np.float64]
    Volts = NDArray[np.float64]


class BenchClock:
    """Clock of the bench: the computer's time, or one that only advances when something waits for it.

    Parameters
    ----------
    real_time : bool
        Use `time.perf_counter`, which all processes of a computer share.
    """

    def __init__(self, real_time: bool = True) -> None:
        self.real_time = real_time
        self._now_s = 0.0

    def now_s(self) -> float:
        """Return the time."""
        return time.perf_counter() if self.real_time else self._now_s

    def wait_until(self, time_s: float) -> None:
        """Sleep until a time `time_s`, or advance the clock to it; return at once where it is past."""
        if not self.real_time:
            self._now_s = max(self._now_s, time_s)
        elif (left_s := time_s - time.perf_counter()) > 0:
            time.sleep(left_s)


@dataclass(frozen=True, slots=True)
class StrobeTrain:
    """Pulses on the strobe's line: one every `period_s` from `start_s` to `end_s`, except those `missing`.

    The line falls when a pulse begins, and rises `width_s` later.
    """

    start_s: float
    period_s: float
    end_s: float = inf
    missing: frozenset[int] = frozenset()
    width_s: float = 0.0

    def first_after(self, time_s: float) -> int:
        """Index of the first edge at or after a time in seconds."""
        return max(0, ceil((time_s - self.start_s) / self.period_s - 1e-9))


@dataclass(frozen=True, slots=True)
class Program:
    """Output from `since_s` on: one standing voltage, or bursts of samples started by strobes.

    Parameters
    ----------
    since_s : float
        Beginning; earlier edges do not count.
    resting_v : float
        Voltage before the first burst.
    samples : numpy.ndarray
        Repeated cyclically, `burst` of them after each edge; empty: the resting voltage stays.
    burst : int
        Samples after an edge.
    rate_hz : float
        Samples per second.
    strobe : StrobeTrain, optional
        Edges that start bursts.
    begun : int
        Samples that were put out before `since_s`, whole bursts.
    limit : int, optional
        Samples after which the output stands; None: without end.
    """

    since_s: float
    resting_v: float
    samples: Volts = field(default_factory=lambda: np.zeros(0))
    burst: int = 0
    rate_hz: float = 1.0
    strobe: StrobeTrain | None = None
    begun: int = 0
    limit: int | None = None

    @property
    def begins_s(self) -> float:
        """Time from which the output changes: the first edge, or the beginning without edges."""
        return self.since_s if self.strobe is None else max(self.since_s, self.strobe.start_s)

    def recurs(self, period_s: float) -> bool:
        """Return True if the output, in the end, is the same in every period of `period_s` seconds."""
        if not len(self.samples) or self.strobe is None:
            return True
        one_ramp = self.burst == len(self.samples) and self.burst / self.rate_hz <= period_s and self.limit is None
        endless = self.strobe.end_s == inf and not self.strobe.missing
        return one_ramp and endless and self.strobe.period_s == period_s

    def samples_by(self, times_s: Times) -> NDArray[np.int64]:
        """Count the samples put out by each time.

        An edge that comes during a burst has no effect, as with a counter that is retriggered too soon.
        """
        return self._progress(times_s)[0]

    def volts(self, times_s: Times) -> Volts:
        """Return the voltage at each time."""
        if not len(self.samples):
            return np.full(len(times_s), self.resting_v)
        done = self.samples_by(times_s)
        return np.where(done > self.begun, self.samples[(done - 1) % len(self.samples)], self.resting_v)

    def last_change_s(self, times_s: Times) -> Times:
        """Return when the sample that is out at each time was put out."""
        return self._progress(times_s)[1]

    def _progress(self, times_s: Times) -> tuple[NDArray[np.int64], Times]:
        """Return the samples done by each time, and when the last of them was put out."""
        train = self.strobe
        if train is None or not len(self.samples):
            return np.full(len(times_s), self.begun), np.full(len(times_s), self.since_s)
        first = train.first_after(self.since_s)
        stride = max(1, ceil(self.burst / self.rate_hz / train.period_s - 1e-9))
        detected_by = np.minimum(times_s, train.end_s)
        edge = np.floor((detected_by - train.start_s) / train.period_s + 1e-9).astype(np.int64)
        edge = first + (edge - first) // stride * stride
        count = (edge - first) // stride + 1
        for lost in sorted(train.missing, reverse=True):
            if lost >= first and (lost - first) % stride == 0:
                count -= edge >= lost
                edge = np.where(edge == lost, edge - stride, edge)
        edge_s = train.start_s + edge * train.period_s
        in_burst = np.clip(np.floor((times_s - edge_s) * self.rate_hz + 1e-6).astype(np.int64) + 1, 0, self.burst)
        done = self.begun + np.where(count > 0, (count - 1) * self.burst + in_burst, 0)
        done = done if self.limit is None else np.minimum(done, self.limit)
        return done, np.where(count > 0, edge_s + (in_burst - 1) / self.rate_hz, self.since_s)


def volts_at(programs: Sequence[Program], times_s: Times) -> Volts:
    """Return the voltage at increasing times from successive programs; before the first, that one applies."""
    volts = programs[0].volts(times_s)
    for program in programs[1:]:
        later = times_s >= program.since_s
        if later.any():
            volts[later] = program.volts(times_s[later])
    return volts


def mean_volts(programs: Sequence[Program], starts_s: Times, step_s: float) -> Volts:
    """Return the mean voltage over increasing steps, each shorter than a sample.

    Parameters
    ----------
    programs : sequence of Program
        Oldest first.
    starts_s : numpy.ndarray
        Beginning of each step.
    step_s : float
        Length of a step.
    """
    before, after = volts_at(programs, starts_s + 1e-9), volts_at(programs, starts_s + step_s - 1e-9)
    changed_s = programs[0].last_change_s(starts_s + step_s - 1e-9)
    for program in programs[1:]:
        later = starts_s + step_s >= program.since_s
        if later.any():
            changed_s[later] = np.maximum(program.since_s, program.last_change_s(starts_s[later] + step_s - 1e-9))
    share = np.clip((changed_s - starts_s) / step_s, 0, 1)
    return np.asarray(share * before + (1 - share) * after)
