"""A whole calibration from recorded frames: each step's result serves the next."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import Calibration, OpticsSection
from napari_elsplus.instrument.optics import require_bundle_um
from napari_elsplus.processing.calibration.draft import Draft, setup_of
from napari_elsplus.processing.calibration.step import Capture, StepInputs
from napari_elsplus.processing.calibration.steps import calibration_steps

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.processing.images.sectioning import Frames
    from napari_elsplus.processing.progress import ProgressWrapper

PLAUSIBLE: Final = {
    "um_per_px": (1e-2, 1e2, "give the micrometres at the specimen for one camera pixel, about 1"),
    "line_period_s": (1e-7, 1e-3, "give the seconds from one row to the next, about 1e-5"),
    "rows_per_frame": (1.0, 1e7, "count all line periods from one frame to the next"),
}
"""Least and largest value; chosen: cameras take 5 to 100 us for a row, and a number beyond is in another unit."""
MEASURED_FIRST: Final = ("background", "pair")
"""Keys of the steps whose results the other steps use where they are known."""


def measure(
    *,
    volts: NDArray[np.floating] | None = None,
    um_per_px: float | None = None,
    bundle_um: float | None = None,
    line_period_s: float | None = None,
    line_periods_per_frame: float | None = None,
    progress: ProgressWrapper = iter,
    **frames: Frames | None,
) -> Draft:
    """Measure a calibration from any subset of its inputs.

    Parameters
    ----------
    volts : numpy.ndarray, optional
        A voltage per frame of `sweep`.
    um_per_px, bundle_um : float, optional
        Scale, or the bundle's diameter from which it follows.
    line_period_s, line_periods_per_frame : float, optional
        Timing.
    progress : callable, optional
        Wraps the numbers of the sweep's frames, to display progress.
    **frames : sequence of numpy.ndarray, optional
        Raw frames (rows, cols) of the steps, by their `option`: `line` standing still; `sweep`, the line at each of
        `volts`; `bundle` lit from the far end; `background`, a dark tube; `flat`, a uniform scene; and those of steps
        that other packages have registered.

    Returns
    -------
    Draft
        The steps' results with their uncertainties, and the calibration made of them.

    Raises
    ------
    InputError
        If inputs are missing, disagree in shape, or make no sense together.
    MeasurementError
        If a step finds no line or no pair.
    """
    options = [step.option for step in calibration_steps() if step.option]
    if unknown := [name for name in frames if name not in options]:
        raise InputError(f"no calibration step takes {unknown[0]!r}", f"choose among {', '.join(options)}")
    given = {name: taken for name, taken in frames.items() if taken is not None}
    _check_shapes(given)
    if "sweep" not in given and volts is not None:
        raise InputError("voltages without a sweep", "give --sweep")
    if "sweep" in given and volts is None:
        raise InputError("a sweep without voltages", "give --volts")
    if um_per_px is not None and bundle_um is not None:
        raise InputError(f"two scales, {um_per_px} um per pixel and a bundle of {bundle_um} um", "give one of them")
    if bundle_um is not None and "bundle" not in given:
        raise InputError(f"a bundle of {bundle_um} um gives no scale without its image", "give --bundle or --um-per-px")
    if "flat" in given and "bundle" not in given:
        raise InputError("a flat field belongs to a located bundle", "give --bundle")
    optics = _optics_section(um_per_px, line_period_s, line_periods_per_frame)
    if bundle_um is not None:
        require_bundle_um(bundle_um)
    rows = max((taken[0].shape[0] for taken in given.values()), default=0)
    if line_periods_per_frame is not None and line_periods_per_frame < rows:
        raise InputError(
            f"{line_periods_per_frame:g} rows per frame, but frames have {rows} rows",
            PLAUSIBLE["rows_per_frame"][-1],
        )
    draft = Draft(Calibration(optics=optics), bundle_um=bundle_um)
    for step in calibration_steps(first=MEASURED_FIRST):
        if step.option in given:
            setup = setup_of(given[step.option])
            swept = volts if step.capture is Capture.SWEEP else None
            found = step.estimate(StepInputs(given[step.option], setup, swept, progress=progress), draft)
            draft = step.accept(draft, found, setup)
    return draft


def _check_shapes(inputs: Mapping[str, Frames]) -> None:
    first = next(iter(inputs), "")
    for name, frames in inputs.items():
        if not len(frames):
            raise InputError(f"{name}: there are 0 frames", "give at least one")
        shape, expected = frames[0].shape, inputs[first][0].shape
        if len(shape) != 2:
            raise InputError(f"{name}: a frame has shape {shape}", "frames (rows, cols) are expected")
        if shape != expected:
            raise InputError(
                f"{first} has {expected[0]} x {expected[1]} pixels, {name} {shape[0]} x {shape[1]}",
                "record all with the same camera region",
            )


def _optics_section(
    um_per_px: float | None, line_period_s: float | None, line_periods_per_frame: float | None
) -> OpticsSection | None:
    numbers = {"um_per_px": um_per_px, "line_period_s": line_period_s, "rows_per_frame": line_periods_per_frame}
    known = {name: value for name, value in numbers.items() if value is not None}
    for name, value in known.items():
        least, largest, remedy = PLAUSIBLE[name]
        if not least <= value <= largest:
            raise InputError(f"{name} is {value:g}", remedy)
    return OpticsSection(**known) if known else None
