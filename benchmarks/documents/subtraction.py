"""Charts of what is subtracted for ELS+, in docs/physics.md: ``python3 run.py bench docs --only subtraction``."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure

from benchmarks.documents.pages import fill, require_marks
from benchmarks.studies.offset_series import compare_offsets
from benchmarks.studies.subtraction import compare_weights, hazy, rig, views
from napari_elsplus.workflows.pictures.files import save_figure

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

WEIGHT_OFFSETS_UM: Final = (12.0, 29.0, 60.0)
LIGHTS: Final = (1.0, 0.1)
"""Parts of the usual light."""
WEIGHT_DEPTHS_UM: Final = (20.0, 60.0, 160.0, None)
"""Depths of the haze; None: a thick specimen."""
WEIGHT_SEEDS: Final = range(700, 705)
SERIES_UM: Final = (5.0, 8.0, 12.0, 20.0, 29.0, 60.0)
SERIES_DEPTHS_UM: Final = (20.0, 40.0, 100.0, None)
SERIES_RIGS: Final = (("a", 1.0), ("a", 0.1), ("b", 1.0))
"""State of the line and part of the usual light."""
SERIES_SEEDS: Final = range(710, 713)
STYLES: Final = {
    "0 (LS)": ("0.6", "s--"),
    "1 (ELS+)": ("#000000", "o-"),
    "best, truth known": ("#009e73", "*--"),
}
"""Colour and line of each weight."""

Case = tuple[float, float, float | None]
"""Slit offset (um), light and depth of the haze (um)."""


def make(docs: Path, *, quick: bool = False) -> None:
    """Compare weights of the residual and series of offsets, and put charts and tables into docs/physics.md.

    Parameters
    ----------
    docs : pathlib.Path
        Folder of ``physics.md``; charts go into its folder ``images``.
    quick : bool
        One offset, one rig and one seed: a check that it runs.

    Raises
    ------
    InputError
        If there is no ``physics.md`` in it, or a table's place is missing there.
    """
    page = docs / "physics.md"
    require_marks(page, ("weights", "offset-series"))
    weights = measure_weights(
        WEIGHT_OFFSETS_UM[:1] if quick else WEIGHT_OFFSETS_UM, WEIGHT_SEEDS[: 1 if quick else None]
    )
    series = measure_series(SERIES_RIGS[:1] if quick else SERIES_RIGS, SERIES_SEEDS[: 1 if quick else None])
    save_figure(draw_weights(weights), docs / "images" / "physics-weights.png", force=True)
    save_figure(draw_series(series), docs / "images" / "physics-offset-series.png", force=True)
    tables = {"weights": _weight_table(weights), "offset-series": _series_table(series)}
    fill(page, {name: "\n".join(table) for name, table in tables.items()})


def measure_weights(offsets_um: Iterable[float], seeds: Iterable[int]) -> dict[Case, Floats]:
    """Return weight and correlation with the focal plane, (seeds, weights, 2), of each case."""
    seeds = list(seeds)

    def of(offset_um: float, light: float, depth_um: float | None) -> Floats:
        seen = (views(rig(offset_um, "a", light), hazy(depth_um, seed), seed) for seed in seeds)
        return np.array([compare_weights(one) for one in seen])

    return {case: of(*case) for case in product(offsets_um, LIGHTS, WEIGHT_DEPTHS_UM)}


def measure_series(
    rigs: Iterable[tuple[str, float]], seeds: Iterable[int]
) -> dict[tuple[str, float, float | None], Floats]:
    """Return mean correlations of each offset alone, of the series, and of its best combination, of each case."""
    seeds = list(seeds)

    def of(state: str, light: float, depth_um: float | None) -> Floats:
        found = [compare_offsets(SERIES_UM, hazy(depth_um, seed), state, light, seed) for seed in seeds]
        return np.asarray(np.mean([[*alone, series, best] for alone, series, best in found], axis=0))

    return {(*one, depth_um): of(*one, depth_um) for one, depth_um in product(rigs, SERIES_DEPTHS_UM)}


def draw_weights(measured: Mapping[Case, Floats]) -> Figure:
    """Draw what is left to full correlation against the haze's depth, for each offset and light."""
    offsets_um = list(dict.fromkeys(offset_um for offset_um, _, _ in measured))
    figure = Figure(figsize=(4.2 * len(offsets_um), 7.4), layout="constrained")
    panels = figure.subplots(len(LIGHTS), len(offsets_um), squeeze=False, sharex=True, sharey=True)
    for (row, light), (column, offset_um) in product(enumerate(LIGHTS), enumerate(offsets_um)):
        axes = panels[row, column]
        means = np.array([measured[offset_um, light, depth_um].mean(axis=0) for depth_um in WEIGHT_DEPTHS_UM])
        for place, (name, (colour, style)) in enumerate(STYLES.items()):
            axes.plot([_haze(z) for z in WEIGHT_DEPTHS_UM], 1 - means[:, place, 1], style, color=colour, label=name)
        axes.set(yscale="log", title=f"offset {offset_um:g} um, light {light:g}")
        axes.grid(visible=True, color="0.92")
    for axes in panels[-1]:
        axes.set_xlabel("haze at")
    for axes in panels[:, 0]:
        axes.set_ylabel("1 - correlation with the focal plane")
    panels[0, -1].legend(title="weight of the residual", loc="lower left", frameon=False, fontsize=8)
    return figure


def draw_series(measured: Mapping[tuple[str, float, float | None], Floats]) -> Figure:
    """Draw what is left to full correlation against the offset, and for series of offsets beside it."""
    rigs = list(dict.fromkeys((state, light) for state, light, _ in measured))
    figure = Figure(figsize=(4.4 * len(rigs), 4.4), layout="constrained")
    panels = figure.subplots(1, len(rigs), squeeze=False, sharey=True)[0]
    labels = [f"{offset_um:g}" for offset_um in SERIES_UM]
    for axes, (state, light) in zip(panels, rigs, strict=True):
        for depth_um, colour in zip(SERIES_DEPTHS_UM, ("#d55e00", "#0072b2", "#009e73", "#000000"), strict=True):
            left = 1 - measured[state, light, depth_um]
            axes.plot(labels, left[:-2], "o-", color=colour, label=f"haze at {_haze(depth_um)}")
            axes.plot(["series"], left[-2], "s", color=colour)
            axes.plot(["best"], left[-1], "*", color=colour)
        axes.set(yscale="log", title=f"line {state}, light {light:g}", xlabel="slit offset (um)")
        axes.grid(visible=True, color="0.92")
    panels[0].set_ylabel("1 - correlation with the focal plane")
    panels[0].legend(frameon=False, fontsize=8)
    return figure


def _weight_table(measured: Mapping[Case, Floats]) -> list[str]:
    rows = ["| offset (um), light, haze | w 0 (LS) | w 1 (ELS+) | w best, truth known |", "|---|---|---|---|"]
    for (offset_um, light, depth_um), values in measured.items():
        (_, ls), (_, els), (weight, best) = values.mean(axis=0)
        case = f"{offset_um:g}, {light:g}, {_haze(depth_um)}"
        rows.append(f"| {case} | {ls:.3f} | {els:.3f} | {best:.3f} (w {weight:.2f}) |")
    _, usual, best = np.concatenate(list(measured.values()))[:, :, 1].T
    gain = best - usual
    return [
        *rows,
        "",
        f"The best weight adds {gain.mean():.4f} to the correlation on average over {len(gain)} images, "
        f"{gain.max():.3f} at most; more than 0.005 in {np.mean(gain > 0.005):.0%}.",
    ]


def _series_table(measured: Mapping[tuple[str, float, float | None], Floats]) -> list[str]:
    rows = [
        "| line, light, haze | best offset alone (um) | at 29 um | series | series minus best | best combination |",
        "|---|---|---|---|---|---|",
    ]
    for (state, light, depth_um), found in measured.items():
        alone = found[:-2]
        best, series, bound = int(np.argmax(alone)), *found[-2:]
        rows.append(
            f"| {state}, {light:g}, {_haze(depth_um)} | {alone[best]:.3f} ({SERIES_UM[best]:g}) "
            f"| {alone[SERIES_UM.index(29.0)]:.3f} | {series:.3f} | {series - alone[best]:+.3f} | {bound:.3f} |"
        )
    return rows


def _haze(depth_um: float | None) -> str:
    return "15 to 80 um" if depth_um is None else f"{depth_um:g} um"
