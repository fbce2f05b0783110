"""Counts while frames stream: frames, latencies, losses by cause, in memory of constant size."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from napari_elsplus.hardware.protocols import FrameInfo

_BINS_PER_MS: Final = 50
"""Bins of 0.02 ms, chosen: a hundredth of the median latency."""
_QUANTILES: Final = (0.5, 0.9, 0.99, 0.999)
_MAX_MS: Final = 2000
"""Latencies from here on share a bin; as long as frames stay in memory."""
_RATE_FRAMES: Final = 120
"""Frames over which the momentary rate is computed; chosen: half a second at 240 Hz."""


@dataclass(frozen=True, slots=True)
class Latency:
    """Milliseconds from the last byte of a frame to its result: median, other percentiles, largest."""

    p50: float = nan
    p90: float = nan
    p99: float = nan
    p999: float = nan
    max: float = nan


class LatencyHistogram:
    """Counts of latencies in bins of 0.02 ms; percentiles are exact to a bin.

    Examples
    --------
    >>> histogram = LatencyHistogram()
    >>> for ms in (1, 2, 3, 4):
    ...     histogram.add(1e-3 * ms)
    >>> histogram.summary().p50, histogram.summary().max
    (2.02, 4.0)
    """

    def __init__(self) -> None:
        self._counts = np.zeros(_MAX_MS * _BINS_PER_MS + 1, np.int64)
        self._largest_ms = 0.0

    def add(self, seconds: float) -> None:
        """Count a frame of a latency in seconds."""
        ms = 1e3 * seconds
        self._counts[min(max(int(ms * _BINS_PER_MS), 0), len(self._counts) - 1)] += 1
        self._largest_ms = max(self._largest_ms, ms)

    def summary(self) -> Latency:
        """Return median, 90th, 99th and 99.9th percentile and maximum; NaN where nothing was counted."""
        total = self._counts.sum()
        if not total:
            return Latency()
        upto = np.cumsum(self._counts)
        below = np.searchsorted(upto, np.multiply(_QUANTILES, total))
        quantiles_ms = np.minimum((below + 1) / _BINS_PER_MS, self._largest_ms)
        p50, p90, p99, p999 = quantiles_ms.tolist()
        return Latency(p50, p90, p99, p999, self._largest_ms)


class Tally:
    """Counts of one run of the stream, kept by the threads that handle the frames.

    Attributes
    ----------
    acquired, processed, recorded : int
        Frames that the camera delivered whole and that went into the stream; that have their result; in the file.
    first_s : float
        Time of the first frame, on the clock of ``time.perf_counter``; NaN before it.
    dropped : Counter
        Frames lost, by cause; a frame may be acquired and yet be lost to one of its consumers.
    latency : LatencyHistogram
        Last byte of a frame to its result.
    """

    def __init__(self) -> None:
        self.acquired = self.processed = self.recorded = 0
        self.first_s = nan
        self.dropped: Counter[str] = Counter()
        self.latency = LatencyHistogram()
        self._numbered_s: deque[tuple[int, float]] = deque(maxlen=_RATE_FRAMES)
        self._last_s = nan
        self._saturated = self._displayed = 0.0

    def arrived(self, info: FrameInfo) -> None:
        """Count a frame that went into the stream, by its `info`."""
        if not self.acquired:
            self.first_s = info.received_s
        self._last_s = info.received_s
        self._numbered_s.append((info.frame_number, info.readout_start_s))
        self.acquired += 1

    def displayed(self, saturated: float) -> None:
        """Count a displayed frame by the share of its pixels that are `saturated`."""
        self._saturated, self._displayed = self._saturated + saturated, self._displayed + 1

    def lost_by_camera(self, known: Mapping[str, int], missing: int) -> None:
        """Set the frames that the camera lost in this run.

        Parameters
        ----------
        known : mapping of str to int
            Frames by the cause that the camera reports.
        missing : int
            Frames that are missing in the camera's numbers; those beyond `known` have no known cause.
        """
        for cause, count in known.items():
            self.skipped(f"camera: {cause}", count)
        self.skipped("camera: missing numbers", max(0, missing - sum(known.values())))

    def skipped(self, cause: str, count: int) -> None:
        """Set the count of frames lost by a cause, which may turn out to be none."""
        if count > 0:
            self.dropped[cause] = count
        elif cause in self.dropped:
            del self.dropped[cause]

    @property
    def saturated(self) -> float:
        """Mean share of saturated pixels in the displayed frames of the run; NaN before the first one."""
        return self._saturated / self._displayed if self._displayed else nan

    @property
    def mean_hz(self) -> float:
        """Frames that arrived per second over the whole run; NaN before the second frame."""
        return (self.acquired - 1) / (self._last_s - self.first_s) if self.acquired > 1 else nan

    @property
    def camera_hz(self) -> float:
        """Frames per second of the camera over the last frames, by its numbers and clock; NaN before the second one.

        Lost frames are counted; frames that wait on their way and arrive in a burst do not change it.
        """
        numbered_s = tuple(self._numbered_s)
        if len(numbered_s) < 2:
            return nan
        (first, since_s), (last, until_s) = numbered_s[0], numbered_s[-1]
        return (last - first) / (until_s - since_s) if until_s > since_s else nan
