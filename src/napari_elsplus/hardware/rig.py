"""An open rig: camera, scanner and their limits under one name."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Self

if TYPE_CHECKING:
    from napari_elsplus.hardware.parking import ParkOrder
    from napari_elsplus.hardware.protocols import Camera, Scanner
    from napari_elsplus.hardware.scan.timing import StrobePhase
    from napari_elsplus.hardware.scan.waveform import GalvoLimits
    from napari_elsplus.hardware.virtual.bench import OpticalBench
    from napari_elsplus.hardware.virtual.camera.bus import Plug
    from napari_elsplus.hardware.virtual.card.card import VirtualCard
    from napari_elsplus.hardware.virtual.card.process import RemoteCard

SIMULATED: Final = "simulated"


@dataclass
class Rig:
    """An open rig. A context manager: leaving it parks the mirror and lets everything go.

    Parameters
    ----------
    name : str
        Under which it was opened.
    camera, scanner : Camera, Scanner
        The devices.
    limits : GalvoLimits
        What the mirror may be asked for.
    strobe : StrobePhase
        What the camera's strobe marks.
    park : ParkOrder
        What has to be done if this process dies.
    bench : VirtualBench, optional
        The simulated rig's truth, and its switches for faults.
    """

    name: str
    camera: Camera
    scanner: Scanner
    limits: GalvoLimits
    strobe: StrobePhase
    park: ParkOrder
    bench: VirtualBench | None = None
    _held: ExitStack = field(default_factory=ExitStack, repr=False)

    def close(self) -> None:
        """Park, and let camera and card go."""
        self._held.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> Any:
        self.close()


@dataclass(frozen=True)
class VirtualBench:
    """The simulated rig, seen from behind: truth for tests, and switches for faults.

    Parameters
    ----------
    optics : OpticalBench
        Scene, galvo, line: ``optics.show(scene)``, ``optics.calibration(preset)``, ``optics.line_row_now(preset)``.
    card : VirtualCard or RemoteCard
        ``card.last_volts``, ``card.break_with(code)``.
    plug : Plug
        The camera on the bus: ``plug.unplugged = True``, ``plug.camera.faults``.
    """

    optics: OpticalBench
    card: VirtualCard | RemoteCard
    plug: Plug
