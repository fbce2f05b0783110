"""Failure map of laying the right view onto the left: dim and uneven light, turn, scale, saturation, a dark view."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from benchmarks.choices.pair import METHODS, Lit, judge
from benchmarks.harness.methods import Benchmark, Case, Chart, named, stressed
from benchmarks.rigs.random_rigs import Rig

if TYPE_CHECKING:
    from collections.abc import Callable

_SHOWN = ("cores", "circles", "most lit row and column", "PyFibreBundle find_bundle")


STRESSES: dict[str, tuple[tuple[float, ...], Callable[[Rig, float], Rig]]] = {
    "electrons of the brightest pixel": ((300, 30, 10, 3), Rig.with_photons),
    "turn of the right view / degrees": ((0.2, 1, 2, 4), lambda rig, x: replace(rig, turn_deg=x)),
    "scale of the right view / %": ((0.5, 2, 5), lambda rig, x: replace(rig, scale=1 + x / 100)),
    "fall of the light across the bundle": ((0.3, 0.6, 0.9), lambda rig, x: replace(rig, uneven=x)),
    "over-exposure, times": ((1, 2, 4, 8), Rig.over_exposed),
    "brightness of the right view": ((0.8, 0.4, 0.1), lambda rig, x: replace(rig, gain=x)),
}
"""Levels of each stress, and a rig under one."""


def _cases(quick: bool) -> list[Case]:
    drawn = (Rig.draw(seed).with_photons(300.0) for seed in range(1 if quick else 8))
    rigs = [replace(rig, turn_deg=0.0, scale=1.0) for rig in drawn]

    def case(make: Callable[[Rig, float], Rig], level: float) -> Case:
        return Case("", [Lit(rig.bundle(1)[0], rig) for rig in (make(rig, level) for rig in rigs)])

    made = {group: (levels, partial(case, make)) for group, (levels, make) in STRESSES.items()}
    return stressed(made, worst=1 if quick else None)


BENCHMARK = Benchmark(
    name="stability-pair",
    question="Where laying the right view onto the left fails, in % of the frames",
    error_label="largest misplacement / px",
    cases=_cases,
    methods=named(METHODS, _SHOWN),
    judge=judge,
    chart=Chart.FAILURES,
    seconds=0.0,
    remarks="A failure is a misplacement of more than half a pixel at the rim: the difference then shows the cores.",
)
