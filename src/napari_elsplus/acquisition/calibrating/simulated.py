"""The simulated rig: targets before its probe for a calibration, which is remembered, moving lens tissue afterwards."""

from __future__ import annotations

import hashlib
from contextlib import contextmanager, suppress
from dataclasses import fields
from functools import partial
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.hardware.rig_files import is_simulated
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.virtual.bench import Simulation
from napari_elsplus.instrument.optics import BUNDLE_UM
from napari_elsplus.io.calibrations import read_calibration, write_calibration
from napari_elsplus.io.user_folders import cache_folder, software_fingerprint
from napari_elsplus.processing.calibration.file_options import OWN_STEPS, added_steps
from napari_elsplus.processing.calibration.step import REGISTERED, Target
from napari_elsplus.processing.progress import without_display
from napari_elsplus.simulation.specimen.scenes import distal_light, empty, fibres, uniform
from napari_elsplus.simulation.specimen.trajectories import Circle

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from napari_elsplus.acquisition.engine.camera_setup import CameraSetup
    from napari_elsplus.acquisition.engine.engine import Engine
    from napari_elsplus.hardware.rig import Rig, VirtualBench
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.draft import Draft
    from napari_elsplus.processing.progress import Progress

MAX_FILES: Final = 8
"""Calibrations kept, 4 MB each; chosen: two presets of a few rigs."""
PLAYED: Final = frozenset({"scene", "trajectory", "real_time", "own_process"})
"""Fields of a simulation that its calibration does not depend on."""
PATH: Final = Circle(diameter_um=800.0, period_s=1.75)
"""Path of the probe over the tissue; chosen: 420 frames at 240 Hz, which then repeat."""
QUICK_VOLTAGES: Final = 60
"""Of the sweep; chosen: enough for 0.05 rows, and over in seconds."""
SCENES: Final = {Target.FAR_END_LIT: distal_light, Target.FLUORESCENT: uniform, Target.DARK_TUBE: empty}


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
    with suppress(OSError, InputError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_calibration(path, calibration, force=True)
        kept = sorted(path.parent.glob("simulated-*.json"), key=lambda file: file.stat().st_mtime)
        for old in kept[:-MAX_FILES]:
            old.unlink(missing_ok=True)
            old.with_suffix(".npz").unlink(missing_ok=True)


def open_live(name: str, *, own_process: bool = False) -> Rig:
    """Open a rig for live images; before the probe of the simulated one moves lens tissue.

    Parameters
    ----------
    name : str
        One of :func:`napari_elsplus.hardware.rigs.rig_names`.
    own_process : bool
        Run the simulated card in a process that outlives this one, as a real card does, so that a guardian can park it.

    Raises
    ------
    InputError
        If no rig has that name, or its file is wrong.
    DeviceError
        If a device is absent, busy or fails.
    """
    if not is_simulated(name):
        return open_rig(name)
    return open_rig(name, Simulation(scene=fibres(), trajectory=PATH, own_process=own_process))


def place_target(rig: Rig, target: Target | None) -> None:
    """Place a target before the simulated rig's probe, or moving lens tissue if it is None; skip a real rig."""
    if rig.bench is None:
        return
    if target is None:
        rig.bench.optics.show(fibres(), PATH)
    else:
        rig.bench.optics.show(SCENES[target]())


@contextmanager
def target_placed(rig: Rig, target: Target) -> Iterator[None]:
    """Place a target before the simulated rig's probe, and moving lens tissue in the end; skip a real rig."""
    place_target(rig, target)
    try:
        yield
    finally:
        place_target(rig, None)


def calibrate_simulated(
    rig: Rig,
    engine: Engine,
    *,
    voltages: int = QUICK_VOLTAGES,
    bundle_um: float | None = None,
    progress: Progress = without_display,
) -> Draft:
    """Calibrate the simulated rig without a user, and place the probe onto moving lens tissue.

    Parameters and results are those of :func:`napari_elsplus.acquisition.calibrating.live.calibrate_rig`; the bundle's
    diameter, which is known here, is the simulated one by default.

    Raises
    ------
    InputError
        If the rig is a real one.
    """
    from napari_elsplus.acquisition.calibrating.live import calibrate_rig  # not where a calibration is remembered

    _require_bench(rig)
    known_um = BUNDLE_UM if bundle_um is None else bundle_um
    draft = calibrate_rig(engine, partial(place_target, rig), voltages=voltages, bundle_um=known_um, progress=progress)
    place_target(rig, None)
    return draft


def use_simulated_calibration(rig: Rig, engine: Engine, *, progress: Progress = without_display) -> None:
    """Activate the calibration of a simulated rig that an earlier start remembered; else calibrate, and remember it.

    Parameters
    ----------
    rig : Rig
        The simulated rig.
    engine : Engine
        Configured.
    progress : Progress
        As of :func:`calibrate_simulated`.

    Raises
    ------
    InputError
        If the rig is a real one.
    """
    file = remembered_file(_require_bench(rig).optics.simulation, engine.setup)
    remembered = recall_calibration(file)
    if remembered is not None:
        engine.use(remembered)
    else:
        remember_calibration(file, calibrate_simulated(rig, engine, progress=progress).calibration)


def _require_bench(rig: Rig) -> VirtualBench:
    if rig.bench is None:
        raise InputError(f"the rig {rig.name} cannot be calibrated without its user", "give a calibration with -c")
    return rig.bench
