"""Rendering raw frames: does the model instrument keep up with the camera, on one core, and in how much memory?

Run with asv, or by hand: ``NUMBA_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python -m benchmarks.programs.rendering``.
"""

from __future__ import annotations

import resource
import time

import click
import cv2
import numpy as np

from napari_elsplus.acquisition.calibrating.simulated import PATH
from napari_elsplus.hardware.virtual.steady_scan import steady_line_rows
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.specimen.trajectories import trajectory


class Rendering:
    """Frames of a moving probe, the scan as it should be."""

    params = (["240hz", "120hz"], ["fibres", "nuclei"], ["still", "hand"])
    param_names = ("preset", "scene", "path")
    frames = 300

    def setup(self, preset, scene_name, path):
        cv2.setNumThreads(1)
        self.renderer = Renderer(Instrument.of(preset), scene(scene_name), trajectory(path), seed=1)
        self.frame = np.empty(self.renderer.frame_shape, np.uint8)
        self.renderer.render(0, self.frame)

    def waits(self):
        """Seconds of one core's time that each frame takes: what others do on the machine is left out."""
        waits = []
        for k in range(1, self.frames + 1):
            start = time.thread_time()
            self.renderer.render(k, self.frame)
            waits.append(time.thread_time() - start)
        return np.array(waits)

    def track_frames_per_second(self, *_):
        return 1 / np.median(self.waits())

    track_frames_per_second.unit = "frames/s"


class NewLine(Rendering):
    """The price of a line that moves otherwise than in the frame before."""

    params = (["240hz", "120hz"], ["fibres", "empty"], ["still"])

    def track_milliseconds(self, *_):
        rows = np.arange(self.renderer.frame_shape[0], dtype=float)
        waits = []
        for k in range(20):
            start = time.thread_time()
            self.renderer.render(k, self.frame, line_rows=rows + 0.5 * (k + 1))
            waits.append(time.thread_time() - start)
        return 1e3 * np.median(waits)

    track_milliseconds.unit = "ms"


class Imperfect(Rendering):
    """Frames of the rigs ``simulated-real:SEED`` on the path of their live images, scanned with a single lag."""

    params = ([1, 3, 7], ["rendered anew", "light from memory", "even target", "even target, new line"])
    param_names = ("seed", "case")
    frames = 200

    def setup(self, seed, case):
        cv2.setNumThreads(1)
        instrument = Instrument.of("240hz", imperfections=Imperfections.drawn(seed))
        even = case.startswith("even")
        self.renderer = Renderer(instrument, scene("uniform" if even else "fibres"), None if even else PATH, seed=1)
        self.frame = np.empty(self.renderer.frame_shape, np.uint8)
        self.rows, self.moves = steady_line_rows(instrument), case.endswith("new line")
        light = np.empty(self.renderer.light_shape, np.float32)
        self.light = light if case == "light from memory" else None
        if self.light is not None:
            self.renderer.core_light(0, self.light, line_rows=self.rows)
        for k in range(420):  # a round: jitters and tissue are known afterwards
            self.renderer.render(k, self.frame, line_rows=self.rows, light=self.light)

    def waits(self):
        waits = []
        for k in range(420, 420 + self.frames):
            rows = self.rows + 1.5 * (k % 60 - 30) if self.moves else self.rows
            start = time.thread_time()
            self.renderer.render(k, self.frame, line_rows=rows, light=self.light)
            waits.append(time.thread_time() - start)
        return np.array(waits)


def main() -> None:
    for preset in Rendering.params[0]:
        for scene_name in Rendering.params[1]:
            for path in Rendering.params[2]:
                case = Rendering()
                case.setup(preset, scene_name, path)
                waits = 1e3 * case.waits()
                best, p50, p99 = np.quantile(waits, (0, 0.5, 0.99))
                click.echo(
                    f"{preset} {scene_name:7} {path:6} {1e3 / best:4.0f} frames/s undisturbed, {1e3 / p50:4.0f} at the "
                    f"median; best {best:.2f}, p50 {p50:.2f}, p99 {p99:.2f}, max {waits.max():.1f} ms"
                )
    for preset in NewLine.params[0]:
        for scene_name in NewLine.params[1]:
            new_line = NewLine()
            new_line.setup(preset, scene_name, "still")
            click.echo(f"{preset} {scene_name:7} a new line pattern: {new_line.track_milliseconds():.1f} ms")
    for seed in Imperfect.params[0]:
        for case in Imperfect.params[1]:
            imperfect = Imperfect()
            imperfect.setup(seed, case)
            p50, p99 = 1e3 * np.quantile(imperfect.waits(), (0.5, 0.99))
            click.echo(
                f"240hz simulated-real:{seed} {case}: p50 {p50:.2f} ms, {1e3 / p50:.0f} frames/s; p99 {p99:.2f} ms"
            )
    click.echo(f"largest memory of the process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
