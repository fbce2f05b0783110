"""Latency of the live engine, from the camera's last byte to the image in the display's ring."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, NamedTuple

from benchmarks.harness.methods import Benchmark, Case, Chart, Claim, Judgement, Method, Role, TimedElsewhere
from benchmarks.rigs.engine_run import SETTLE_S, EngineRun, run_engine
from benchmarks.rigs.engines import Apart, Here
from napari_elsplus.instrument.optics import preset

if TYPE_CHECKING:
    from collections.abc import Callable

SECONDS: Final = 12.0
QUICK_SECONDS: Final = 1.0
PERCENTILES: Final = {"p50": "50", "p90": "90", "p99": "99", "p999": "99.9", "max": "100"}
BUSY_S: Final = 12e-3
"""Time for which a window draws, s."""


class Stream(NamedTuple):
    """Settings of the camera, and the duration of the stream."""

    preset_name: str
    seconds: float
    settle_s: float


def _cases(quick: bool) -> list[Case]:
    seconds, settle_s = (QUICK_SECONDS, 0.5) if quick else (SECONDS, SETTLE_S)
    shapes = {name: preset(name).frame_shape for name in (("240hz",) if quick else ("240hz", "120hz"))}
    return [
        Case(f"{name}, {rows} x {cols}", [Stream(name, seconds, settle_s)]) for name, (rows, cols) in shapes.items()
    ]


def _in(
    engine: type[Apart | Here], between: Callable[[], None] = lambda: None
) -> Callable[[Case], Callable[[Stream], TimedElsewhere]]:
    """Return the preparation of an engine, beside which whoever looks on does something else between two looks."""

    def stream(item: Stream) -> TimedElsewhere:
        run = run_engine(engine(item.preset_name), item.seconds, settle_s=item.settle_s, between=between)
        return TimedElsewhere(run, 1e-6 * run.cpu_us_per_frame)

    return lambda _: stream


def _be_busy() -> None:
    """Compute in Python for as long as a window takes to draw."""
    until_s = time.perf_counter() + BUSY_S
    while time.perf_counter() < until_s:
        sum(range(200))


def judge(_: Stream, run: EngineRun) -> Judgement:
    """Latency that one frame in a hundred exceeds; a run that loses a frame has failed."""
    latency_ms = run.status.latency_ms
    quantiles = {f"{percent} % / ms": getattr(latency_ms, name) for name, percent in PERCENTILES.items()}
    return Judgement(
        latency_ms.p99,
        failed=run.lost > 0,
        claim=Claim.DOUBTFUL if run.lost else Claim.SURE,  # the engine has counted them
        details={**quantiles, "lost": run.lost, "camera / Hz": run.status.mean_hz},
    )


METHODS = (
    Method("in a process of its own", Role.DEFAULT, _in(Apart)),
    Method("in a script's process", Role.OPTION, _in(Here)),
    Method("in the process of a busy window", Role.OPTION, _in(Here, _be_busy)),
)

BENCHMARK = Benchmark(
    name="engine",
    question="How late a frame's result is",
    error_label="latency of the slowest hundredth / ms",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    chart=Chart.LATENCY,
    remarks=(
        f"The whole live path for {SECONDS:g} s: virtual camera and card, the real drivers, the ring of raw frames, "
        "sectioning, and the display's ring, which is read 60 times a second. Time is the processor time of all "
        "threads of the engine's process for each frame; the simulator, which copies rendered frames to a virtual bus, "
        f"is in it. A busy window is a thread that computes in Python for {1e3 * BUSY_S:g} ms between two looks."
    ),
    seconds=0.0,
    waits=True,
)
