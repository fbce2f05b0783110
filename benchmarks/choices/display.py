"""Display rate of live images in napari against the number of layers, divided into update and drawing."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from benchmarks.harness.methods import Absent, Benchmark, Case, Chart, Judgement, Method, Role, TimedElsewhere

if TYPE_CHECKING:
    from collections.abc import Callable

PROGRAM: Final = "benchmarks.rigs.display_rate"
SCREEN: Final = ("xvfb-run", "-a", "-s", "-screen 0 1920x1280x24")
MAX_LAYERS: Final = 5
SMALL_PX, LARGE_PX = 150, 900
_PATIENCE_S: Final = 240


class Shown(NamedTuple):
    """Number of layers, its maximum, and the duration."""

    layers: int
    most: int
    seconds: float


def _cases(quick: bool) -> list[Case]:
    most, seconds = (1, 0.5) if quick else (MAX_LAYERS, 4.0)
    return [
        Case(f"{layers} layer{'s' * (layers > 1)}", [Shown(layers, most, seconds)], level=layers, group="layers")
        for layers in range(1, most + 1)
    ]


def _on_a_canvas(size_px: int) -> Callable[[Case], Callable[[Shown], TimedElsewhere]]:
    def prepare(case: Case) -> Callable[[Shown], TimedElsewhere]:
        item: Shown = case.items[0]
        rates = [rate for rate in _measured(item.most, item.seconds) if rate["wanted_px"] == size_px]

        def run(shown: Shown) -> TimedElsewhere:
            rate = rates[shown.layers - 1]
            return TimedElsewhere(rate, 1e-3 * rate["update_ms"])

        return run

    return prepare


@cache
def _measured(most: int, seconds: float) -> list[dict[str, Any]]:
    """Open a window in a process of its own, on the screen or, where there is none, on a virtual one."""
    options = ("--layers", most, "--seconds", seconds, "--canvas", SMALL_PX, LARGE_PX)
    program = [sys.executable, "-m", PROGRAM, *map(str, options)]
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        if shutil.which(SCREEN[0]) is None:
            raise Absent("there is no screen, and no xvfb-run", "install xvfb, or run this on a desktop")
        program = [*SCREEN, *program]
    with tempfile.TemporaryDirectory() as box:
        own = {"NAPARI_CONFIG": str(Path(box) / "napari.yaml"), "ELSPLUS_CONFIG": str(Path(box) / "settings")}
        try:
            done = subprocess.run(
                program, env={**os.environ, **own}, capture_output=True, text=True, timeout=_PATIENCE_S, check=True
            )
        except subprocess.TimeoutExpired:
            raise Absent(f"no window came to its end within {_PATIENCE_S} s", "is the machine busy?") from None
        except subprocess.CalledProcessError as error:
            said = error.stderr.strip().splitlines() or [str(error)]
            raise Absent(f"no window opens here ({said[-1]})", "see `napari-elsplus doctor`") from None
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def judge(_: Shown, rate: dict[str, Any]) -> Judgement:
    """Time between two images that are shown; a frame that the engine lost is a failure."""
    return Judgement(
        1e3 / rate["display_hz"],
        failed=rate["lost"] > 0,
        details={
            "display / Hz": rate["display_hz"],
            "canvas drawn / Hz": rate["drawn_hz"],
            "update / ms": rate["update_ms"],
            "drawing and all else / ms": rate["window_ms"] - rate["update_ms"],
            "camera / Hz": rate["camera_hz"],
            "engine's p99 / ms": rate["latency_p99_ms"],
            "tick p99 / ms": rate["tick_p99_ms"],
            "Stop displayed / s": rate["stop_s"],
            "lost": rate["lost"],
        },
    )


BENCHMARK = Benchmark(
    name="display",
    question="How often live images are shown",
    error_label="time between images / ms",
    cases=_cases,
    methods=(
        Method(f"canvas of {SMALL_PX} px", Role.DEFAULT, _on_a_canvas(SMALL_PX)),
        Method(f"canvas of {LARGE_PX} px", Role.OPTION, _on_a_canvas(LARGE_PX)),
    ),
    judge=judge,
    chart=Chart.LEVELS,
    remarks=(
        "The Live panel in a napari window, the engine in its process, the simulated rig at 240 Hz. Time is what our "
        "update of all layers takes: copying out of the ring, notifying napari. All else is the processor time of the "
        "window's thread for each image, drawing included. The ticks are those of a timer of 16 ms in the window; Stop "
        "is pressed by the mouse. Where OpenGL is drawn by software, as on a virtual screen, "
        "a large canvas is limited by drawing; the small one leaves that out, and stands for a graphics card."
    ),
    seconds=0.0,
    waits=True,
)
