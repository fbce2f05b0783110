"""Failure map of finding the laser line: dim light, tilt, halo, saturation, a line near the rim."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from benchmarks.choices.line import METHODS, frame, judge
from benchmarks.harness.methods import Benchmark, Case, Chart, stressed
from benchmarks.rigs.random_rigs import Rig

if TYPE_CHECKING:
    from collections.abc import Callable

    from benchmarks.choices.line import Frame

STRESSES: dict[str, tuple[tuple[float, ...], Callable[[Rig, float], Frame]]] = {
    "electrons of the brightest pixel": ((300, 30, 10, 3, 1), lambda rig, x: frame(rig.with_photons(x))),
    "tilt / degrees": ((0, 2, 4, 6), lambda rig, x: frame(replace(rig, tilt_deg=x))),
    "light in the halo": ((0.3, 0.6, 0.8, 0.95), lambda rig, x: frame(replace(rig, halo_share=x))),
    "over-exposure, times": ((1, 4, 16, 64), lambda rig, x: frame(rig.over_exposed(x))),
    "distance from the centre / radii": ((0.5, 0.8, 0.95, 1.1), lambda rig, x: frame(rig, x * rig.diameter_px / 2)),
}
"""Levels of each stress, and the frame of a rig at one."""


def _cases(quick: bool) -> list[Case]:
    rigs = [Rig.draw(seed).with_photons(300.0) for seed in range(2 if quick else 12)]

    def case(make: Callable[[Rig, float], Frame], level: float) -> Case:
        return Case("", [make(rig, level) for rig in rigs])

    made = {group: (levels, partial(case, make)) for group, (levels, make) in STRESSES.items()}
    return stressed(made, worst=1 if quick else None)


BENCHMARK = Benchmark(
    name="stability-line",
    question="Where finding the laser line fails, in % of the frames",
    error_label="error / rows",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    chart=Chart.FAILURES,
    seconds=0.0,
    remarks=(
        "A failure is an error above one row. At 1.1 radii there is no line on the bundle, only its halo: any answer "
        "but a refusal is wrong. The galvo map leaves such frames out as outliers."
    ),
)
