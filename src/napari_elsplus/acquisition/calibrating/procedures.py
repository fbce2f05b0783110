"""The calibration's steps on a live rig: move the mirror, wait until it stands, take frames, measure.

Each step streams if nothing streams yet, and leaves the mirror parked whatever happens. The measuring itself is that of
:mod:`napari_elsplus.processing.calibration.calibrate`.
"""

from __future__ import annotations

import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.calibration.calibrate import (
    Background,
    BundlePair,
    SlitOffset,
    locate_pair,
    map_galvo,
    mean_frame,
    measure_background,
    measure_offset,
)
from napari_elsplus.processing.calibration.lag import ScanLag, search_lag
from napari_elsplus.processing.calibration.live_offset import OffsetFollower
from napari_elsplus.processing.images.sectioning import Sectioner, disc

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from napari_elsplus.acquisition.engine.engine import Engine
    from napari_elsplus.processing.calibration.galvo import GalvoMap

    Watch = Callable[[Iterable[int]], Iterable[int]]

BACKGROUND_FRAMES: Final = 50
"""As the paper takes them."""
LINE_FRAMES: Final = 10
BUNDLE_FRAMES: Final = 20
LAG_FRAMES: Final = 4
FOLLOWED_S: Final = 6e-3
"""An offset that is followed more often than 120 times a second tells no hand more, and takes the window's time."""
SETTLED_S: Final = 2e-3
"""A galvo of 1 kHz stands still by then."""


def take_standing(engine: Engine, volts: float, count: int) -> NDArray[np.uint8]:
    """Take frames, (count, rows, cols), of the line standing at a voltage."""
    engine.hold(volts)
    return engine.fresh_frames(count, time.perf_counter() + SETTLED_S)


def take_sweep(engine: Engine, volts: NDArray[np.floating], watch: Watch = iter) -> NDArray[np.uint8]:
    """Take one frame, (voltages, rows, cols), of the line standing at each voltage.

    Parameters
    ----------
    engine : Engine
        Streaming or not.
    volts : numpy.ndarray
        Voltages, shape (voltages,).
    watch : callable
        Wraps the numbers of the voltages, to show how far it is, or to give up.
    """
    with _streaming(engine):
        rows, cols = engine.setup.frame_shape
        frames = np.empty((len(volts), rows, cols), np.uint8)
        for number in watch(range(len(volts))):
            frames[number] = take_standing(engine, float(volts[number]), 1)[0]
    return frames


def take_line(engine: Engine, volts: float, count: int = LINE_FRAMES) -> NDArray[np.uint8]:
    """Take frames, (count, rows, cols), of the line standing near the middle of the bundle."""
    with _streaming(engine):
        return take_standing(engine, volts, count)


def take_parked(engine: Engine, count: int) -> NDArray[np.uint8]:
    """Take frames, (count, rows, cols), without the laser line: the bundle lit from its far end."""
    with _streaming(engine):
        engine.park()
        return engine.fresh_frames(count, time.perf_counter() + SETTLED_S)


def take_scanned(engine: Engine, count: int) -> NDArray[np.uint8]:
    """Take frames, (count, rows, cols), while the mirror scans."""
    with _streaming(engine):
        engine.scan()
        return engine.fresh_frames(count, time.perf_counter() + SETTLED_S)


def offset(
    engine: Engine, volts: float, background: NDArray[np.float32] | None = None, pair: BundlePair | None = None
) -> SlitOffset:
    """Step (i) live, the line held still: :func:`napari_elsplus.processing.calibration.calibrate.measure_offset`."""
    return measure_offset(take_line(engine, volts), background, pair)


def follow_offset(
    engine: Engine,
    volts: float,
    background: NDArray[np.float32] | None,
    tell: Callable[[SlitOffset | MeasurementError], None],
    go_on: Callable[[], bool],
) -> None:
    """Measure the slit offset in frame after frame while the tilt mirror is being turned, the line held at a voltage.

    Parameters
    ----------
    engine : Engine
        Streaming or not.
    volts : float
        Puts the line near the middle of the bundle.
    background : numpy.ndarray, optional
        Mean frame of the dark tube.
    tell : callable
        Gets what each frame shows, or why it shows nothing.
    go_on : callable
        Asked before each frame.
    """
    follower = OffsetFollower(background)
    with _streaming(engine):
        frame = take_standing(engine, volts, 1)[0]
        while go_on():
            next_s = time.perf_counter() + FOLLOWED_S
            try:
                tell(follower.measure(frame))
            except MeasurementError as error:
                tell(error)
            time.sleep(max(next_s - time.perf_counter(), 0.0))
            frame = engine.fresh_frames(1)[0]


def sweep(
    engine: Engine,
    volts: NDArray[np.floating],
    background: NDArray[np.float32] | None = None,
    pair: BundlePair | None = None,
    watch: Watch = iter,
    watch_fit: Watch = iter,
) -> GalvoMap:
    """Step (ii) live: a sweep of voltages; see :func:`napari_elsplus.processing.calibration.calibrate.map_galvo`."""
    return map_galvo(take_sweep(engine, volts, watch), volts, background, pair, watch_fit)


def bundle(engine: Engine) -> BundlePair:
    """Step (iii) live, lit from the far end: :func:`napari_elsplus.processing.calibration.calibrate.locate_pair`."""
    return locate_pair(take_parked(engine, BUNDLE_FRAMES))


def background(engine: Engine) -> Background:
    """In the dark tube, live: :func:`napari_elsplus.processing.calibration.calibrate.measure_background`."""
    return measure_background(take_scanned(engine, BACKGROUND_FRAMES))


def lag(engine: Engine, watch: Watch = iter) -> ScanLag:
    """Scan at full speed with one lead after the other, and find the lead that puts most light through the slit.

    Parameters
    ----------
    engine : Engine
        With a calibration that knows galvo and bundle; the probe on something that fluoresces.
    watch : callable
        Wraps the numbers of the leads, to show how far it is, or to give up.

    Returns
    -------
    ScanLag
        The lag with its uncertainty, and what was measured.

    Raises
    ------
    MeasurementError
        If the signal has no maximum.
    """
    calibration = engine.calibration
    if calibration is not None:
        calibration.require("galvo", "bundle")
    with _streaming(engine):
        return search_lag(_signal_of_leads(engine), engine.setup.line_period_s, watch)


def _signal_of_leads(engine: Engine) -> Callable[[float], float]:
    """Make what scans with a lead, and returns the mean confocal grey level."""
    engine.scan()
    calibration = engine.calibration
    assert calibration is not None
    assert calibration.galvo is not None
    known, galvo = calibration, calibration.galvo
    sectioner = Sectioner(known, engine.setup.frame_shape)
    inside = disc(sectioner.side, 0.9 * sectioner.diameter_px)

    def signal_at(lead_s: float) -> float:
        engine.scan(known.model_copy(update={"galvo": galvo.model_copy(update={"lag_s": lead_s})}))
        frames = engine.fresh_frames(LAG_FRAMES, time.perf_counter() + SETTLED_S)
        return float(sectioner.ls(mean_frame(frames))[inside].mean())

    return signal_at


@contextmanager
def _streaming(engine: Engine) -> Iterator[None]:
    was_live = engine.status().live
    try:
        if not was_live:
            engine.start()
        yield
    finally:
        engine.park()
        if not was_live:
            engine.stop()
