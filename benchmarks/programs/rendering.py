"""Rendering of raw frames on one core: whether the model instrument keeps up with the camera, and its memory.

``NUMBA_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python3 run.py bench rendering``. Times are one core's processor time:
what others do on the machine is left out.
"""

from __future__ import annotations

import time
from itertools import product
from typing import TYPE_CHECKING, Final

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

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

PRESETS: Final = ("240hz", "120hz")
FRAMES: Final = 300
NEW_LINES: Final = 20
"""Frames of which each has the line at other rows than the one before."""
IMPERFECT_SEEDS: Final = (1, 3, 7)
IMPERFECT_CASES: Final = ("rendered anew", "light from memory", "even target", "even target, new line")
IMPERFECT_FRAMES: Final = 200
ROUND: Final = 420
"""Frames that are rendered before those of an imperfect rig: jitters and tissue are known afterwards."""


def times_ms(
    renderer: Renderer, lines: Iterable[Array | None], first: int = 1, light: NDArray[np.float32] | None = None
) -> Array:
    """Return the milliseconds that each frame takes, with the line at these rows in it; None: as it should be."""
    frame, times = np.empty(renderer.frame_shape, np.uint8), []
    for number, rows in enumerate(lines, first):
        start_s = time.thread_time()
        renderer.render(number, frame, line_rows=rows, light=light)
        times.append(1e3 * (time.thread_time() - start_s))
    return np.array(times)


def imperfect_times_ms(seed: int, case: str) -> Array:
    """Return the times of frames of the rig ``simulated-real:SEED`` on the path of its live images, after a round."""
    instrument = Instrument.of("240hz", imperfections=Imperfections.drawn(seed))
    even = case.startswith("even")
    renderer = Renderer(instrument, scene("uniform" if even else "fibres"), None if even else PATH, seed=1)
    rows, light = steady_line_rows(instrument), None
    if case == "light from memory":
        light = np.empty(renderer.light_shape, np.float32)
        renderer.core_light(0, light, line_rows=rows)
    times_ms(renderer, [rows] * ROUND, 0, light)
    moved_rows = 1.5 * (np.arange(IMPERFECT_FRAMES) % 60 - 30) if case.endswith("new line") else [0] * IMPERFECT_FRAMES
    return times_ms(renderer, (rows + moved for moved in moved_rows), ROUND, light)


@click.command()
def rendering() -> None:
    """Render frames of each preset, of other lines, and of imperfect rigs: time of each, and memory."""
    import resource  # which Windows has not

    cv2.setNumThreads(1)
    for preset, name, path in product(PRESETS, ("fibres", "nuclei"), ("still", "hand")):
        renderer = Renderer(Instrument.of(preset), scene(name), trajectory(path), seed=1)
        times_ms(renderer, [None], 0)
        taken = times_ms(renderer, [None] * FRAMES)
        best, p50, p99 = np.quantile(taken, (0, 0.5, 0.99))
        click.echo(
            f"{preset} {name:7} {path:6} {1e3 / best:4.0f} frames/s undisturbed, {1e3 / p50:4.0f} at the "
            f"median; best {best:.2f}, p50 {p50:.2f}, p99 {p99:.2f}, max {taken.max():.1f} ms"
        )
    for preset, name in product(PRESETS, ("fibres", "empty")):
        renderer = Renderer(Instrument.of(preset), scene(name), trajectory("still"), seed=1)
        times_ms(renderer, [None], 0)
        rows = np.arange(renderer.frame_shape[0], dtype=float)
        taken = times_ms(renderer, (rows + 0.5 * (k + 1) for k in range(NEW_LINES)), 0)
        click.echo(f"{preset} {name:7} a new line pattern: {np.median(taken):.1f} ms")
    for seed, case in product(IMPERFECT_SEEDS, IMPERFECT_CASES):
        p50, p99 = np.quantile(imperfect_times_ms(seed, case), (0.5, 0.99))
        click.echo(f"240hz simulated-real:{seed} {case}: p50 {p50:.2f} ms, {1e3 / p50:.0f} frames/s; p99 {p99:.2f} ms")
    click.echo(f"largest memory of the process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
