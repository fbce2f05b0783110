"""An open rig: camera, scanner and their limits under one name."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from napari_elsplus.closing import ClosedOnExit

if TYPE_CHECKING:
    from napari_elsplus.hardware.guardian.supervision import Guardian
    from napari_elsplus.hardware.protocols import Camera, Scanner
    from napari_elsplus.hardware.scan.timing import StrobePhase
    from napari_elsplus.hardware.scan.waveform import GalvoLimits
    from napari_elsplus.hardware.virtual.bench import OpticalBench
    from napari_elsplus.hardware.virtual.camera.bus import Plug
    from napari_elsplus.hardware.virtual.card.card import VirtualCard
    from napari_elsplus.hardware.virtual.card.process import RemoteCard

SIMULATED: Final = "simulated"
"""Name of the simulated rig of the ideal instrument."""
SIMULATED_REAL: Final = "simulated-real"
"""Name of simulated rigs with imperfections drawn at random; ``simulated-real:SEED`` with another seed than 0."""


@dataclass
class Rig(ClosedOnExit):
    """An open rig. A context manager: leaving it parks the galvo and closes the devices.

    Parameters
    ----------
    name : str
        Name under which it was opened.
    camera, scanner : Camera, Scanner
        The devices.
    limits : GalvoLimits
        Voltage, slew and acceleration that the galvo may be driven with.
    strobe : StrobePhase
        Event that the camera's strobe marks.
    guardian : Guardian, optional
        Parks from another process if this one dies; None where the card ends with this process.
    bench : VirtualBench, optional
        Ground truth and fault switches of the simulated rig; None for a real one.
    """

    name: str
    camera: Camera
    scanner: Scanner
    limits: GalvoLimits
    strobe: StrobePhase
    guardian: Guardian | None = None
    bench: VirtualBench | None = None
    _held: ExitStack = field(default_factory=ExitStack, repr=False)

    def check_guarded(self) -> None:
        """Raise while the galvo must not move because its guardian is gone; every mover of the galvo calls it before.

        Raises
        ------
        DeviceError
            If there is to be a guardian, and none is on guard.
        """
        if self.guardian is not None:
            self.guardian.check()

    def close(self) -> None:
        """Park the galvo, and close camera and card."""
        self._held.close()


@dataclass(frozen=True)
class VirtualBench:
    """Ground truth and fault switches of the simulated rig.

    Parameters
    ----------
    optics : OpticalBench
        Scene, galvo, line: ``optics.show(scene)``, ``optics.calibration(preset)``.
    card : VirtualCard or RemoteCard
        ``card.last_volts``, ``card.break_with(code)``.
    plug : Plug
        The camera on the bus: ``plug.unplugged = True``, ``plug.camera.faults``.
    """

    optics: OpticalBench
    card: VirtualCard | RemoteCard
    plug: Plug
