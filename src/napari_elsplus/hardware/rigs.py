"""Open rigs by name: ``simulated``, which is always there, and those of the user's TOML files."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING

from napari_elsplus.closing import unwound_by_signals
from napari_elsplus.errors import InputError
from napari_elsplus.hardware.drivers import open_camera, open_scanner
from napari_elsplus.hardware.guardian.supervision import guard_scanner
from napari_elsplus.hardware.protocols import CountsFrames
from napari_elsplus.hardware.rig import SIMULATED, SIMULATED_REAL, Rig
from napari_elsplus.hardware.rig_files import RigSettings, SimulatedRigSettings, rig_files, rig_settings
from napari_elsplus.hardware.takeover import ParkOrder

if TYPE_CHECKING:
    from napari_elsplus.hardware.virtual.bench import Simulation


def rig_names() -> list[str]:
    """Return the rigs that can be opened, the simulated ones first."""
    return [SIMULATED, SIMULATED_REAL, *sorted(rig_files())]


def open_rig(name: str = SIMULATED, simulation: Simulation | None = None) -> Rig:
    """Open a rig; its galvo is parked, its camera not configured yet.

    A galvo that would go on without this process gets a guardian, which parks if this one dies. Opened in the main
    thread, the rig also parks on SIGTERM and SIGHUP. A rig file may name drivers outside this
    package, which are imported then.

    Parameters
    ----------
    name : str
        One of `rig_names`.
    simulation : Simulation, optional
        Scene, motion and devices of the simulated rig.

    Returns
    -------
    Rig
        A context manager.

    Raises
    ------
    InputError
        If there is no such rig, its file is wrong, or a driver that it names cannot be used.
    DeviceError
        If a device is absent, busy or fails.
    """
    with ExitStack() as held:
        held.enter_context(unwound_by_signals())
        settings = rig_settings(name)
        if isinstance(settings, SimulatedRigSettings):
            rig = _simulated_rig(name, settings, simulation, held)
        elif simulation is not None:
            raise InputError(f"the rig {name} was given a scene", "only a simulated rig takes one")
        else:
            rig = _real_rig(name, settings, held)
        if isinstance(rig.camera, CountsFrames):
            counting = rig.camera
            rig.scanner.watch_frames(lambda: counting.frames_received)
        rig._held = held.pop_all()  # noqa: SLF001 - its own
    return rig


def _simulated_rig(name: str, settings: SimulatedRigSettings, simulation: Simulation | None, held: ExitStack) -> Rig:
    from napari_elsplus.hardware.virtual.bench import Simulation
    from napari_elsplus.hardware.virtual.simulated_rig import simulated_rig
    from napari_elsplus.simulation.model.bundle import Bundle

    simulation = simulation or Simulation()
    if name != SIMULATED:
        fields = {"bundle": Bundle(seed=settings.simulation.bundle_seed), **simulation.instrument}
        simulation = replace(
            simulation, limits=settings.mirror, imperfections=settings.imperfections, instrument=fields
        )
    return simulated_rig(name, simulation, held)


def _real_rig(name: str, settings: RigSettings, held: ExitStack) -> Rig:
    limits = settings.mirror
    camera = held.enter_context(open_camera(settings.camera))
    scanner = held.enter_context(open_scanner(settings))  # last in, first out: the galvo parks first
    order = ParkOrder(settings.card, limits, settings.scanner.kind, settings.scanner.options, tuple(sys.path))
    guardian = guard_scanner(scanner, order, held)
    return Rig(name, camera, scanner, limits, settings.camera.strobe, guardian)
