"""Failure map of finding the laser line: dim light, tilt, halo, saturation, a line near the rim."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from benchmarks.choices.line import METHODS, frame, judge
from benchmarks.harness.methods import Benchmark, Case, Chart, stressed
from benchmarks.rigs.random_rigs import Rig

if TYPE_CHECKING:
    from benchmarks.choices.line import Frame


def _stressed(seed: int, stress: str, level: float) -> Frame:
    rig = Rig.draw(seed).with_photons(300.0)
    match stress:
        case "electrons":
            return frame(rig.with_photons(level))
        case "tilt":
            return frame(replace(rig, tilt_deg=level))
        case "halo":
            return frame(replace(rig, halo_share=level))
        case "exposure":
            return frame(replace(rig, electrons_per_dn=rig.electrons_per_dn / level))
    return frame(rig, level * rig.diameter_px / 2)


def _cases(quick: bool) -> list[Case]:
    stresses: dict[str, tuple[str, tuple[float, ...]]] = {
        "electrons of the brightest pixel": ("electrons", (300, 30, 10, 3, 1)),
        "tilt / degrees": ("tilt", (0, 2, 4, 6)),
        "light in the halo": ("halo", (0.3, 0.6, 0.8, 0.95)),
        "over-exposure, times": ("exposure", (1, 4, 16, 64)),
        "distance from the centre / radii": ("rim", (0.5, 0.8, 0.95, 1.1)),
    }
    seeds = range(2 if quick else 12)

    def case(kind: str, level: float) -> Case:
        return Case("", [_stressed(seed, kind, level) for seed in seeds])

    made = {group: (levels, partial(case, kind)) for group, (kind, levels) in stresses.items()}
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
