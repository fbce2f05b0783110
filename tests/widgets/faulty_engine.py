"""The engine's process with the simulated rig and a camera that sees what a fault makes of the frames; run by path.

Arguments: a file that names the fault in force, read for every frame, and one in which the mirror's moves are noted.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np

from napari_elsplus.acquisition.calibrating import capture
from napari_elsplus.acquisition.calibrating.simulated import open_live
from napari_elsplus.acquisition.link import server as process
from napari_elsplus.errors import DeviceError

BLACK = 4
capture.SEARCH_VOLTAGES = 21  # type: ignore[misc] # the simulated bundle, a fifth of the range, is met by four


class FaultyCamera:
    """A camera in front of which something is wrong."""

    def __init__(self, camera: Any, fault: Path) -> None:
        self._camera, self._fault = camera, fault
        self._random = np.random.default_rng(0)
        self._frames = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._camera, name)

    def read_into(self, buffer: np.ndarray, timeout_s: float) -> Any:
        info = self._camera.read_into(buffer, timeout_s)
        match self._fault.read_text():
            case "over-exposed":
                np.copyto(buffer, np.where(buffer > BLACK + 4, 255, buffer))
            case "laser off":
                buffer[:] = BLACK + self._random.integers(-1, 2, buffer.shape, np.int8)
            case "right view blocked":
                buffer[:, buffer.shape[1] // 2 :] = BLACK
            case "unplugged" if self._frames > 20:
                raise DeviceError("the camera was unplugged", "plug it in and connect again")
            case "unplugged":
                self._frames += 1
        return info


def open_rig(name: str) -> Any:
    rig = open_live(name)
    fault, moves = (Path(argument) for argument in sys.argv[1:])
    rig.camera = FaultyCamera(rig.camera, fault)
    for move in ("hold", "scan", "park"):
        setattr(rig.scanner, move, noted(getattr(rig.scanner, move), move, moves))
    return rig


def noted(method: Any, move: str, moves: Path) -> Any:
    def noting(*arguments: Any) -> None:
        method(*arguments)
        with moves.open("a") as file:
            file.write(f"{move}\n")

    return noting


if __name__ == "__main__":
    runpy.run_path(str(Path(__file__).parents[1] / "patience.py"))["be_patient"]()
    process.run(open_rig)
