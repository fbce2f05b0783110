"""The calibration's steps on a running engine: one, the slit offset again and again, or all of them in a safe order."""

from __future__ import annotations

import time
from functools import partial
from math import ceil
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.acquisition.calibrating.capture import (
    MOVED_S,
    find_span,
    settled_frames,
    streaming,
    take_frames,
    take_sweep,
)
from napari_elsplus.errors import MeasurementError
from napari_elsplus.hardware.priority import ordinary_priority
from napari_elsplus.hardware.scan.following import drive_of, highest_rate_hz
from napari_elsplus.instrument.optics import preset
from napari_elsplus.processing.calibration.draft import Draft, Setup
from napari_elsplus.processing.calibration.slit_offset import OffsetFollower
from napari_elsplus.processing.calibration.step import Capture, StepInputs
from napari_elsplus.processing.calibration.steps import calibration_steps
from napari_elsplus.processing.progress import without_display

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.acquisition.engine.engine import Engine
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.scan.galvo_response import Drive
    from napari_elsplus.processing.calibration.slit_offset import SlitOffset
    from napari_elsplus.processing.calibration.step import CalibrationStep, Target
    from napari_elsplus.processing.progress import Progress, ProgressWrapper


SWEEP_VOLTAGES: Final = 400
"""Of the galvo map; as many as the paper takes."""
FOLLOW_INTERVAL_S: Final = 6e-3
"""Shortest time from one offset to the next; chosen: 120 Hz needs no more, and leaves time to the window."""
HELD_SHARE: Final = 0.8
"""Share of the rig's hold limit for which the line is held at a time; chosen: the limit itself is a fault."""
REST_S: Final = 3.0
"""Seconds for which the line is parked between holds; chosen: a sixth of the time for the target to recover."""
SWEEP_REACH: Final = 0.55
"""Of the bundle's diameter to either side of its centre; chosen: a tenth beyond the rim."""
MEASURED_FIRST: Final = ("pair", "offset", "galvo")
"""Keys in the order of a whole calibration: the pair gives the columns at which offset and galvo map are taken."""


def unsteady_ramps(frame_period_s: float) -> int:
    """Return the number of ramps, each a `frame_period_s` long, after which a galvo repeats its motion.

    The first begins at rest, and what differs then decays as after any motion.

    Examples
    --------
    >>> [unsteady_ramps(1 / rate_hz) for rate_hz in (240, 230, 120)]
    [2, 2, 1]
    """
    return ceil(MOVED_S / frame_period_s)


class TrialScans:
    """Scans by trial calibrations; see :class:`napari_elsplus.processing.calibration.scan.learned_ramp.Scans`.

    Parameters
    ----------
    engine : Engine
        Streaming.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def frames(self, calibration: Calibration, count: int) -> NDArray[np.uint8]:
        """Take a count of frames (count, rows, cols) by a calibration, without the ramps before its motion repeats."""
        self._engine.scan(calibration)
        period_s = self._engine.galvo.timing.frame_period_s
        return settled_frames(self._engine, count, unsteady_ramps(period_s) * period_s)

    def drive(self, calibration: Calibration) -> Drive:
        """Return the drive of a scan by a calibration; raise an InputError if the galvo's limits do not allow it."""
        calibration.require("galvo", "bundle")
        waveform = self._engine.galvo.waveform(calibration)
        assert waveform is not None
        return drive_of(waveform, calibration.measured_galvo, self._engine.galvo.timing)

    def highest_rate_hz(self, calibration: Calibration) -> float:
        """Return the highest frame rate at which the galvo's limits allow a scan by a calibration; 0 for none."""
        return highest_rate_hz(calibration, self._engine.galvo.timing, self._engine.galvo.limits)


def engine_setup(engine: Engine) -> Setup:
    """Return the settings with which an engine takes frames now."""
    setup = engine.setup
    um_per_px = preset(setup.settings.preset).optics.um_per_px
    return Setup(setup.frame, setup.acquired_with, setup.line_period_s, setup.line_periods_per_frame, um_per_px)


class LiveMeasurement:
    """Measures calibration steps on a running engine; its target must lie before the probe.

    Parameters
    ----------
    engine : Engine
        Configured.
    voltages : int
        Of a sweep.
    progress : Progress
        Wraps the numbers of each part's loop, to display progress, or to cancel.
    """

    def __init__(self, engine: Engine, voltages: int = SWEEP_VOLTAGES, progress: Progress = without_display) -> None:
        self._engine, self._voltages, self._progress = engine, voltages, progress
        self._found_span: tuple[float, float] | None = None

    def measure(self, step: CalibrationStep[Any], draft: Draft) -> Any:
        """Measure a step with what a draft contains; the line is parked in the end.

        Parameters
        ----------
        step : CalibrationStep
            With its target before the probe. A line that scans does so by the draft's calibration, which is activated.
        draft : Draft
            Results so far.

        Returns
        -------
        object
            The step's result.

        Raises
        ------
        MeasurementError
            If the step finds nothing.
        DeviceError
            If camera or galvo fail.
        """
        engine, setup, progress = self._engine, engine_setup(self._engine), self._progress_of(step.title)
        if step.capture in {Capture.SCANNING, Capture.LEADS}:
            draft.calibration.require("galvo", "bundle")
            engine.use(draft.calibration, scan=False)
        move: Callable[[], None]
        match step.capture:
            case Capture.HELD:
                move = partial(engine.hold, self.middle_v(draft))
            case Capture.PARKED:
                move = engine.park
            case Capture.SCANNING:
                move = engine.scan
            case Capture.SWEEP:
                volts = np.linspace(*self._span(draft), self._voltages)
                frames = take_sweep(engine, volts, progress)
                inputs = StepInputs(frames, setup, volts, progress=self._progress_of(f"{step.title}: fit"))
                return step.estimate(inputs, draft)
            case Capture.LEADS:
                with streaming(engine):
                    return step.estimate(StepInputs((), setup, scans=TrialScans(engine), progress=progress), draft)
        return step.estimate(StepInputs(take_frames(engine, move, step.frames), setup), draft)

    def middle_v(self, draft: Draft) -> float:
        """Return the voltage that puts the line onto the middle of the bundle; searched if no draft contains it."""
        known = draft.calibration
        if known.galvo is not None and known.bundle is not None:
            return float(known.galvo.volts(known.bundle.confocal_centre[0]))
        if draft.galvo is not None:
            return float(np.mean(draft.galvo.volts[draft.galvo.used]))
        return sum(self._search()) / 2

    def _span(self, draft: Draft) -> tuple[float, float]:
        """Return the voltages that sweep the line over the whole bundle, within the limits of the rig."""
        known = draft.calibration
        if known.galvo is None or known.bundle is None:
            return self._search()
        centre, reach = known.bundle.confocal_centre[0], SWEEP_REACH * known.bundle.diameter_px
        limits, ends = self._engine.galvo.limits, [known.galvo.volts(row) for row in (centre - reach, centre + reach)]
        return max(float(min(ends)), limits.min_v), min(float(max(ends)), limits.max_v)

    def _progress_of(self, part: str) -> ProgressWrapper:
        return lambda numbers: self._progress(numbers, part)

    def _search(self) -> tuple[float, float]:
        if self._found_span is None:
            self._found_span = find_span(self._engine, self._progress_of("search for the bundle"))
        return self._found_span


def follow_offset(
    engine: Engine,
    draft: Draft,
    publish: Callable[[SlitOffset | MeasurementError], None],
    keep_on: Callable[[], bool],
    report: Callable[[str, float, float], None] = lambda _text, _done_s, _total_s: None,
) -> None:
    """Measure the slit offset in frame after frame while the tilt mirror is being turned, without end.

    The line is held; before the rig's hold limit it is parked for a rest, and held again.

    Parameters
    ----------
    engine : Engine
        Streaming or not.
    draft : Draft
        Results so far; the place of the line and the background are taken from it.
    publish : callable
        Receives each offset, or the reason why there is none.
    keep_on : callable
        Called before each frame; False ends the measurement.
    report : callable
        Receives the state of the line with the seconds that are left, the seconds passed, and their total.
    """
    volts = LiveMeasurement(engine).middle_v(draft)
    follower = OffsetFollower(draft.calibration.background)
    limit_s = engine.galvo.hold_limit_s
    held_s = HELD_SHARE * limit_s
    with streaming(engine):
        while keep_on():
            engine.hold(volts)
            begun_s = time.perf_counter()
            frame = settled_frames(engine, 1)[0]
            while keep_on() and (passed_s := time.perf_counter() - begun_s) < held_s:
                report(_held_text(held_s - passed_s, limit_s), passed_s, held_s)
                next_s = time.perf_counter() + FOLLOW_INTERVAL_S
                try:
                    publish(follower.measure(frame))
                except MeasurementError as error:
                    publish(error)
                time.sleep(max(next_s - time.perf_counter(), 0.0))
                frame = engine.fresh_frames(1)[0]
            engine.park()
            begun_s = time.perf_counter()
            while keep_on() and (passed_s := time.perf_counter() - begun_s) < REST_S:
                report(f"line parked; held again in {REST_S - passed_s:.0f} s", passed_s, REST_S)
                time.sleep(FOLLOW_INTERVAL_S)


def _held_text(left_s: float, limit_s: float) -> str:
    return f"line held; parks in {left_s:.0f} s for {REST_S:g} s (hold limit {limit_s:g} s)"


@ordinary_priority()
def calibrate_rig(
    engine: Engine,
    prepare: Callable[[Target], None],
    *,
    voltages: int = SWEEP_VOLTAGES,
    bundle_um: float | None = None,
    progress: Progress = without_display,
) -> Draft:
    """Calibrate a rig from nothing, with every step that is not optional, and activate the result.

    This thread computes at ordinary priority meanwhile, so that calls to the card return in time.

    Parameters
    ----------
    engine : Engine
        Configured.
    prepare : callable
        Receives a target, and returns when it lies before the probe.
    voltages : int
        Of the sweep.
    bundle_um : float, optional
        Diameter of the bundle's image in micrometres; without it the calibration has no micrometres.
    progress : Progress
        Wraps the numbers of each part's loop, to display progress, or to cancel.

    Returns
    -------
    Draft
        The steps' results, and the complete calibration made of them.

    Raises
    ------
    MeasurementError
        If a step finds nothing; the calibration before stays active.
    DeviceError
        If camera or galvo fail.
    """
    before, scanned = engine.calibration, engine.galvo.scanning
    placed, draft = None, Draft().with_bundle_um(bundle_um)
    measurement = LiveMeasurement(engine, voltages, progress)
    engine.use(None)
    try:
        for step in calibration_steps(first=MEASURED_FIRST):
            if step.optional:
                continue
            if step.target is not placed:
                prepare(step.target)
                placed = step.target
            draft = step.accept(draft, measurement.measure(step, draft), engine_setup(engine))
        engine.use(draft.calibration)
    except BaseException:
        engine.use(before, scan=scanned)
        raise
    return draft
