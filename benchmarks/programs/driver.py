"""The camera's driver alone, with a virtual camera whose sensor costs nothing: ``python3 run.py bench driver``."""

from __future__ import annotations

import time
from itertools import product

import click
import numpy as np

from napari_elsplus.hardware.protocols import Region
from napari_elsplus.hardware.u3v.camera import U3vCamera
from napari_elsplus.hardware.u3v.discovery import choose_camera
from napari_elsplus.hardware.u3v.flea3 import Flea3
from napari_elsplus.hardware.virtual.camera.bus import Plug, VirtualBus
from napari_elsplus.hardware.virtual.camera.device import VirtualCamera
from napari_elsplus.hardware.virtual.timeline import BenchClock
from napari_elsplus.instrument.optics import PRESETS


class DarkBench:
    """A sensor that sees nothing: what is measured is the driver and the copying."""

    def __init__(self, real_time: bool) -> None:
        self.clock = BenchClock(real_time)

    def strobe(self, train: object) -> None:
        """Receive a train of edges."""

    def prepare(self, shot: object) -> None:
        """Prepare for frames like a shot."""

    def expose(self, shot: object, out: object) -> None:
        """Leave the frame as it is."""


@click.command()
@click.option("--seconds", default=10.0, show_default=True, help="Of frames at each preset's rate.")
def driver(seconds: float) -> None:
    """Read frames by the camera's driver, at its pace and as fast as they go: rate, processor time, gaps."""
    for preset, paced in product(PRESETS.values(), (True, False)):
        bus = VirtualBus(Plug(VirtualCamera(DarkBench(paced))))
        camera = U3vCamera(choose_camera("", bus), Flea3, wait_for_reader=not paced)
        rate_hz, (rows, cols) = preset.optics.frame_rate_hz, preset.frame_shape
        camera.configure(Region(*preset.sensor_origin, rows, cols), slit_rows=3, frame_rate_hz=rate_hz)
        buffer, frames = np.empty((rows, cols), np.uint8), round(seconds * rate_hz)
        camera.start()
        for _ in range(10):
            camera.read_into(buffer, 5.0)
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        numbers = [camera.read_into(buffer, 5.0).frame_number for _ in range(frames)]
        wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
        camera.close()
        click.echo(
            f"{rows} x {cols}, {'paced by the camera' if paced else 'as fast as they go'}: {frames / wall_s:.1f} "
            f"frames/s, {1e3 * cpu_s / frames:.2f} ms of a core a frame, "
            f"{numbers[-1] - numbers[0] + 1 - frames} missing"
        )
