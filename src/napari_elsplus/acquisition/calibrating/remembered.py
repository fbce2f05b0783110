"""Calibrations of simulated rigs, remembered between starts in the user's cache folder.

A simulated rig gives the same calibration whenever its devices, the camera's settings, the calibration steps and the
software are the same: the file's name is a hash of all four. The folder may be deleted at any time.
"""

from __future__ import annotations

import hashlib
from contextlib import suppress
from dataclasses import fields
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import CalibrationError
from napari_elsplus.io.calibrations import read_calibration, write_calibration
from napari_elsplus.io.user_folders import cache_folder, software_fingerprint
from napari_elsplus.processing.calibration.file_options import OWN_STEPS, added_steps
from napari_elsplus.processing.calibration.step import REGISTERED

if TYPE_CHECKING:
    from pathlib import Path

    from napari_elsplus.acquisition.engine.camera_setup import CameraSetup
    from napari_elsplus.hardware.virtual.bench import Simulation
    from napari_elsplus.instrument.calibration import Calibration

MAX_FILES: Final = 8
"""Calibrations kept, 4 MB each; chosen: two presets of a few rigs."""
PLAYED: Final = frozenset({"scene", "trajectory", "real_time", "own_process"})
"""Fields of a simulation that its calibration does not depend on."""


def remembered_file(simulation: Simulation, setup: CameraSetup) -> Path:
    """Return the path of a simulated rig's calibration; it need not exist.

    Parameters
    ----------
    simulation : Simulation
        The rig's devices.
    setup : CameraSetup
        The camera's settings.
    """
    devices = {part.name: getattr(simulation, part.name) for part in fields(simulation) if part.name not in PLAYED}
    facts = f"{software_fingerprint()} {devices} {setup.acquired_with} {setup.frame_shape} {_steps_of_others()}"
    return cache_folder() / "calibrations" / f"simulated-{hashlib.sha256(facts.encode()).hexdigest()[:16]}.json"


def _steps_of_others() -> list[str]:
    """Keys of the registered steps of other packages and scripts; the modules that compute stay unimported without."""
    if not (REGISTERED or added_steps()):
        return []
    from napari_elsplus.processing.calibration.steps import calibration_steps

    return sorted(step.key for step in calibration_steps() if step.key not in OWN_STEPS)


def recall_calibration(path: Path) -> Calibration | None:
    """Read a remembered calibration; None if there is none at that path, or it cannot be read."""
    try:
        return read_calibration(path) if path.exists() else None
    except (CalibrationError, OSError):
        return None


def remember_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration to a path, and remove the oldest beyond `MAX_FILES`; a refusing folder costs only time."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_calibration(path, calibration, force=True)
        kept = sorted(path.parent.glob("simulated-*.json"), key=lambda file: file.stat().st_mtime)
        for old in kept[:-MAX_FILES]:
            old.unlink(missing_ok=True)
            old.with_suffix(".npz").unlink(missing_ok=True)
