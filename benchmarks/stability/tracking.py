"""Failure map of tracking: speed, acceleration, poor texture, dim light, an empty view on the way.

A track has failed if a link that is more than 3 px off is called tracked (silent), or if less than nine tenths of its
frames are tracked (flagged: the track says so itself, frame by frame).
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.choices.tracking import METHODS, Recorded
from benchmarks.harness.methods import Benchmark, Case, Chart, Claim, Judgement, named, stressed
from benchmarks.rigs.simulated import SimulatedRig, dim, simulated_rig
from napari_elsplus.simulation.accuracy import track_errors
from napari_elsplus.simulation.specimen.scenes import Plane, Scene, fibres
from napari_elsplus.simulation.specimen.textures import Fibres, Mottle
from napari_elsplus.simulation.specimen.trajectories import HandHeld, Straight, Trajectory
from napari_elsplus.simulation.specimen.trajectories import Recorded as RecordedPath

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from napari_elsplus.io import TrackPoint

MIN_TRACKED = 0.9
_SHOWN = ("tracker", "tracker, rolling shutter ignored", "the paper's, in OpenCV, float32", "PyFibreBundle Mosaic")


def judge(item: Recorded, answer: Sequence[TrackPoint]) -> Judgement:
    """Wrong and called tracked, or honestly lost."""
    errors = track_errors(answer, item.true_px)
    tracked = errors.tracked / errors.frames
    details = {"wrong links": float(errors.wrong_links), "tracked / %": 100 * tracked}
    claim = Claim.SURE if errors.wrong_links else Claim.DOUBTFUL if tracked < MIN_TRACKED else Claim.SURE
    failed = errors.wrong_links > 0 or tracked < MIN_TRACKED
    return Judgement(errors.end_error_percent_of_path, failed, claim, details)


def _record(rig: SimulatedRig, looked_at: Scene, path: Trajectory, frames: int, seed: int) -> Recorded:
    return Recorded(rig.recording(looked_at, path, frames, seed=seed), rig.positions_px(path, frames))


def _jerk(acceleration_mm_s2: float, rig: SimulatedRig, seed: int) -> RecordedPath:
    """Return a path that is sped up and slowed down by that acceleration in turn, every 12 frames."""
    period_s = rig.instrument.optics.frame_period_s
    times_s = np.arange(0, 200 * period_s, period_s / 8)
    sign = np.where(np.floor(times_s / (12 * period_s)).astype(int) % 4 < 2, 1.0, -1.0)
    sign = np.roll(sign, len(sign) // 9 * (seed + 1))
    speed = 1500.0 + np.cumsum(sign * 1000 * acceleration_mm_s2) * (times_s[1] - times_s[0])
    along = np.cumsum(speed) * (times_s[1] - times_s[0])
    angle = 0.9 * seed + 0.4
    return RecordedPath(times_s, np.outer(along, [np.sin(angle), np.cos(angle)]))


def _islands(gap_um: float) -> Scene:
    """Tissue whose in-focus fibres are few and apart, over soft light from far below."""
    per_mm2 = (1000.0 / gap_um) ** 2
    return Scene((Plane(Fibres(per_mm2=per_mm2, length_um=200, seed=6)), Plane(Mottle(seed=6), depth_um=200)))


def _cases(quick: bool) -> list[Case]:
    rig = simulated_rig()
    frames, seeds = (8, 1) if quick else (48, 3)
    stresses: dict[str, tuple[tuple[float, ...], Callable[[float, int], Recorded]]] = {
        "speed / mm/s": (
            (2, 10, 20, 40), lambda x, k: _record(rig, fibres(k), Straight(1000 * x, 40 + 77 * k), frames, k)
        ),
        "acceleration / mm/s2": ((20, 100, 400), lambda x, k: _record(rig, fibres(k), _jerk(x, rig, k), frames, k)),
        "distance between fibres / um": (
            (150, 300, 600), lambda x, k: _record(rig, _islands(x), HandHeld(2000, seed=k), frames, k)
        ),
    }  # fmt: skip
    if not quick:
        stresses["electrons of white"] = (
            (3200, 16, 4),
            lambda x, k: _record(dim(x), fibres(k), HandHeld(1500, seed=k), frames, k),
        )

    def case(make: Callable[[float, int], Recorded], level: float) -> Case:
        return Case("", [make(level, seed) for seed in range(seeds)], context=rig, calls=frames)

    made = {group: (levels, partial(case, make)) for group, (levels, make) in stresses.items()}
    return stressed(made, worst=1 if quick else None)


BENCHMARK = Benchmark(
    name="stability-tracking",
    question="Where tracking fails, in % of the recordings",
    error_label="error at the end / % of the path",
    cases=_cases,
    methods=named(METHODS, _SHOWN),
    judge=judge,
    chart=Chart.FAILURES,
    seconds=0.0,
    remarks=(
        "A recording has failed if a link more than 3 px off is called tracked, or if less than nine tenths of its "
        "frames are tracked; in the second case the track says so frame by frame, which counts as noticed."
    ),
)
