"""Python script that repeats a calibration of the Calibration panel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import InputError
from napari_elsplus.viewing.script import write_script

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from napari_elsplus.instrument.calibration import OpticsSection

IMPORTS: Final = (
    "from napari_elsplus.acquisition.engine.status import Settings",
    "from napari_elsplus.acquisition.link.client import EngineClient",
    "from napari_elsplus.io import read_volts",
    "from napari_elsplus.processing.calibration.draft import Draft, setup_of",
    "from napari_elsplus.processing.calibration.step import StepInputs",
    "from napari_elsplus.processing.calibration.steps import find_step",
)


@dataclass(frozen=True, slots=True)
class MeasurementSource:
    """Source of a step's frames.

    Parameters
    ----------
    step : str
        Key of the step.
    path, volts : Path, optional
        The recording, and the table of a sweep's voltages; none if it was measured live.
    layer : str
        Name of the layer, if it was measured from a layer that has no file.
    rig, preset : str
        The rig on which it was measured live, and its preset.
    voltages : int
        Of a live sweep.
    """

    step: str
    path: Path | None = None
    volts: Path | None = None
    layer: str = ""
    rig: str = ""
    preset: str = ""
    voltages: int = 0


def calibration_script(
    sources: Sequence[MeasurementSource], bundle_um: float | None, optics: OpticsSection | None = None
) -> str:
    """Return a script that makes the same calibration from the same sources.

    Parameters
    ----------
    sources : sequence of MeasurementSource
        The steps that were accepted, in order.
    bundle_um : float or None
        Diameter of the bundle's image in micrometres; None if it is unknown.
    optics : OpticsSection, optional
        Contains the timing.

    Raises
    ------
    InputError
        If no step was measured here, on more than one rig, or from a layer without a file.
    """
    if not sources:
        raise InputError("no step was measured here", "measure and accept one first")
    if unsaved := [source.layer for source in sources if source.layer]:
        raise InputError(f"the layer {unsaved[0]} has no file", "save it, and measure from the file")
    live = {(source.rig, source.preset) for source in sources if source.path is None}
    if len(live) > 1:
        raise InputError(f"steps were measured on {len(live)} rigs", "measure them on one, or copy them one by one")
    inside = [line for source in sources for line in _step(source)]
    if live:
        rig, preset = live.pop()
        opened = ["with EngineClient() as client:", f"    client.open({rig!r}).result()"]
        opened.append(f"    client.configure(Settings({preset!r})).result()")
        inside = [*opened, *(f"    {line}" for line in inside)]
    body = "\n".join(
        [
            f"draft = Draft(bundle_um={bundle_um!r})",
            *_timing(optics),
            *inside,
            'elsplus.save_calibration("calibration.json", draft.calibration)',
        ]
    )
    return write_script(f"Calibration: {', '.join(source.step for source in sources)}.", body, IMPORTS)


def _timing(optics: OpticsSection | None) -> list[str]:
    timing = {} if optics is None else optics.model_dump(include={"line_period_s", "line_periods_per_frame"})
    given = ", ".join(f"{name}={value!r}" for name, value in timing.items() if value is not None)
    return [f"draft = draft.with_timing({given})"] if given else []


def _step(source: MeasurementSource) -> list[str]:
    step = f"find_step({source.step!r})"
    if source.path is None:
        return [
            f"step = {step}",
            'input(f"{step.preparation} Then press Enter.")',
            f"found = client.measure_step(step, draft, {source.voltages}).result()",
            "draft = step.accept(draft, found, client.setup().result())",
        ]
    volts = "None" if source.volts is None else f"read_volts({str(source.volts)!r})"
    return [
        f"with elsplus.open_recording({str(source.path)!r}) as frames:",
        f"    step, setup = {step}, setup_of(frames)",
        f"    found = step.estimate(StepInputs(frames, setup, {volts}), draft)",
        "    draft = step.accept(draft, found, setup)",
    ]
