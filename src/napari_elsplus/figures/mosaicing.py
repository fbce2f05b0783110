"""The pictures and the table of docs/mosaicing.md: ``python -m napari_elsplus.figures.mosaicing --out docs``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure

from napari_elsplus.evaluation.mosaicing import TRANSLATION, Judged, Outcome, Scenario, judged_links, outcomes
from napari_elsplus.figures.files import save_figure
from napari_elsplus.figures.pages import fill, require_marks
from napari_elsplus.processing.registration import LEAST_EVIDENCE
from napari_elsplus.tracking_pipeline import Method

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FAST: Final = Scenario("fibres", "spiral", 16_000.0, 80)
SCENARIOS: Final = (
    FAST,
    Scenario("nuclei", "spiral", 8_000.0, 80),
    Scenario("fibres", "hand", 1_500.0, 120),
    Scenario("fibres", "hand", 300.0, 120),
    Scenario("sparse", "spiral", 8_000.0, 80),
)
JUDGED_UM_S: Final = 3_000.0
JUDGED_FRAMES: Final = 60
SEEDS: Final = 8
NAMES: Final = {Method.PAPER.value: "paper", TRANSLATION: "sub-pixel translation", Method.ELSPLUS.value: "ours"}
_SHOWN_PX: Final = 360


def make(docs: Path) -> None:
    """Measure, draw and tabulate everything in docs/mosaicing.md.

    Parameters
    ----------
    docs : pathlib.Path
        Folder of ``mosaicing.md``; pictures go into its folder ``images``.

    Raises
    ------
    InputError
        If there is no ``mosaicing.md`` in it, or the table's place is missing there.
    """
    page = docs / "mosaicing.md"
    require_marks(page, ("methods",))
    measured = {scenario: outcomes(scenario) for scenario in SCENARIOS}
    images = docs / "images"
    save_figure(draw_mosaics(measured[FAST]), images / "mosaicing-mosaics.png", force=True)
    save_figure(draw_errors(measured[FAST]), images / "mosaicing-errors.png", force=True)
    save_figure(draw_gate(judged_links(JUDGED_UM_S, JUDGED_FRAMES, SEEDS)), images / "mosaicing-gate.png", force=True)
    fill(page, {"methods": "\n".join(table(measured))})


def draw_mosaics(made: dict[str, Outcome]) -> Figure:
    """Middle of each method's mosaic, and of the scene that was there."""
    figure = Figure(figsize=(12, 3.4), layout="constrained")
    panels = figure.subplots(1, len(made) + 1)
    best = made[Method.ELSPLUS.value]
    _show(panels[0], best.truth, "scene")
    for axes, (method, outcome) in zip(panels[1:], made.items(), strict=True):
        _show(axes, outcome.mosaic, f"{NAMES[method]}: correlation {outcome.correlation:.3f}")
    return figure


def draw_errors(made: dict[str, Outcome]) -> Figure:
    """Distance from the true path, frame by frame."""
    figure = Figure(figsize=(6, 3.4), layout="constrained")
    axes = figure.subplots()
    for method, outcome in made.items():
        axes.semilogy(np.maximum(outcome.error_px, 1e-3), label=NAMES[method])
    axes.set(xlabel="frame", ylabel="distance from the true path (camera px)")
    axes.legend(frameon=False)
    return figure


def draw_gate(links: list[Judged]) -> Figure:
    """How wrong links are, against their correlation and against the evidence over their rivals."""
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    evidence, correlation, error = np.array(links).T
    left.loglog(np.maximum(1 - correlation, 1e-4), error, ".", markersize=4)
    left.set(xlabel="1 - correlation", ylabel="error of the link (camera px)")
    left.invert_xaxis()
    right.loglog(np.maximum(evidence, 1e-3), error, ".", markersize=4)
    right.axvline(LEAST_EVIDENCE, color="black", linewidth=0.8)
    right.set(xlabel="evidence against the best rival (nats per px)")
    return figure


def table(measured: dict[Scenario, dict[str, Outcome]]) -> list[str]:
    """Lines of the page's table."""
    lines = [
        "| scene, path, speed | method | median pair error (px) | error at the end (% of path) | wrong links | "
        "tracked | correlation with the scene |",
        "|---|---|---|---|---|---|---|",
    ]
    for scenario, made in measured.items():
        for method, outcome in made.items():
            e = outcome.errors
            lines.append(
                f"| {scenario} | {NAMES[method]} | {e.median_pair_error_px:.3f} | {e.end_error_percent_of_path:.3f} "
                f"| {e.wrong_links} | {e.tracked} of {e.frames} | {outcome.correlation:.3f} |"
            )
    return lines


def _show(axes: Axes, image: np.ndarray[tuple[int, ...], np.dtype[np.float32]], title: str) -> None:
    top, left = (max(0, (size - _SHOWN_PX) // 2) for size in image.shape)
    part = image[top : top + _SHOWN_PX, left : left + _SHOWN_PX]
    axes.imshow(part, cmap="gray", vmin=0, vmax=float(np.percentile(part, 99.5)))
    axes.set_title(title, fontsize=9)
    axes.set_axis_off()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs"), help="folder of mosaicing.md")
    make(parser.parse_args().out)
