"""Measurements that the Calibration panel runs in a thread: a step live or from a file, or the offset repeatedly."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter, sleep
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus._view import prepare_shapes
from napari_elsplus.acquisition.link.client import followed_offsets
from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.io import open_recording, read_volts, volts_beside
from napari_elsplus.processing.calibration.draft import setup_of
from napari_elsplus.processing.calibration.step import Capture, StepInputs
from napari_elsplus.processing.calibration.steps import OFFSET, PAIR, find_step
from napari_elsplus.viewing.calibration_script import MeasurementSource
from napari_elsplus.widgets.calibration.session import ShownResult
from napari_elsplus.workflows.calibration_report.plots import picture

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.acquisition.link.client import EngineClient
    from napari_elsplus.processing.calibration.draft import Draft, Setup
    from napari_elsplus.processing.calibration.step import CalibrationStep
    from napari_elsplus.processing.images.sectioning import Frames
    from napari_elsplus.processing.progress import ProgressWrapper
    from napari_elsplus.viewing.stack import Stack

READING_INTERVAL_S: Final = 0.04
"""Between displayed offsets; chosen: 25 a second look continuous."""


def measure_live(client: EngineClient, draft: Draft, target_um: float, source: MeasurementSource) -> ShownResult:
    """Measure a step on the rig.

    Parameters
    ----------
    client : EngineClient
        Of the connected rig.
    draft : Draft
        Results accepted so far.
    target_um : float
        Wanted slit offset in micrometres.
    source : MeasurementSource
        Names the step, and the number of voltages of a sweep.

    Raises
    ------
    MeasurementError
        If the step finds nothing.
    InputError
        If it was cancelled.
    DeviceError
        If camera or galvo fail.
    """
    step, setup = find_step(source.step), client.setup().result()
    found = client.measure_step(step, draft, source.voltages).result()
    return _shown(step, found, draft, setup, target_um, source)


def recorded_source(step: CalibrationStep[Any], path: Path, volts: Path | None) -> MeasurementSource:
    """Return the source of a step's recorded frames.

    Parameters
    ----------
    step : CalibrationStep
        The step.
    path : pathlib.Path
        The recording.
    volts : pathlib.Path or None
        Table of a sweep's voltages; by default the one beside the recording.
    """
    if volts is None and step.capture is Capture.SWEEP:
        volts = volts_beside(path)
    return MeasurementSource(step.key, path, volts)


def stack_source(step: CalibrationStep[Any], stack: Stack) -> MeasurementSource:
    """Return the source of a `step` measured from a layer's `stack`: its recording, or the layer's name."""
    path = stack.recording.path if stack.recording is not None else None
    return MeasurementSource(step.key, path, layer="" if path else stack.name)


def measure_recorded(
    source: MeasurementSource, draft: Draft, target_um: float, progress: ProgressWrapper
) -> ShownResult:
    """Measure a step from a recording.

    Parameters
    ----------
    source : MeasurementSource
        Names the step, its recording and the table of its voltages.
    draft : Draft
        Results accepted so far.
    target_um : float
        Wanted slit offset in micrometres.
    progress : callable
        Wraps the numbers of the frames, to display progress, or to cancel.

    Raises
    ------
    InputError
        If the recording is empty, or the step cannot be measured from it.
    MeasurementError
        If it finds nothing.
    """
    assert source.path is not None
    volts = None if source.volts is None else read_volts(source.volts)
    with open_recording(source.path) as frames:
        if len(frames) == 0:
            raise InputError(f"{source.path.name} contains 0 frames", "choose another file")
        return measure_frames(source, frames, volts, draft, target_um, progress)


def measure_frames(
    source: MeasurementSource,
    frames: Frames,
    volts: NDArray[np.floating] | None,
    draft: Draft,
    target_um: float,
    progress: ProgressWrapper,
) -> ShownResult:
    """Measure a step from raw frames, of an open recording or of a layer.

    Parameters
    ----------
    source : MeasurementSource
        Names the step.
    frames : Frames
        Raw frames (rows, cols).
    volts : numpy.ndarray or None
        A voltage per frame of a sweep.
    draft : Draft
        Results accepted so far.
    target_um : float
        Wanted slit offset in micrometres.
    progress : callable
        Wraps the numbers of the frames.

    Raises
    ------
    InputError
        If the step cannot be measured from frames.
    MeasurementError
        If it finds nothing.
    """
    step, setup = find_step(source.step), setup_of(frames)
    found = step.estimate(StepInputs(frames, setup, volts, progress=progress), draft)
    return _shown(step, found, draft, setup, target_um, source)


def _shown(
    step: CalibrationStep[Any], found: Any, draft: Draft, setup: Setup, target_um: float, source: MeasurementSource
) -> ShownResult:
    """Return what a step has found with its picture; also prepares the outlines that are displayed of a pair."""
    if step.key == PAIR.key:
        prepare_shapes()
    return ShownResult(found, setup, picture(step, found, draft, setup, target_um), source)


class OffsetFollowing:
    """Measures the slit offset repeatedly while the tilt mirror is being turned.

    Parameters
    ----------
    client : EngineClient
        Of the connected rig.
    draft : Draft
        Results accepted so far.
    target_um : float
        Wanted slit offset in micrometres.
    source : MeasurementSource
        Source of the frames.

    Attributes
    ----------
    target_um : float
        May be changed while it runs.
    readings : int
        Number of results that :meth:`newest` has returned.
    """

    def __init__(self, client: EngineClient, draft: Draft, target_um: float, source: MeasurementSource) -> None:
        self._client, self._draft, self._source = client, draft, source
        self._running = True
        self._newest: ShownResult | str | None = None
        self.target_um = target_um
        self.readings = 0

    def run(self) -> None:
        """Measure until :meth:`stop`; in a thread.

        Raises
        ------
        DeviceError
            If camera or galvo fail.
        """
        setup, begun_s = self._client.setup().result(), perf_counter()
        for count, found in followed_offsets(self._client, self._draft, lambda: self._running):
            if count == 1:
                begun_s = perf_counter()
            if isinstance(found, MeasurementError):
                self._newest = str(found)
            else:
                shown = picture(OFFSET, found, self._draft, setup, self.target_um)
                if count > 1:
                    rate = f"{(count - 1) / max(perf_counter() - begun_s, 1e-3):.0f} measurements a second"
                    shown = replace(shown, lines=[*shown.lines, rate])
                self._newest = ShownResult(found, setup, shown, self._source)
            sleep(READING_INTERVAL_S)

    def stop(self) -> None:
        """End :meth:`run`."""
        self._running = False

    def newest(self) -> ShownResult | str | None:
        """Return the result since the last call, or the reason why there is none; None if nothing is new."""
        newest, self._newest = self._newest, None
        self.readings += isinstance(newest, ShownResult)
        return newest
