"""One step of the calibration, from frames that were recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import FrameSection
from napari_elsplus.processing.calibration.calibrate import (
    locate_pair,
    map_galvo,
    mean_frame,
    measure_background,
    measure_flat,
    measure_offset,
)
from napari_elsplus.processing.calibration.draft import Flat, LitPair, Setup, Step

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.draft import Draft, StepResult
    from napari_elsplus.processing.images.sectioning import Frames


def measure_step(
    step: Step,
    frames: Frames,
    draft: Draft,
    volts: NDArray[np.floating] | None = None,
    watch: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> StepResult:
    """Measure a step from recorded frames.

    Parameters
    ----------
    step : Step
        Which.
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols).
    draft : Draft
        What is known so far.
    volts : numpy.ndarray, optional
        A voltage per frame of a sweep.
    watch : callable, optional
        Wraps the numbers of a sweep's frames, to show how far it is.

    Raises
    ------
    InputError
        If the step cannot be measured from a file, or needs another before it.
    MeasurementError
        If it finds nothing.
    """
    known = draft.calibration
    match step:
        case Step.OFFSET:
            return measure_offset(frames, known.background, draft.pair)
        case Step.GALVO:
            if volts is None:
                raise InputError("a sweep without voltages", "give a CSV file with one per frame")
            return map_galvo(frames, volts, known.background, draft.pair, watch)
        case Step.PAIR:
            return LitPair(locate_pair(frames), mean_frame(frames))
        case Step.LAG:
            raise InputError("the scan's lag cannot be seen in a file", "connect the rig and measure it live")
        case Step.BACKGROUND:
            return measure_background(frames)
        case Step.FLAT:
            return Flat(measure_flat(frames, known))


def setup_of(frames: Frames) -> Setup:
    """Say what a recording's frames were taken with, as far as they tell."""
    rows, cols = frames[0].shape
    return Setup(FrameSection(shape=(rows, cols)))
