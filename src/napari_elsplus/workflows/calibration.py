"""A calibration from recordings: from files or frames to the calibration and the steps' results."""

from __future__ import annotations

import os
from contextlib import ExitStack
from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.instrument.arguments import require_frames
from napari_elsplus.io import open_recording, read_volts, volts_beside
from napari_elsplus.processing.calibration.calibrate import measure
from napari_elsplus.processing.progress import Progress, without_display

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.draft import Draft
    from napari_elsplus.processing.images.sectioning import Frames

    Source = Frames | str | os.PathLike[str]


def calibrate(
    *,
    line: Source | None = None,
    sweep: Source | None = None,
    volts: Sequence[float] | NDArray[np.floating] | str | os.PathLike[str] | None = None,
    bundle: Source | None = None,
    background: Source | None = None,
    flat: Source | None = None,
    um_per_px: float | None = None,
    bundle_um: float | None = None,
    line_period_s: float | None = None,
    line_periods_per_frame: float | None = None,
    progress: Progress = without_display,
    **added: Source | None,
) -> Draft:
    """Measure a calibration from any subset of its recordings.

    Parameters
    ----------
    line : path-like or Frames, optional
        Raw frames (rows, cols) of the laser line standing near the middle of the bundle: the slit offset.
    sweep : path-like or Frames, optional
        A raw frame for each of `volts`, the line standing: the galvo map.
    volts : path-like or sequence of float, optional
        (T,) galvo voltages of the sweep, or a CSV file of them with the header ``volts``; by default ``NAME_volts.csv``
        beside the recording ``NAME.tif`` of the sweep.
    bundle : path-like or Frames, optional
        Raw frames of the bundle lit from its far end: where both views are, and how they align.
    background : path-like or Frames, optional
        Raw frames of a dark tube, the laser on.
    flat : path-like or Frames, optional
        Raw frames of a uniform scene; those of `bundle` serve by default.
    um_per_px : float, optional
        Micrometres at the bundle per camera pixel.
    bundle_um : float, optional
        Diameter of the bundle's image in micrometres, instead of `um_per_px`.
    line_period_s : float, optional
        Seconds from one row's readout to the next.
    line_periods_per_frame : float, optional
        Line periods from one frame to the next.
    progress : Progress
        Wraps the numbers of the sweep's frames.
    **added : path-like or Frames, optional
        Raw frames of steps that other packages have registered, by the steps' `option`.

    Returns
    -------
    Draft
        ``calibration``, and the result of each step with its standard deviations; None for steps without input.

    Raises
    ------
    InputError
        If inputs are missing, disagree in shape, or a file cannot be read.
    MeasurementError
        If a step finds no line or no pair of bundle images.
    """
    if volts is None and isinstance(sweep, str | os.PathLike):
        volts = volts_beside(sweep)
    sources = {"line": line, "sweep": sweep, "bundle": bundle, "background": background, "flat": flat, **added}
    with ExitStack() as stack:

        def frames(source: Source) -> Frames:
            if isinstance(source, str | os.PathLike):
                return stack.enter_context(open_recording(source))
            require_frames(source)
            return source

        return measure(
            **{name: frames(source) for name, source in sources.items() if source is not None},
            volts=read_volts(volts) if isinstance(volts, str | os.PathLike) else _array(volts),
            um_per_px=um_per_px,
            bundle_um=bundle_um,
            line_period_s=line_period_s,
            line_periods_per_frame=line_periods_per_frame,
            progress=lambda numbers: progress(numbers, "sweep"),
        )


def _array(volts: Sequence[float] | NDArray[np.floating] | None) -> NDArray[np.floating] | None:
    return None if volts is None else np.asarray(volts, np.float64)
