"""The calibration's steps, in the order in which they are safe, and the registry to which other packages add theirs."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.errors import InputError
from napari_elsplus.processing.calibration import file_options, sections, summaries
from napari_elsplus.processing.calibration.file_options import added_steps
from napari_elsplus.processing.calibration.measurements import (
    Background,
    map_galvo,
    measure_background,
    measure_flat_field,
    measure_pair,
)
from napari_elsplus.processing.calibration.scan.measure import measure_scan
from napari_elsplus.processing.calibration.slit_offset import (
    MAX_OFFSET_DIFFERENCE_ROWS,
    SlitOffset,
    measure_offset,
    offset_at,
)
from napari_elsplus.processing.calibration.step import REGISTERED, CalibrationStep, Capture, StepInputs, Target
from napari_elsplus.processing.calibration.step import register_step as register_step

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.bundle.pair import BundlePair
    from napari_elsplus.processing.calibration.draft import Draft
    from napari_elsplus.processing.calibration.galvo import GalvoMap
    from napari_elsplus.processing.calibration.scan.lag import ScanLag


@cache
def _load_added_steps() -> None:
    for entry_point in added_steps():
        register_step(entry_point.load())


def calibration_steps(first: Sequence[str] = ()) -> tuple[CalibrationStep[Any], ...]:
    """Return the registered steps in their order, those of installed packages included.

    Parameters
    ----------
    first : sequence of str
        Keys of steps that are put before the others.

    Examples
    --------
    >>> [step.key for step in calibration_steps(first=["pair"])][:3]
    ['pair', 'offset', 'galvo']
    """
    _load_added_steps()
    return tuple(sorted(REGISTERED.values(), key=lambda step: [*first, step.key].index(step.key)))


def find_step(key: str) -> CalibrationStep[Any]:
    """Return the step with a key.

    Raises
    ------
    InputError
        If there is none.
    """
    _load_added_steps()
    if key not in REGISTERED:
        raise InputError(f"there is no calibration step {key!r}", f"choose among {', '.join(REGISTERED)}")
    return REGISTERED[key]


def _estimate_offset(inputs: StepInputs, draft: Draft) -> SlitOffset:
    found = measure_offset(inputs.frames, draft.calibration.background, draft.pair)
    return found if draft.pair is None else offset_at(found, draft.pair)


def _outdated_by_offset(draft: Draft, offset: SlitOffset) -> Mapping[str, str]:
    """Return the reason why bundle pair and background do not hold if the tilt mirror was turned."""
    bundle = draft.calibration.bundle
    if bundle is None:
        return {}
    moved = offset.rows - bundle.offset_rows
    if abs(moved) <= MAX_OFFSET_DIFFERENCE_ROWS:
        return {}
    return dict.fromkeys(("pair", "background"), f"the offset has moved by {moved:.1f} rows since")


def _estimate_galvo(inputs: StepInputs, draft: Draft) -> GalvoMap:
    if inputs.volts is None:
        raise InputError("a sweep without voltages", "give a CSV file with one per frame")
    background = draft.calibration.background
    return map_galvo(inputs.frames, inputs.volts, background, draft.pair, inputs.progress, draft.offset)


def _outdated_by_galvo(draft: Draft, _galvo: GalvoMap) -> Mapping[str, str]:
    return {"lag": "the galvo map is newer"} if _lag_is_measured(draft) else {}


def _estimate_pair(inputs: StepInputs, _draft: Draft) -> BundlePair:
    return measure_pair(inputs.frames)


def _lag_is_measured(draft: Draft) -> bool:
    galvo = draft.calibration.galvo
    return galvo is not None and galvo.lag_s is not None


def _estimate_lag(inputs: StepInputs, draft: Draft) -> ScanLag:
    if inputs.scans is None or inputs.setup.line_period_s is None:
        raise InputError("the scan lag cannot be estimated from a file", "connect the rig and measure it live")
    return measure_scan(inputs.scans, draft.calibration, inputs.setup, LAG.frames, inputs.progress)


def _estimate_background(inputs: StepInputs, _draft: Draft) -> Background:
    return measure_background(inputs.frames)


def _estimate_flat_field(inputs: StepInputs, draft: Draft) -> NDArray[np.float32]:
    return measure_flat_field(inputs.frames, sections.with_darkness(draft))


_EVEN = "Probe on an evenly fluorescent target, laser on."

OFFSET: Final = register_step(
    CalibrationStep(
        key="offset",
        title="slit offset",
        explanation="Rows between the line in both views: the distance of the residual view's slit from the line.",
        preparation=f"{_EVEN} Turn the tilt mirror while the offset is displayed.",
        target=Target.FLUORESCENT,
        capture=Capture.HELD,
        frames=10,
        estimate=_estimate_offset,
        apply=sections.apply_offset,
        summarize=summaries.summarize_offset,
        section="offset",
        outdates=_outdated_by_offset,
        option=file_options.OFFSET.name,
        option_help=file_options.OFFSET.help,
    )
)
GALVO: Final = register_step(
    CalibrationStep(
        key="galvo",
        title="galvo map",
        explanation="Voltage that puts the line onto a row: a sweep of the galvo, and a straight line through it.",
        preparation=_EVEN,
        target=Target.FLUORESCENT,
        capture=Capture.SWEEP,
        estimate=_estimate_galvo,
        apply=sections.apply_galvo,
        summarize=summaries.summarize_galvo,
        section="galvo",
        outdates=_outdated_by_galvo,
        option=file_options.GALVO.name,
        option_help=file_options.GALVO.help,
    )
)
PAIR: Final = register_step(
    CalibrationStep(
        key="pair",
        title="bundle pair",
        explanation="Centres and diameter of the two bundle images, and the alignment of the residual view.",
        preparation="Bundle lit from its far end; the line is parked.",
        target=Target.FAR_END_LIT,
        capture=Capture.PARKED,
        frames=20,
        estimate=_estimate_pair,
        apply=sections.apply_pair,
        summarize=summaries.summarize_pair,
        section="bundle",
        option=file_options.PAIR.name,
        option_help=file_options.PAIR.help,
    )
)
LAG: Final = register_step(
    CalibrationStep(
        key="lag",
        title="scan lag",
        explanation="Delay of the line at full speed, and the error of each row, by which a ramp is learned.",
        preparation=_EVEN,
        target=Target.FLUORESCENT,
        capture=Capture.LEADS,
        frames=3,
        estimate=_estimate_lag,
        apply=sections.apply_lag,
        summarize=summaries.summarize_lag,
        section="scan_correction",
        measured=_lag_is_measured,
        needs=("galvo", "pair"),
    )
)
BACKGROUND: Final = register_step(
    CalibrationStep(
        key="background",
        title="background",
        explanation="Light without a sample: reflections and the bundle's own fluorescence.",
        preparation="Probe in the dark tube, laser on.",
        target=Target.DARK_TUBE,
        capture=Capture.SCANNING,
        frames=50,
        estimate=_estimate_background,
        apply=sections.apply_background,
        summarize=summaries.summarize_background,
        section="background",
        option=file_options.BACKGROUND.name,
        option_help=file_options.BACKGROUND.help,
    )
)
FLAT: Final = register_step(
    CalibrationStep(
        key="flat",
        title="flat field",
        explanation="Relative brightness of an even sample: cores and illumination. The bundle pair gives a first one.",
        preparation=_EVEN,
        target=Target.FLUORESCENT,
        capture=Capture.SCANNING,
        frames=50,
        needs=("pair",),
        optional=True,
        estimate=_estimate_flat_field,
        apply=sections.apply_flat_field,
        summarize=summaries.summarize_flat_field,
        section="flat",
        option=file_options.FLAT.name,
        option_help=file_options.FLAT.help,
    )
)
