"""Registration over many pairs: all shifts up to 60 % of the disc, in textured scenes and dim light.

Failures of one in a hundred show only in hundreds of pairs, so there are many; the probe rests during each frame.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from benchmarks.choices.registration import METHODS, WRONG_PX, Pair, judge, pairs_along
from benchmarks.harness.methods import Absent, Benchmark, Case, Chart, Claim, TimedElsewhere, named
from benchmarks.rigs.simulated import StopAndGo, dim, measured, tissue
from napari_elsplus.errors import ElsPlusError
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.simulation.model.instrument import Instrument

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmarks.harness.methods import Method

SCENES: Final = ("fibres", "nuclei", "paper")
ELECTRONS_OF_WHITE: Final = 100.0
MAX_PERCENT: Final = 60
_BINS: Final = 3
_FIELD_UM: Final = 1500.0
_SHOWN: Final = ("link, predicted", "link, searched", "template", "OpenCV phaseCorrelate", "PyFibreBundle")
_SELDOM: Final = {"scikit-image masked"}
"""Takes a tenth of a second for each pair."""


def pairs(scene: str, low: float, high: float, count: int) -> list[Pair]:
    """Pairs of tracking images in dim light.

    Parameters
    ----------
    scene : str
        Name of a textured scene.
    low, high : float
        Limits of the shift, as parts of the disc's diameter; all shifts in between are equally likely.
    count : int
        How many.
    """
    rig = dim(ELECTRONS_OF_WHITE)
    grid = Grid.of(rig.calibration)
    random = np.random.default_rng((0, round(100 * low)))
    px = grid.diameter * np.sqrt(random.uniform(low**2, high**2, count))
    angle = random.uniform(0, 2 * np.pi, count)
    moved = px[:, None] * np.column_stack([np.sin(angle), np.cos(angle)])
    start_um = random.uniform(-_FIELD_UM, _FIELD_UM, (count, 2))
    places = np.stack([start_um, start_um + moved * grid.binning * rig.um_per_px], axis=1).reshape(-1, 2)
    path = StopAndGo(places, rig.instrument.optics.frame_period_s)
    return pairs_along(rig, tissue(scene), path, 0, random)


def cases(quick: bool, count: int = 1000) -> list[Case]:
    """As many pairs as that altogether, in cases of one scene and a third of the shifts each."""
    rig = measured(Instrument.of("240hz"))
    each = 2 if quick else -(-count // (len(SCENES) * _BINS))
    edges = np.linspace(0, MAX_PERCENT, _BINS + 1)
    return [
        Case(
            f"{name}, shift up to {high:.0f} % of the disc", pairs(name, low / 100, high / 100, each),
            level=float(high), group=name, context=Grid.of(rig.calibration),
        )
        for name in SCENES[: 1 if quick else None]
        for low, high in pairwise(edges)
    ]  # fmt: skip


class Statistics(NamedTuple):
    """Statistics of a method over many pairs of one scene.

    Parameters
    ----------
    pairs : int
        How many.
    rms_px : float
        Root-mean-square error of those that did not fail.
    failed_percent : float
        More than 3 px off, or refused.
    silent_percent : float
        More than 3 px off and not noticed.
    """

    pairs: int
    rms_px: float
    failed_percent: float
    silent_percent: float


def statistics(method: Method, of: Sequence[Case]) -> Statistics:
    """Let a method register all pairs of some cases.

    Raises
    ------
    Absent
        If it is a peer that is not installed.
    """
    errors, silent = [], 0
    for case in of:
        register = method.prepare(case)
        for pair in case.items[:: 10 if method.name in _SELDOM else 1]:
            try:
                answer = register(pair)
            except Absent:
                raise
            except ElsPlusError:
                errors.append(np.inf)
                continue
            judged = judge(pair, answer.answer if isinstance(answer, TimedElsewhere) else answer)
            refused = judged.claim is Claim.REFUSED
            errors.append(np.inf if refused else judged.error)
            silent += judged.failed and not refused
    error = np.array(errors)
    good = error <= WRONG_PX
    rms = float(np.sqrt(np.mean(error[good] ** 2))) if good.any() else float("nan")
    return Statistics(len(error), rms, 100 * float(np.mean(~good)), 100 * silent / len(error))


BENCHMARK = Benchmark(
    name="stability-pairs",
    question="How often registration fails in textured scenes, in % of the pairs",
    error_label="error / px",
    cases=partial(cases, count=270),
    methods=named(METHODS, _SHOWN),
    judge=judge,
    chart=Chart.FAILURES,
    seconds=0.0,
    remarks=(
        "A failure is an error above 3 px. 100 electrons are white in each camera pixel. Predicted methods start about "
        "3 px from the truth; the others know nothing."
    ),
)
