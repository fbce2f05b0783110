"""Model selection in calibration: the galvo map, and the view alignment.

Errors are held out (the galvo's map, fitted to every second voltage) or against the truth (the pair).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from benchmarks.choices.pair import Lit
from benchmarks.choices.pair import judge as judge_pair
from benchmarks.harness.methods import Benchmark, Case, Chart, Judgement, Method, Role
from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.processing.calibration.bundle.core_matching import CoreMatcher
from napari_elsplus.processing.calibration.bundle.location import locate_pair
from napari_elsplus.processing.calibration.bundle.view_alignment import align_views
from napari_elsplus.processing.calibration.bundle.view_maps import ViewModel
from napari_elsplus.processing.calibration.galvo import visible_line

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_RIGHT_TO_LEFT_TURN_DEG = 0.3


class Sweep(NamedTuple):
    """Voltages and the rows on which the line was found, in volts' order."""

    volts: Floats
    rows: Floats


def _sweep(seed: int, bend_rows: float, count: int) -> Sweep:
    """Sweep a rig whose galvo departs from a straight line by that much at the ends and in the middle."""
    rig = Rig.draw(seed).with_photons(200.0)
    along = np.linspace(-0.38, 0.38, count)
    rows = along * rig.diameter_px
    bent = rows + bend_rows * (2 * (along / 0.38) ** 2 - 1)
    split = round((rig.left[1] + rig.right[1]) / 2)
    volts = rig.volts_at_row_zero + rig.volts_per_row * (rig.left[0] + rows)
    given = rig.volts_at_row_zero + rig.volts_per_row * (rig.left[0] + bent)
    views = (frame[:, :split].astype(np.float32) - np.float32(rig.black_dn) for frame in rig.sweep(given))
    lines = [visible_line(view) for view in views]
    seen = np.array([line is not None for line in lines])
    found = np.array([line.row_at(rig.left[1]) for line in lines if line is not None])
    return Sweep(volts[seen], found)


def _galvo_cases(quick: bool) -> list[Case]:
    seeds, count = (range(1), 16) if quick else (range(4), 40)
    bends = {"a straight galvo": 0.0} if quick else {"a straight galvo": 0.0, "a galvo bent by half a row": 0.5}
    return [Case(name, [_sweep(seed, bend, count) for seed in seeds]) for name, bend in bends.items()]


def _polynomial(degree: int) -> Callable[[Case], Callable[[Sweep], float]]:
    def held_out(item: Sweep) -> float:
        fit = np.polynomial.Polynomial.fit(item.volts[::2], item.rows[::2], degree)
        return float(np.sqrt(np.mean((item.rows[1::2] - fit(item.volts[1::2])) ** 2)))

    return lambda _: held_out


GALVO = Benchmark(
    name="parsimony-galvo",
    question="How much to model of the galvo",
    error_label="error of held-out rows, rms / rows",
    cases=_galvo_cases,
    methods=(
        Method("straight line", Role.DEFAULT, _polynomial(1), 2),
        Method("parabola", Role.OPTION, _polynomial(2), 3),
        Method("cubic", Role.OPTION, _polynomial(3), 4),
        Method("fifth degree", Role.OPTION, _polynomial(5), 6),
    ),
    judge=lambda _, answer: Judgement(answer),
    chart=Chart.PARSIMONY,
    remarks=(
        "The map stays a straight line, as the drive is a ramp; how far a cubic departs from it is measured with every "
        "sweep, and a departure that is more than chance and more than a tenth of a row is reported."
    ),
)


def _pair_cases(quick: bool) -> list[Case]:
    made = []
    for name, turn in (("both views alike", 0.0), ("right view turned and scaled", _RIGHT_TO_LEFT_TURN_DEG)):
        rigs = [_drawn(seed, turn) for seed in range(1 if quick else 6)]
        made.append(Case(name, [Lit(rig.bundle(1)[0], rig) for rig in rigs]))
    return made


def _drawn(seed: int, turn_deg: float) -> Rig:
    scale = 1.004 if turn_deg else 1.0
    return replace(Rig.draw(seed).with_photons(300.0), turn_deg=turn_deg, scale=scale)


def _model(model: ViewModel) -> Callable[[Case], Callable[[Lit], Floats]]:
    def align(item: Lit) -> Floats:
        frame = item.frame.astype(np.float32)
        left, right = locate_pair(frame)
        matcher = CoreMatcher(frame, left, right)
        motion = matcher.motion(matcher.fit(matcher.start(), model).coefficients)
        back = np.linalg.inv(motion[:, :2])
        shift = np.array(left.centre) - back @ (np.array(right.centre) + motion[:, 2])
        return np.column_stack([back, shift])

    return lambda _: align


def _chosen(item: Lit) -> Floats:
    return align_views(item.frame, *locate_pair(item.frame)).residual_to_confocal


PAIR = Benchmark(
    name="parsimony-pair",
    question="How much to model of how the right view lies on the left",
    error_label="largest misplacement / px",
    cases=_pair_cases,
    methods=(
        Method("shift", Role.OPTION, _model(ViewModel.SHIFT), 2),
        Method("similarity", Role.OPTION, _model(ViewModel.SIMILARITY), 4),
        Method("chosen by BIC", Role.DEFAULT, lambda _: _chosen),
        Method("affine", Role.OPTION, _model(ViewModel.AFFINE), 6),
    ),
    judge=judge_pair,
    chart=Chart.PARSIMONY,
    remarks="The software fits all three and takes the one that the Bayesian information criterion prefers.",
)
