"""The model line of state a, fitted to what the paper prints: ``python3 run.py bench docs --only line-fit``.

The paper measured on a bundle, so the fit is made with the rim of a bundle
(:mod:`benchmarks.rigs.clipped_response`). Five parameters are more than its numbers determine: the share of the halo
and the gap may be exchanged for one another with hardly any change of the fit. They are held, and the three that remain
are fitted.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from benchmarks.parsimony.axial import Target, paper_targets
from benchmarks.rigs.clipped_response import clipped_drop_offs
from benchmarks.studies import printed
from napari_elsplus.simulation.model.axial_response import LINE_MODELS, LineModel
from napari_elsplus.simulation.model.instrument import Instrument

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

SLIT_UM: Final = 2.9
FITTED: Final = ("core_um", "halo_um", "spread")
"""Parameters that the fit moves."""
_DECIBEL: Final = {0.5: 3, 0.1: 10}
REPRESENTATIVE_UM: Final = 29.0
REPRESENTATIVE: Final = 0.05
"""Relative uncertainty of ELS+ at the offset of which the paper shows the curve and prints the distance thrice."""
FROM_FITS: Final = 0.15
"""Relative uncertainty of ELS+ at other offsets, of which it prints curves through scattered points only."""


class LineFit(NamedTuple):
    """A fitted line, the relative standard deviation of each fitted parameter, and what it predicts (targets,)."""

    line: LineModel
    relative_uncertainty: dict[str, float]
    predicted_um: Floats


def fit_line(start: LineModel = LINE_MODELS["a"], steps: int = 20) -> LineFit:
    """Fit core, halo and spread of the line to the paper's drop-off distances of panels (a, b), the rim included.

    Parameters
    ----------
    start : LineModel
        Where the fit starts; its share of the halo and its gap are kept.
    steps : int
        Evaluations of the model at most.
    """
    targets = paper_targets()
    wanted = np.log([target.um for target in targets])
    sigma = np.array([uncertainty(target) for target in targets])

    def line_of(logarithms: Floats) -> LineModel:
        return replace(start, **dict(zip(FITTED, np.exp(logarithms).tolist(), strict=True)))

    def misses(logarithms: Floats) -> Floats:
        return np.asarray((np.log(predicted(targets, line_of(logarithms))) - wanted) / sigma, np.float64)

    best = least_squares(misses, np.log([getattr(start, name) for name in FITTED]), diff_step=1e-3, max_nfev=steps)
    spread = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))
    line = line_of(best.x)
    return LineFit(line, dict(zip(FITTED, spread.tolist(), strict=True)), predicted(targets, line))


def uncertainty(target: Target) -> float:
    """Relative standard deviation that a printed distance is given."""
    if target.offset_um is None:
        return printed.LS_UM[_DECIBEL[target.share]][1] / target.um
    return REPRESENTATIVE if target.offset_um == REPRESENTATIVE_UM else FROM_FITS


def predicted(targets: list[Target], line: LineModel) -> Floats:
    """Distances (um) at which a line's signal has fallen to the targets' shares in the middle of a bundle."""
    found: dict[tuple[float | None, float], float] = {}
    for offset_um in {target.offset_um for target in targets if target.offset_um is not None}:
        ls, els = clipped_drop_offs(Instrument.of("120hz", slit_um=SLIT_UM, offset_um=offset_um, line=line))
        for share, ls_um, els_um in zip(_DECIBEL, ls, els, strict=True):
            found[None, share], found[offset_um, share] = ls_um, els_um
    return np.array([found[target.offset_um, target.share] for target in targets])


def report(*, quick: bool = False) -> str:
    """Fit the line and return its parameters and distances, a line of text each; a single step if quick."""
    fit = fit_line(steps=1 if quick else 20)
    parameters = [
        f"{name} {getattr(fit.line, name):.4g} +- {100 * relative:.0f} %"
        for name, relative in fit.relative_uncertainty.items()
    ]
    held = [f"{name} {getattr(fit.line, name):g} (held)" for name in ("halo_share", "gap_um")]
    distances = [
        f"{'LS' if target.offset_um is None else f'ELS+ at {target.offset_um:g} um'}, to {target.share:g}: "
        f"{um:.1f} um, printed {target.um:.1f} ({100 * (um / target.um - 1):+.1f} %)"
        for target, um in zip(paper_targets(), fit.predicted_um, strict=True)
    ]
    return "\n".join([*parameters, *held, *distances])
