"""The simulated rig: the unmodified drivers on virtual devices."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.daq.output import CardSettings
from napari_elsplus.hardware.daq.scanner import DaqScanner
from napari_elsplus.hardware.guardian.supervision import guard_scanner, when_parked
from napari_elsplus.hardware.rig import Rig, VirtualBench
from napari_elsplus.hardware.scan.timing import StrobePhase
from napari_elsplus.hardware.takeover import ParkOrder
from napari_elsplus.hardware.u3v.camera import U3vCamera
from napari_elsplus.hardware.u3v.discovery import choose_camera
from napari_elsplus.hardware.u3v.flea3 import Flea3
from napari_elsplus.hardware.virtual.bench import OpticalBench
from napari_elsplus.hardware.virtual.camera.bus import Plug, VirtualBus
from napari_elsplus.hardware.virtual.camera.device import VirtualCamera
from napari_elsplus.hardware.virtual.card.card import VirtualCard
from napari_elsplus.hardware.virtual.card.grpc_server import CardServer
from napari_elsplus.hardware.virtual.card.process import start_card
from napari_elsplus.hardware.virtual.timeline import BenchClock
from napari_elsplus.instrument.optics import PRESETS
from napari_elsplus.simulation.model.imperfections import IDEAL
from napari_elsplus.simulation.truth import park_volts

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import ExitStack

    from napari_elsplus.hardware.virtual.bench import Simulation
    from napari_elsplus.hardware.virtual.card.process import RemoteCard

SERIAL = "virtual-1"
"""Serial number of the virtual camera."""


def simulated_rig(name: str, simulation: Simulation, held: ExitStack) -> Rig:
    """Open the drivers on virtual devices.

    Parameters
    ----------
    name : str
        Name of the rig.
    simulation : Simulation
        Scene, motion and devices.
    held : contextlib.ExitStack
        Closes the devices.

    Raises
    ------
    InputError
        If the card should live in a process of its own without real time.
    """
    clock = BenchClock(simulation.real_time)
    card, address, release = _card(simulation, clock)
    opened: list[DaqScanner] = []
    held.callback(lambda: when_parked(opened[0], release) if opened else release())  # the card is needed until then
    optics = OpticalBench(simulation, card, clock)
    moved_s = None if simulation.imperfections == IDEAL else optics.moved_s  # an ideal rig loses no frame
    plug = Plug(VirtualCamera(optics, serial=SERIAL, moved_s=moved_s))
    limits = simulation.stated_limits
    settings = CardSettings(parking_voltage(optics), address=address)
    device = choose_camera(SERIAL, VirtualBus(plug))
    camera = held.enter_context(U3vCamera(device, Flea3, wait_for_reader=not simulation.real_time))
    scanner = DaqScanner(settings, limits, now_s=clock.now_s)
    opened.append(held.enter_context(scanner))
    guardian = (
        guard_scanner(scanner, ParkOrder(settings, limits, virtual=True), held) if simulation.own_process else None
    )
    bench = VirtualBench(optics, card, plug)
    return Rig(name, camera, scanner, limits, StrobePhase.EXPOSURE, guardian, bench)


def parking_voltage(optics: OpticalBench) -> float:
    """Return the voltage at which the line on a bench of some `optics` is clear of the bundle in every preset."""
    return min(park_volts(optics.instrument(preset)) for preset in PRESETS.values())


def _card(simulation: Simulation, clock: BenchClock) -> tuple[VirtualCard | RemoteCard, str, Callable[[], None]]:
    """Return a card, its address, and what releases it."""
    if simulation.own_process:
        if not simulation.real_time:
            raise InputError("a card in a process of its own, without real time", "two processes share only real time")
        remote = start_card()
        return remote, remote.address, remote.close
    card = VirtualCard(clock)
    server = CardServer(card)
    return card, server.address, server.close
