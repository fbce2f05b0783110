"""The active calibration as panels display it: its name, when it was measured, and what was not measured."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from magicgui.widgets import PushButton

from napari_elsplus.instrument.scanning import lag_advice, rate_advice
from napari_elsplus.processing.calibration.draft import Draft
from napari_elsplus.processing.calibration.steps import LAG
from napari_elsplus.workflows.pictures.curves import PAPER_COLOURS

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from napari_elsplus.acquisition.link.client import EngineClient
    from napari_elsplus.instrument.calibration import Calibration

AMBER: Final = PAPER_COLOURS["orange"]


def amber(text: str) -> str:
    """Return rich text of a warning, black on amber: amber itself would not be legible on a light theme."""
    return f"<b style='background-color:{AMBER}; color:black'>{text}</b>"


def calibration_name(calibration: Calibration | None, file: Path | None) -> str:
    """Return the name of a calibration: its file, and when it was measured.

    Parameters
    ----------
    calibration : Calibration or None
        The active calibration; None if there is none, or it has not been read.
    file : pathlib.Path or None
        Its file; None if it was not saved.
    """
    if calibration is None:
        return "none" if file is None else f"{file.name}, of recordings without their own"
    measured = calibration.created.replace("T", " ")[: len("2026-01-31 12:00")]
    return f"{file.name if file is not None else 'not saved'}, measured {measured} UTC"


def calibration_lines(calibration: Calibration | None, file: Path | None) -> list[str]:
    """Return lines of rich text: the calibration's name, and in amber what was not measured.

    Parameters
    ----------
    calibration : Calibration or None
        The active calibration; None if there is none, or it has not been read.
    file : pathlib.Path or None
        Its file; None if it was not saved.
    """
    lines = [f"active calibration: {calibration_name(calibration, file)}"]
    if calibration is None:
        return lines
    lines.extend(amber(advice) for advice in (lag_advice(calibration), rate_advice(calibration)) if advice)
    if calibration.um_per_px is None:
        lines.append(amber("micrometres unknown: enter the bundle's diameter in Calibration"))
    if calibration.background is None:
        lines.append(amber("background not measured: none is subtracted"))
    if calibration.flat is None:
        lines.append(amber("flat field not measured: brightness is uneven"))
    return lines


def lag_button() -> PushButton:
    """Return the hidden button that measures a missing scan lag."""
    return PushButton(
        text="Measure scan lag",
        tooltip="Measure the delay of the scan and activate it; probe on an evenly fluorescent target, laser on",
        visible=False,
    )


def measured_lag(client: EngineClient, calibration: Calibration) -> Callable[[], Calibration]:
    """Return a slow function that measures the scan lag on the rig and returns the calibration with it.

    Parameters
    ----------
    client : EngineClient
        Of the connected rig, its probe on an evenly fluorescent target.
    calibration : Calibration
        With galvo map and bundle pair.
    """

    def measure() -> Calibration:
        draft = Draft(calibration, bundle_um=None)
        setup = client.setup().result()
        found = client.measure_step(LAG, draft).result()
        return LAG.accept(draft, found, setup).calibration

    return measure
