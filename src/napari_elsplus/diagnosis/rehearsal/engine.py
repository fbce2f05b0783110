"""The engine's process in the rehearsal: the unmodified server, and switches for faults of the simulated devices.

Run as ``python -m napari_elsplus.diagnosis.rehearsal.engine``.
"""

from __future__ import annotations

import sys
import threading
import time
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.acquisition.engine.live_images import LiveImages
from napari_elsplus.acquisition.link.server import run
from napari_elsplus.acquisition.mosaic.tracking import LiveTrack
from napari_elsplus.diagnosis.rehearsal.messages import Exposures, answer_requests, report_to_rehearsal
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.virtual.bench import Simulation
from napari_elsplus.io import RecordingWriter
from napari_elsplus.simulation.specimen.scenes import fibres
from napari_elsplus.simulation.specimen.trajectories import Circle

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.hardware.rig import Rig
    from napari_elsplus.hardware.virtual.camera.device import Shot

PATH: Final = Circle(diameter_um=20.0, period_s=8 / 120)
"""Path of the probe; chosen: eight frames at 120 Hz and sixteen at 240 Hz, rendered in little time, then repeat."""

SLOWED: Final[dict[str, tuple[type, str]]] = {"disk": (RecordingWriter, "append"), "images": (LiveImages, "__init__")}
"""Methods that a switch can delay."""
FAILING: Final[dict[str, tuple[type, str]]] = {"recorder": (RecordingWriter, "append"), "tracker": (LiveTrack, "add")}
"""Methods that a switch can let fail."""


class Switches:
    """Faults of the simulated devices; the time of the answer is that of the fault.

    Parameters
    ----------
    rig : Rig
        The simulated rig.
    """

    def __init__(self, rig: Rig) -> None:
        assert rig.bench is not None
        self._rig, self._plug = rig, rig.bench.plug
        self._exposures: Exposures | None = None
        self._delayed: dict[str, Any] = {}
        expose = rig.bench.optics.expose

        def noting(shot: Shot, out: NDArray[np.uint8]) -> None:
            known = self._exposures
            first_s = shot.read_out_s if known is None or shot.frame <= known.frame else known.first_read_out_s
            self._exposures = Exposures(shot.frame, shot.read_out_s, shot.frame_period_s, first_s)
            expose(shot, out)

        rig.bench.optics.expose = noting  # type: ignore[method-assign]

    def unplug(self) -> None:
        """Unplug the camera."""
        self._plug.unplugged = True

    def cut_strobe(self) -> None:
        """Cut the wire of the camera's strobe."""
        self._plug.camera.cut_strobe()

    def camera(self, **faults: int) -> None:
        """Set faults of the camera; see `napari_elsplus.hardware.virtual.camera.device.CameraFaults`."""
        for name, value in faults.items():
            setattr(self._plug.camera.faults, name, value)

    def exposures(self) -> Exposures | None:
        """Return when the camera took its frames; None before the first."""
        return self._exposures

    def guardian(self) -> tuple[int, bool]:
        """Return the process id of the guardian, and True if it is on guard."""
        guardian = self._rig.guardian
        return (0, False) if guardian is None else (guardian.pid, guardian.on_guard)

    def delay(self, where: str, seconds: float) -> None:
        """Let every append to a recording, or every new maker of live images (`where`), take some `seconds` longer."""
        owner, method = SLOWED[where]
        self._delayed[where] = getattr(owner, method)
        _before(owner, method, lambda: time.sleep(seconds))

    def quicken(self, where: str) -> None:
        """End a delay, where it was made."""
        setattr(*SLOWED[where], self._delayed.pop(where))

    def fail(self, where: str) -> None:
        """Let `where`, recorder or tracker, fail with an error that no caller expects."""

        def raise_defect() -> None:
            raise ValueError("rehearsed defect")

        _before(*FAILING[where], raise_defect)

    def fill_disk(self) -> None:
        """Let files grow no further: the system refuses every write beyond their size."""
        if sys.platform != "win32":  # which leaves this fault out
            import resource

            resource.setrlimit(resource.RLIMIT_FSIZE, (1, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))


def _before(owner: type, name: str, act: Callable[[], None]) -> None:
    """Let a method of a class first act."""
    method = getattr(owner, name)

    def acting(*arguments: Any, **options: Any) -> Any:
        act()
        return method(*arguments, **options)

    setattr(owner, name, acting)


def open_rehearsed(name: str) -> Rig:
    """Open the simulated rig under any name, its card in a process of its own, and report to the rehearsal."""
    rig = open_rig(name, Simulation(scene=fibres(), trajectory=PATH, own_process=True))
    assert rig.bench is not None
    connection = report_to_rehearsal("engine", place=rig.bench.card.place)  # type: ignore[union-attr] # it is remote
    arguments = connection, Switches(rig)
    threading.Thread(target=answer_requests, args=arguments, name="fault switches", daemon=True).start()
    return rig


if __name__ == "__main__":
    run(open_rehearsed)
