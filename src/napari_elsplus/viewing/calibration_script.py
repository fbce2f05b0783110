"""A calibration that was made by hand, step after step, as a script that makes it again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from napari_elsplus.processing.calibration.draft import Step


@dataclass(frozen=True, slots=True)
class MeasurementSource:
    """Where a step's frames came from.

    Parameters
    ----------
    step : Step
        Which.
    path, volts : Path, optional
        The recording, and the table of a sweep's voltages; none if it was measured live.
    rig, preset : str
        The rig on which it was measured live, and how that was set up.
    voltages : int
        Steps of a live sweep.
    """

    step: Step
    path: Path | None = None
    volts: Path | None = None
    rig: str = ""
    preset: str = ""
    voltages: int = 0


def calibration_script(sources: Sequence[MeasurementSource], bundle_um: float) -> str:
    """Write a script that makes the same calibration.

    Parameters
    ----------
    sources : sequence of MeasurementSource
        The steps that were accepted, in order.
    bundle_um : float
        Diameter of the bundle's image.

    Raises
    ------
    InputError
        If no step was measured here, or on more than one rig.
    """
    if not sources:
        raise InputError("no step was measured here", "measure and accept one first")
    live = {(source.rig, source.preset) for source in sources if source.path is None}
    if len(live) > 1:
        raise InputError(f"steps were measured on {len(live)} rigs", "measure them on one, or copy them one by one")
    inside = [line for source in sources for line in _step(source)]
    if live:
        rig, preset = live.pop()
        opened = ["with EngineClient() as client:", f"    client.open({rig!r}).result()"]
        opened.append(f"    client.configure(Settings({preset!r})).result()")
        inside = [*opened, *(f"    {line}" for line in inside)]
    body = "\n".join(inside)
    return f'''"""Calibration: {", ".join(source.step for source in sources)}."""

from napari_elsplus.acquisition.link.client import EngineClient
from napari_elsplus.acquisition.link.guided_calibration import GuidedCalibration
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.io import open_recording, read_volts, write_calibration
from napari_elsplus.processing.calibration.draft import Draft, Step
from napari_elsplus.processing.calibration.stepwise import measure_step, setup_of

draft = Draft(bundle_um={bundle_um!r})
{body}
write_calibration("calibration.json", draft.calibration)
'''


def _step(source: MeasurementSource) -> list[str]:
    step = f"Step.{source.step.name}"
    if source.path is None:
        return [
            f'input("Prepare the {source.step}, then press Enter")',
            f"guided = GuidedCalibration(client, {source.voltages})",
            f"draft = draft.take(guided.measure({step}, draft), guided.setup())",
        ]
    volts = "None" if source.volts is None else f"read_volts({str(source.volts)!r})"
    return [
        f"with open_recording({str(source.path)!r}) as frames:",
        f"    draft = draft.take(measure_step({step}, frames, draft, {volts}), setup_of(frames))",
    ]
