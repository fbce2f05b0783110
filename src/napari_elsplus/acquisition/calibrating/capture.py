"""Frames for the calibration's steps on a running engine: move the line, wait until it stands, take frames.

Each function streams if nothing streams yet, and leaves the line parked whatever happens.
"""

from __future__ import annotations

import time
from contextlib import contextmanager
from math import sqrt
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.analysis.uncertainty import robust_sigma

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from napari_elsplus.acquisition.engine.engine import Engine
    from napari_elsplus.processing.progress import ProgressWrapper

SETTLED_S: Final = 2e-3
"""After a step of a sweep, a row or two; chosen: twice the period of a galvo of 1 kHz."""
MOVED_S: Final = 8e-3
"""After any other motion of the galvo, over hundreds of rows; derived: a galvo of 500 Hz, damped by 0.3, has then 5e-4
of its way to go."""
SEARCH_VOLTAGES: Final = 61
"""Of the search for the bundle; chosen: a bundle over a thirtieth of the galvo's range is met by two."""
SEARCH_FRAMES: Final = 10
"""Averaged for the dark level of the search; chosen, a third of one frame's noise."""
MAX_LIT: Final = 0.7
"""Part of the search's voltages at which the line may be on the bundle; chosen: the galvo has to clear it."""
MIN_HEIGHT_DN: Final = 2.0
"""Height of the brightest two neighbours above frames without a line, grey levels; chosen, small for a camera."""
MIN_HEIGHT_SIGMAS: Final = 8.0
"""The same in standard deviations of the heights; chosen: two neighbours of noise are together at 2 to 5."""
MIN_LINE_HEIGHT: Final = 0.25
"""Part of the brightest line's height above frames without one from which a line counts as on the bundle; chosen."""


@contextmanager
def streaming(engine: Engine) -> Iterator[None]:
    """Stream with an engine, and park the line afterwards; leave a stream that runs already running."""
    was_live = engine.status().live
    try:
        if not was_live:
            engine.start(scan=False)
        yield
    finally:
        try:
            engine.park()
        finally:
            if not was_live:
                engine.stop()


def settled_frames(engine: Engine, count: int, settled_s: float = MOVED_S) -> NDArray[np.uint8]:
    """Take a count of frames, (count, rows, cols), with a streaming engine that has moved the galvo just now.

    Parameters
    ----------
    engine : Engine
        Streaming.
    count : int
        Number of frames.
    settled_s : float
        Seconds after which the galvo has settled; frames whose exposure begins before are left out.
    """
    return engine.fresh_frames(count, time.perf_counter() + settled_s)


def take_frames(engine: Engine, move: Callable[[], None], count: int) -> NDArray[np.uint8]:
    """Take a count of frames, (count, rows, cols), after the line was moved.

    Parameters
    ----------
    engine : Engine
        Streaming or not.
    move : callable
        Holds the line, parks it, or starts a scan.
    count : int
        Number of frames.
    """
    with streaming(engine):
        move()
        return settled_frames(engine, count)


def take_sweep(engine: Engine, volts: NDArray[np.floating], progress: ProgressWrapper = iter) -> NDArray[np.uint8]:
    """Take one frame, (voltages, rows, cols), of the line held at each voltage.

    Parameters
    ----------
    engine : Engine
        Streaming or not.
    volts : numpy.ndarray
        Voltages, shape (voltages,).
    progress : callable
        Wraps the numbers of the voltages, to display progress, or to cancel.
    """
    with streaming(engine):
        rows, cols = engine.setup.frame_shape
        frames = np.empty((len(volts), rows, cols), np.uint8)
        for number in progress(range(len(volts))):
            engine.hold(float(volts[number]))
            frames[number] = settled_frames(engine, 1, SETTLED_S)[0]
    return frames


def find_span(engine: Engine, progress: ProgressWrapper = iter) -> tuple[float, float]:
    """Find the voltages between which the line stands on the bundle, within the limits of the rig.

    Parameters
    ----------
    engine : Engine
        Streaming or not.
    progress : callable
        Wraps the numbers of the voltages, to display progress, or to cancel.

    Raises
    ------
    MeasurementError
        If no voltage puts a line onto the bundle.
    """
    limits = engine.galvo.limits
    volts = np.linspace(limits.min_v, limits.max_v, SEARCH_VOLTAGES)
    dark = take_frames(engine, engine.park, SEARCH_FRAMES).mean(axis=0)
    heights = _heights(take_sweep(engine, volts, progress), dark)
    seen = lit_voltages(heights)
    if not len(seen):
        raise MeasurementError(
            f"no voltage from {volts[0]:g} to {volts[-1]:g} V puts a line onto the bundle "
            f"(brightest row {heights.max():.1f} grey levels)",
            "is the laser on, and the target fluorescent? widen the mirror's range in the rig's file if it is",
        )
    step = volts[1] - volts[0]
    low, high = volts[seen[0]] - step, volts[seen[-1]] + step
    return max(float(low), limits.min_v), min(float(high), limits.max_v)


def lit_voltages(heights: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the indices of the voltages at which the line is on the bundle; empty where none is, or nearly all are.

    Parameters
    ----------
    heights : numpy.ndarray
        (voltages,) grey level of each frame's brightest row above the dark frame, at evenly spaced voltages; without a
        line it is that of the noise.
    """
    empty = np.empty(0, np.intp)
    without_line = float(np.percentile(heights, 50 * (1 - MAX_LIT)))
    pairs = np.minimum(heights[:-1], heights[1:])  # a bundle is met by two neighbours
    height = float(pairs.max()) - without_line
    noise = float(robust_sigma(np.diff(heights))) / sqrt(2)
    if not height > max(MIN_HEIGHT_DN, MIN_HEIGHT_SIGMAS * noise):
        return empty
    dark = np.flatnonzero(heights - without_line <= MIN_LINE_HEIGHT * height)
    brightest = int(pairs.argmax())
    first = max((int(index) + 1 for index in dark[dark < brightest]), default=0)
    stop = min((int(index) for index in dark[dark > brightest]), default=len(heights))
    return np.arange(first, stop) if stop - first <= MAX_LIT * len(heights) else empty


def _heights(frames: NDArray[np.uint8], dark: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean grey level of each frame's brightest row above the dark frame."""
    dark_rows = dark.mean(axis=1)
    return np.array([float((frame.mean(axis=1) - dark_rows).max()) for frame in frames])
