"""Model selection for the axial response: each printed drop-off predicted from the others.

Every model is fitted to all but one of the paper's numbers and then asked for that one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.optimize import brentq, least_squares

from benchmarks.harness.methods import Benchmark, Case, Chart, Judgement, Method, Role
from benchmarks.studies import printed
from napari_elsplus.errors import ElsPlusError
from napari_elsplus.simulation.model.axial_response import LineModel, line_response

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

SLIT_UM = 2.9
_FAR_UM = 3e4
_ALMOST_NO_HALO = 1e-9


class Target(NamedTuple):
    """One printed drop-off distance: of LS (no offset) or ELS+, to this share of the signal in contact."""

    offset_um: float | None
    share: float
    um: float


def paper_targets() -> list[Target]:
    """LS as printed, ELS+ from the printed fits at the offsets that were measured (panels a and b)."""
    shares = {3: 0.5, 10: 0.1}
    ls = [Target(None, share, printed.LS_UM[decibel][0]) for decibel, share in shares.items()]
    return ls + [
        Target(offset_um, share, printed.els_drop_off_um(offset_um, decibel))
        for offset_um in printed.OFFSETS_UM
        for decibel, share in shares.items()
    ]


class HeldOut(NamedTuple):
    """All targets but one, and that one."""

    known: list[Target]
    asked: Target


def _cases(quick: bool) -> list[Case]:
    targets = paper_targets()
    asked = range(5, 6) if quick else range(len(targets))
    return [
        Case(
            "the paper's drop-offs, panels (a, b)", [HeldOut(targets[:k] + targets[k + 1 :], targets[k]) for k in asked]
        )
    ]


def predicted_um(target: Target, line: LineModel) -> float:
    """Distance at which the model's signal has fallen to the target's share."""

    def signal(depth_um: float) -> float:
        depth = depth_um + line.gap_um
        ls = float(line_response(depth, 0.0, SLIT_UM, line))
        return ls if target.offset_um is None else ls - float(line_response(depth, target.offset_um, SLIT_UM, line))

    contact = signal(0.0)
    try:
        return float(brentq(lambda z: signal(z) / contact - target.share, 0.0, _FAR_UM))
    except ValueError:
        return _FAR_UM


def _fitted(make: Callable[..., LineModel], start: tuple[float, ...]) -> Callable[[Case], Callable[[HeldOut], float]]:
    """Prepare the fit of as many parameters as are started; they are positive, so their logarithms are fitted."""

    def predict(item: HeldOut) -> float:
        def misses(logarithms: Floats) -> Any:
            try:
                line = make(*np.exp(logarithms))
            except ElsPlusError:
                return np.full(len(item.known), 10.0)
            return [np.log(predicted_um(target, line) / target.um) for target in item.known]

        best = least_squares(misses, np.log(start), loss="soft_l1", f_scale=0.1, max_nfev=30)
        return predicted_um(item.asked, make(*np.exp(best.x)))

    return lambda _: predict


def judge(item: HeldOut, answer: float) -> Judgement:
    """Distance from the printed number, in percent of it."""
    return Judgement(100 * abs(answer / item.asked.um - 1))


def _without_halo(core_um: float, spread: float, gap_um: float = 0.0) -> LineModel:
    return LineModel(core_um, _ALMOST_NO_HALO, 2 * core_um, spread, gap_um)


def _with_halo(core_um: float, halo_over_core: float, halo_um: float, spread: float, gap_um: float = 0.0) -> LineModel:
    return LineModel(core_um, halo_over_core / (1 + halo_over_core), halo_um, spread, gap_um)


METHODS = (
    Method("Gaussian line", Role.OPTION, _fitted(_without_halo, (10, 0.2)), 2),
    Method("Gaussian, gap", Role.OPTION, _fitted(_without_halo, (10, 0.2, 10)), 3),
    Method("core and halo", Role.OPTION, _fitted(_with_halo, (5, 1.5, 35, 0.2)), 4),
    Method("core, halo, gap", Role.DEFAULT, _fitted(_with_halo, (5, 1.5, 35, 0.2, 14)), 5),
)

BENCHMARK = Benchmark(
    name="parsimony-axial",
    question="How much to model of the axial response",
    error_label="error of a held-out drop-off / %",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    chart=Chart.PARSIMONY,
    seconds=0.0,
    remarks="The paper's ELS+ numbers are its own printed fits, which are smooth: errors of a few percent are theirs.",
)
