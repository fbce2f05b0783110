"""Rigs: a camera, a mirror and their limits under one name.

``simulated`` is always there; a user's own are TOML files.
"""

from __future__ import annotations

import signal
import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.daq.scanner import DaqScanner
from napari_elsplus.hardware.parking import park_order
from napari_elsplus.hardware.rig import SIMULATED, Rig
from napari_elsplus.hardware.rig_files import RigSettings, read_rig, rig_files

if TYPE_CHECKING:
    from napari_elsplus.hardware.virtual.bench import Simulation


def rig_names() -> list[str]:
    """Return the rigs that can be opened, ``simulated`` first."""
    return [SIMULATED, *sorted(rig_files())]


def open_rig(name: str = SIMULATED, simulation: Simulation | None = None) -> Rig:
    """Open a rig: the mirror is parked, the camera waits for its settings.

    Opened in the main thread, the rig also parks when the process is told to end (SIGTERM).

    Parameters
    ----------
    name : str
        One of `rig_names`.
    simulation : Simulation, optional
        What the simulated rig looks at.

    Returns
    -------
    Rig
        A context manager.

    Raises
    ------
    InputError
        If there is no such rig, or its file is wrong.
    DeviceError
        If a device is absent, busy or fails.
    """
    with ExitStack() as held:
        _end_on_sigterm(held)
        if name == SIMULATED:
            from napari_elsplus.hardware.virtual.simulated_rig import simulated_rig

            rig = simulated_rig(simulation, held)
        elif simulation is not None:
            raise InputError(f"the rig {name} was given a scene", "only the simulated rig takes one")
        else:
            rig = _real_rig(name, read_rig(name), held)
        rig._held = held.pop_all()  # noqa: SLF001 - its own
    return rig


def _real_rig(name: str, settings: RigSettings, held: ExitStack) -> Rig:
    from napari_elsplus.hardware.u3v.camera import U3vCamera
    from napari_elsplus.hardware.u3v.discovery import choose_camera

    limits = settings.limits()
    camera = held.enter_context(U3vCamera(choose_camera(settings.camera.serial), settings.camera.features()))
    scanner = held.enter_context(DaqScanner(settings.card_settings(), limits))  # last in, first out: it parks first
    return Rig(name, camera, scanner, limits, settings.camera.strobe, park_order(scanner))


def _end_on_sigterm(held: ExitStack) -> None:
    """Let SIGTERM unwind the program, so that whatever holds the rig lets it go."""
    if threading.current_thread() is not threading.main_thread():
        return
    if signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        return  # the program has its own way to end

    def end(number: int, _: object) -> None:
        raise SystemExit(128 + number)

    signal.signal(signal.SIGTERM, end)
    held.callback(signal.signal, signal.SIGTERM, signal.SIG_DFL)
