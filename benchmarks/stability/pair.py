"""Failure map of laying the right view onto the left: dim and uneven light, turn, scale, saturation, a dark view."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from benchmarks.choices.pair import METHODS, Lit, judge
from benchmarks.harness.methods import Benchmark, Case, Chart, named, stressed
from benchmarks.rigs.random_rigs import Rig

_SHOWN = ("cores", "circles", "most lit row and column", "PyFibreBundle find_bundle")


def _stressed(seed: int, stress: str, level: float) -> Lit:
    rig = replace(Rig.draw(seed).with_photons(300.0), turn_deg=0.0, scale=1.0)
    match stress:
        case "electrons":
            rig = rig.with_photons(level)
        case "turn":
            rig = replace(rig, turn_deg=level)
        case "scale":
            rig = replace(rig, scale=1 + level / 100)
        case "uneven":
            rig = replace(rig, uneven=level)
        case "exposure":
            rig = replace(rig, electrons_per_dn=rig.electrons_per_dn / level)
        case "gain":
            rig = replace(rig, gain=level)
    return Lit(rig.bundle(1)[0], rig)


def _cases(quick: bool) -> list[Case]:
    stresses: dict[str, tuple[str, tuple[float, ...]]] = {
        "electrons of the brightest pixel": ("electrons", (300, 30, 10, 3)),
        "turn of the right view / degrees": ("turn", (0.2, 1, 2, 4)),
        "scale of the right view / %": ("scale", (0.5, 2, 5)),
        "fall of the light across the bundle": ("uneven", (0.3, 0.6, 0.9)),
        "over-exposure, times": ("exposure", (1, 2, 4, 8)),
        "brightness of the right view": ("gain", (0.8, 0.4, 0.1)),
    }
    seeds = range(1 if quick else 8)

    def case(kind: str, level: float) -> Case:
        return Case("", [_stressed(seed, kind, level) for seed in seeds])

    made = {group: (levels, partial(case, kind)) for group, (kind, levels) in stresses.items()}
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
