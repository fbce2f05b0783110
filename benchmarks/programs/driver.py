"""The camera's driver alone: frames through pyusb from a virtual camera whose sensor costs nothing.

Run with asv, or by hand: ``python -m benchmarks.programs.driver [SECONDS]``.
"""

from __future__ import annotations

import sys
import time

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

    def __init__(self, real_time: bool):
        self.clock = BenchClock(real_time)

    def strobe(self, train):
        pass

    def prepare(self, shot):
        pass

    def expose(self, shot, out):
        pass


class Streaming:
    """Frames of a preset, paced by the camera, or as fast as they go."""

    params = (list(PRESETS), (True, False))
    param_names = ("preset", "paced")
    seconds = 2.0

    def setup(self, preset, paced):
        chosen = PRESETS[preset]
        self.rate_hz = chosen.optics.frame_rate_hz
        bus = VirtualBus(Plug(VirtualCamera(DarkBench(paced))))
        self.camera = U3vCamera(choose_camera("", bus), Flea3, wait_for_reader=not paced)
        region = Region(*chosen.sensor_origin, *chosen.frame_shape)
        self.camera.configure(region, slit_rows=3, frame_rate_hz=self.rate_hz)
        self.buffer = np.empty(chosen.frame_shape, np.uint8)
        self.camera.start()
        for _ in range(10):
            self.camera.read_into(self.buffer, 5.0)

    def teardown(self, *_):
        self.camera.close()

    def run(self):
        """Frames per second, processor time per frame (ms), frames that are missing."""
        frames = round(self.seconds * self.rate_hz)
        wall, cpu = time.perf_counter(), time.process_time()
        numbers = [self.camera.read_into(self.buffer, 5.0).frame_number for _ in range(frames)]
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        return frames / wall, 1e3 * cpu / frames, numbers[-1] - numbers[0] + 1 - frames

    def track_frames_per_second(self, *_):
        return self.run()[0]

    def track_processor_milliseconds_per_frame(self, *_):
        return self.run()[1]

    def track_missing_frames(self, *_):
        return self.run()[2]


def main() -> None:
    Streaming.seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    for preset in Streaming.params[0]:
        for paced in Streaming.params[1]:
            case = Streaming()
            case.setup(preset, paced)
            rate, cpu, missing = case.run()
            case.teardown()
            how = "paced by the camera" if paced else "as fast as they go"
            rows, cols = PRESETS[preset].frame_shape
            click.echo(
                f"{rows} x {cols}, {how}: {rate:.1f} frames/s, {cpu:.2f} ms of a core a frame, {missing} missing"
            )


if __name__ == "__main__":
    main()
