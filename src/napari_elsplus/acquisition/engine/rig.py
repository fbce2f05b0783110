"""What the engine asks of a rig."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from napari_elsplus.hardware.parking import ParkOrder
    from napari_elsplus.hardware.protocols import Camera, Scanner
    from napari_elsplus.hardware.rig import VirtualBench
    from napari_elsplus.hardware.scan.timing import StrobePhase
    from napari_elsplus.hardware.scan.waveform import GalvoLimits


class EngineRig(Protocol):
    """A camera and a mirror that belong together."""

    @property
    def name(self) -> str:
        """Name by which the rig is chosen."""

    @property
    def camera(self) -> Camera:
        """The camera."""

    @property
    def scanner(self) -> Scanner:
        """The mirror."""

    @property
    def limits(self) -> GalvoLimits:
        """What the mirror may be asked for."""

    @property
    def strobe(self) -> StrobePhase:
        """What the camera's strobe marks."""

    @property
    def park(self) -> ParkOrder | None:
        """What has to be done if this process dies; None if nothing moves."""

    @property
    def bench(self) -> VirtualBench | None:
        """What is behind a simulated rig; None for a real one."""

    def close(self) -> None:
        """Park and let everything go."""
