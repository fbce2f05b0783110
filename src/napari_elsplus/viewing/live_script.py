"""What the Live panel does, as a script."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.errors import CalibrationError
from napari_elsplus.hardware.rig import SIMULATED

if TYPE_CHECKING:
    from pathlib import Path

    from napari_elsplus.acquisition.engine.live_images import LiveView
    from napari_elsplus.acquisition.engine.status import Settings
    from napari_elsplus.acquisition.streaming.recorder import RecordingPlan

SECONDS = 10.0
"""Recorded where the form says neither seconds nor frames."""


def live_script(rig: str, settings: Settings, view: LiveView, plan: RecordingPlan, calibration: Path | None) -> str:
    """Write a script that streams and records in the same way.

    Parameters
    ----------
    rig : str
        Its name.
    settings : Settings
        How it runs.
    view : LiveView
        How images are made.
    plan : RecordingPlan
        What is recorded; ten seconds if it says neither seconds nor frames.
    calibration : Path, optional
        File of the active calibration; the simulated rig calibrates itself without.

    Raises
    ------
    CalibrationError
        If a real rig's calibration lies in no file.
    """
    if calibration is None and rig != SIMULATED:
        raise CalibrationError("the calibration lies in no file", "save it in the Rig panel")
    calibrated = "engine.calibrate_simulated().result()"
    imported = ""
    if calibration is not None:
        calibrated = f"engine.use(read_calibration({str(calibration)!r})).result()"
        imported = "\nfrom napari_elsplus.io import read_calibration"
    seconds = plan.seconds if plan.seconds or plan.frames else SECONDS
    return f'''"""Record from the rig {rig}."""

import time
from pathlib import Path

from napari_elsplus.acquisition.link.client import EngineClient
from napari_elsplus.acquisition.engine.live_images import LiveView
from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
from napari_elsplus.acquisition.engine.status import Settings{imported}
from napari_elsplus.processing.images.cores import CoreFilter

settings = {settings!r}
view = LiveView({view.background}, {view.flat_field}, CoreFilter.{view.cores.name}, {view.average})
path = Path({str(plan.path)!r})
plan = RecordingPlan(path, frames={plan.frames}, seconds={seconds}, earlier_s={plan.earlier_s})

with EngineClient() as engine:
    engine.open({rig!r}).result()
    engine.configure(settings).result()
    {calibrated}
    engine.show(view).result()
    engine.start().result()
    engine.record(plan).result()
    while (recording := engine.status.recording) is None or recording.running:
        time.sleep(0.1)
    status = engine.status
print(f"{{status.recorded}} frames, {{status.camera_hz:.0f}} Hz, lost: {{dict(status.dropped)}}")
'''
