"""What is counted while frames stream: how many, how late, how many lost and why. Memory does not grow."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

import numpy as np

_BINS_PER_MS: Final = 50
_LONGEST_MS: Final = 2000


@dataclass(frozen=True, slots=True)
class Latency:
    """Milliseconds from the last byte of a frame to its result: median, 99th percentile, largest."""

    p50: float
    p99: float
    max: float


class LatencyHistogram:
    """Counts of latencies in bins of 0.02 ms; percentiles are exact to a bin.

    Examples
    --------
    >>> histogram = LatencyHistogram()
    >>> for ms in (1, 2, 3, 4):
    ...     histogram.add(1e-3 * ms)
    >>> histogram.summary().max
    4.0
    """

    def __init__(self) -> None:
        self._counts = np.zeros(_LONGEST_MS * _BINS_PER_MS + 1, np.int64)
        self._largest_ms = 0.0

    def add(self, seconds: float) -> None:
        """Count one frame."""
        ms = 1e3 * seconds
        self._counts[min(max(int(ms * _BINS_PER_MS), 0), len(self._counts) - 1)] += 1
        self._largest_ms = max(self._largest_ms, ms)

    def summary(self) -> Latency:
        """Median, 99th percentile and maximum; NaN where nothing was counted."""
        total = self._counts.sum()
        if not total:
            return Latency(np.nan, np.nan, np.nan)
        upto = np.cumsum(self._counts)
        p50, p99 = (float(np.searchsorted(upto, share * total) + 1) / _BINS_PER_MS for share in (0.5, 0.99))
        return Latency(min(p50, self._largest_ms), min(p99, self._largest_ms), self._largest_ms)

    def counts(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower edges in milliseconds and counts of the bins that are not empty."""
        filled = np.flatnonzero(self._counts)
        return filled / _BINS_PER_MS, self._counts[filled]


@dataclass(slots=True)
class Tally:
    """Frames of one run of the stream.

    Parameters
    ----------
    acquired, processed, recorded : int
        Frames that the camera delivered whole, that have their result, that are in the file.
    dropped : Counter
        Frames lost, by cause; a frame may be acquired and yet be lost to one of its consumers.
    """

    acquired: int = 0
    processed: int = 0
    recorded: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    latency: LatencyHistogram = field(default_factory=LatencyHistogram)
