"""Python script that repeats streaming and recording of the Live panel."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import CalibrationError
from napari_elsplus.hardware.rig_files import is_simulated
from napari_elsplus.viewing.script import write_script

if TYPE_CHECKING:
    from pathlib import Path

    from napari_elsplus.acquisition.engine.live_images import LiveView
    from napari_elsplus.acquisition.engine.status import Settings
    from napari_elsplus.acquisition.streaming.recorder import RecordingPlan

SECONDS: Final = 10.0
"""Duration of the recording where the plan limits neither duration nor frames, seconds; chosen."""


def live_script(rig: str, settings: Settings, view: LiveView, plan: RecordingPlan, calibration: Path | None) -> str:
    """Return a script that streams and records in the same way.

    Parameters
    ----------
    rig : str
        Name of the rig.
    settings : Settings
        Preset, slit width, frame rate and gain.
    view : LiveView
        Processing of live images.
    plan : RecordingPlan
        File and limits of the recording.
    calibration : Path, optional
        File of the active calibration; without it the simulated rig is calibrated first.

    Raises
    ------
    CalibrationError
        If the calibration of a real rig has no file.
    """
    if calibration is None and not is_simulated(rig):
        raise CalibrationError("the calibration has no file", "save it in the Rig panel")
    seconds = plan.seconds if plan.seconds or plan.frames else SECONDS
    calibrated = "" if calibration is None else f", calibration=elsplus.load_calibration({str(calibration)!r})"
    body = f"""
view = LiveView(
    {view.background}, {view.flat_field}, CoreFilter.{view.cores.name}, {view.average},
    row_reference={view.row_reference},
)
plan = elsplus.RecordingPlan(
    {str(plan.path)!r}, frames={plan.frames}, seconds={seconds}, earlier_s={plan.earlier_s}
)
settings = {asdict(settings)!r}
with elsplus.open_engine({rig!r}{calibrated}, **settings) as engine:
    engine.show(view)
    engine.start()
    engine.record(plan)
    while engine.status().recording.running:
        time.sleep(0.1)
    status = engine.status()
print(f"{{status.recorded}} frames, {{status.camera_hz:.0f}} Hz, lost: {{dict(status.dropped)}}")
"""
    imports = (
        "from napari_elsplus.acquisition.engine.live_images import LiveView",
        "from napari_elsplus.processing.images.cores import CoreFilter",
    )
    return write_script(f"Record from the rig {rig}.", body, imports, ("import time",))
