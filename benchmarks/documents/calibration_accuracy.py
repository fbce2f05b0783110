"""Numbers and charts of docs/calibration.md: ``python3 run.py bench docs --only calibration``."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure

from benchmarks.choices.line import BENCHMARK, frame
from benchmarks.documents.pages import fill, require_marks
from benchmarks.rigs.photographs import Photograph, look_at
from benchmarks.rigs.random_rigs import Rig
from benchmarks.studies.calibration_accuracy import CENTRE, GAIN, OFFSET, QUANTITIES, Survey, survey
from napari_elsplus.errors import ElsPlusError
from napari_elsplus.workflows.pictures.files import save_figure

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

LIGHTS: Final = (2.0, 5.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
"""Electrons in the brightest pixel of an evenly lit bundle."""
FIRST_SEED: Final = 200
"""Rigs before it were looked at while the stated uncertainties were worked out."""
RIGS: Final = 200
"""Rigs that are calibrated: the share within one standard deviation is then known to 3 %."""
VOLTAGES: Final = 400
"""Voltages of each sweep; chosen, and stated beside the results."""
PROCESSES: Final = 2
"""Rigs calibrated at once: the cores of a small machine."""


@dataclass(frozen=True, slots=True)
class Timed:
    """One way to find the line: in each light its root-mean-square error and what it refused, and what it costs.

    Parameters
    ----------
    name : str
        Of the method.
    rms_rows : tuple of float
        In each light; NaN where all was refused.
    refused : tuple of float
        Share of the frames in which it found no line.
    cost_ms : float
        Median time for a view.
    """

    name: str
    rms_rows: tuple[float, ...]
    refused: tuple[float, ...]
    cost_ms: float


def compare_estimators(rigs: int) -> list[Timed]:
    """Find the line in frames of many rigs and lights by each method of the benchmark."""
    frames = [[frame(Rig.draw(seed).with_photons(light)) for seed in range(rigs)] for light in LIGHTS]
    compared = []
    for method in BENCHMARK.methods:
        rms, refused, costs = [], [], []
        for light in frames:
            errors = []
            for item in light:
                begun = perf_counter()
                try:
                    answer = method.prepare(None)(item)  # type: ignore[arg-type]
                except ElsPlusError:
                    continue
                costs.append(perf_counter() - begun)
                errors.append(answer - item.row)
            rms.append(float(np.sqrt(np.mean(np.square(errors)))) if errors else np.nan)
            refused.append(1 - len(errors) / len(light))
        compared.append(Timed(method.name, tuple(rms), tuple(refused), 1000 * float(np.median(costs))))
    return compared


def draw(lights: list[Survey], estimators: list[Timed]) -> Figure:
    """Draw error against light, for the calibration and for ways to find the line, and speed against accuracy."""
    figure = Figure(figsize=(12, 4), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    for quantity in (OFFSET, CENTRE, GAIN):
        found = [(at, one.accuracies[quantity].rms) for at, one in zip(LIGHTS, lights, strict=True) if one.accuracies]
        left.loglog(*zip(*found, strict=True), "o-", label=f"{quantity.name} / {quantity.unit}")
    _label(left, "electrons in the brightest pixel", "RMS error", "Calibration against light")
    for estimator in estimators:
        middle.loglog(LIGHTS, estimator.rms_rows, "o-", label=estimator.name)
        right.loglog(estimator.cost_ms, estimator.rms_rows[-2], "o", label=estimator.name)
    _label(middle, "electrons in the brightest pixel", "RMS error / rows", "The line against light")
    _label(right, "time per view / ms", "RMS error / rows", f"The line at {LIGHTS[-2]:g} electrons")
    return figure


def _label(axes: Axes, across: str, up: str, title: str) -> None:
    axes.set(xlabel=across, ylabel=up, title=title)
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=7)


def tables(measured: Survey, voltages: int, lights: list[Survey], estimators: list[Timed]) -> str:
    """Write what was measured as Markdown."""
    lines = [
        f"{measured.rigs} rigs drawn at random, sweeps of {voltages} voltages; {len(measured.refused)} refused.",
        "",
        "| quantity | RMS error | largest | aim | within 1 sigma | within 3 sigma |",
        "|---|---|---|---|---|---|",
    ]
    for quantity, found in measured.accuracies.items():
        lines.append(
            f"| {quantity.name} | {found.rms:.3g} {quantity.unit} | {found.largest:.3g} | {quantity.bar:g} | "
            f"{100 * found.within(1):.0f} % | {100 * found.within(3):.1f} % |"
        )
    heads = " | ".join(f"{light:g} e-" for light in LIGHTS)
    lines += ["", f"| RMS error in light of | {heads} |", "|---" * (len(LIGHTS) + 1) + "|"]
    for quantity in QUANTITIES:
        known = [one.accuracies.get(quantity) for one in lights]
        if any(known):
            row = " | ".join("" if one is None else f"{one.rms:.2g}" for one in known)
            lines.append(f"| {quantity.name} / {quantity.unit} | {row} |")
    lines.append("| refused | " + " | ".join(f"{len(one.refused)} of {one.rigs}" for one in lights) + " |")
    lines += ["", f"| line found by | {heads} | ms per view |"]
    lines += ["|---" * (len(LIGHTS) + 2) + "|"]
    for estimator in estimators:
        errors = " | ".join(
            f"{rms:.3f}" + (f" ({100 * share:.0f} % refused)" if share else "")
            for rms, share in zip(estimator.rms_rows, estimator.refused, strict=True)
        )
        lines.append(f"| {estimator.name} | {errors} | {estimator.cost_ms:.2f} |")
    return "\n".join(lines)


def photographs_table(looked_at: list[Photograph]) -> str:
    """Write what was found in real photographs as Markdown."""
    lines = [
        "| photograph | centre / px | diameter / px | rim seen | centre against its flat's | honeycomb | flattened |",
        "|---|---|---|---|---|---|---|",
    ]
    for one in looked_at:
        at, sure = one.found.centre, one.found.centre_uncertainty_px
        alone = one.flat is None
        lines.append(
            f"| {one.name} | {at[0]:.2f}, {at[1]:.2f} ± {sure:.2f} | {one.found.diameter_px:.2f} ± "
            f"{one.found.diameter_uncertainty_px:.2f} | {100 * one.found.edge_seen:.0f} % | "
            f"{'' if alone else f'{one.moved_px:.2f} px'} | {100 * one.honeycomb:.1f} % | "
            f"{'' if alone else f'{100 * one.flattened:.1f} %'} |"
        )
    return "\n".join(lines)


def make(docs: Path, photographs: Path | None = None, *, quick: bool = False) -> None:
    """Measure, draw and tabulate everything in docs/calibration.md.

    Parameters
    ----------
    docs : pathlib.Path
        Folder of ``calibration.md``; the chart goes into its folder ``images``.
    photographs : pathlib.Path, optional
        Folder of real photographs: only their table is made then.
    quick : bool
        Two rigs: a check that it runs.

    Raises
    ------
    InputError
        If there is no ``calibration.md`` in it, or a table's place is missing there.
    """
    page = docs / "calibration.md"
    require_marks(page, ("measured", "photographs"))
    if photographs is not None:
        fill(page, {"photographs": photographs_table(look_at(photographs))})
        return
    rigs, voltages = (2, 20) if quick else (RIGS, VOLTAGES)
    measured = survey([Rig.draw(FIRST_SEED + number) for number in range(rigs)], voltages, PROCESSES)
    few = range(max(2, rigs // 16))
    lights = [survey([Rig.draw(seed).with_photons(light) for seed in few], 0, PROCESSES) for light in LIGHTS]
    estimators = compare_estimators(len(few))
    save_figure(draw(lights, estimators), docs / "images" / "calibration.png", force=True)
    fill(page, {"measured": tables(measured, voltages, lights, estimators)})
