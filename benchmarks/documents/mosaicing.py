"""Pictures and tables of docs/tracking-accuracy.md: ``run.py bench docs --only mosaicing``, or ``mosaicing-TABLE``."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure

from benchmarks.choices.registration import METHODS as REGISTRATIONS
from benchmarks.documents.pages import fill, require_marks
from benchmarks.harness.methods import Absent
from benchmarks.parsimony.turning import Turned, Walk, follow
from benchmarks.stability.pairs import SCENES, Statistics, cases, statistics
from benchmarks.studies import rotation
from benchmarks.studies.acceptance import HELD_OUT_SEEDS, ROWS, acceptance_table
from benchmarks.studies.drift import Drift, drift
from benchmarks.studies.mosaicing import TRANSLATION, Outcome, Scenario, outcomes
from napari_elsplus.processing.tracking.registry import Method
from napari_elsplus.workflows.pictures.files import save_figure

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from pathlib import Path

    from matplotlib.axes import Axes

FAST: Final = Scenario("fibres", "spiral", 16_000.0, 80)
SCENARIOS: Final = (
    FAST,
    Scenario("nuclei", "spiral", 8_000.0, 80),
    Scenario("fibres", "hand", 1_500.0, 120),
    Scenario("fibres", "hand", 300.0, 120),
    Scenario("sparse", "spiral", 8_000.0, 80),
)
WALKS: Final = tuple(
    Walk(scene, path, speed_um_s, turn_deg_s, 120, seed=2)
    for scene, path, speed_um_s in (
        ("fibres", "hand", 1500.0),
        ("nuclei", "spiral", 8000.0),
        ("sparse", "spiral", 8000.0),
    )
    for turn_deg_s in (0.0, 2.0, 10.0, 50.0)
)
PAIRS: Final = 1000
PAGE: Final = "tracking-accuracy.md"
_SHOWN_REGISTRATIONS: Final = (
    "link, searched", "link, predicted", "template", "template + parabola", "OpenCV phaseCorrelate",
    "OpenCV ECC, predicted", "scikit-image phase", "scikit-image masked", "PyFibreBundle",
)  # fmt: skip
NAMES: Final = {Method.PAPER.value: "paper", TRANSLATION: "sub-pixel translation", Method.ELSPLUS.value: "ours"}
_SHOWN_PX: Final = 360


def make(docs: Path, only: Collection[str] = (), *, quick: bool = False) -> None:
    """Measure, draw and tabulate everything in docs/tracking-accuracy.md.

    Parameters
    ----------
    docs : pathlib.Path
        Folder of ``tracking-accuracy.md``; pictures go into its folder ``images``.
    only : collection of str
        Names of the tables that are made anew, with the pictures beside them; all by default.
    quick : bool
        Few frames and pairs: a check that it runs.

    Raises
    ------
    InputError
        If there is no ``tracking-accuracy.md`` in it, or a table's place is missing there.
    """
    page, images = docs / PAGE, docs / "images"
    require_marks(page, TABLES)
    for name in only or TABLES:
        fill(page, {name: "\n".join(TABLES[name](images, quick))})


def _methods(images: Path, quick: bool) -> list[str]:
    measured = {scenario: outcomes(scenario) for scenario in SCENARIOS[: 1 if quick else None]}
    save_figure(draw_mosaics(measured[FAST]), images / "mosaicing-mosaics.png", force=True)
    save_figure(draw_errors(measured[FAST]), images / "mosaicing-errors.png", force=True)
    return table(measured)


def many_pairs(count: int) -> dict[str, dict[str, Statistics]]:
    """Register many pairs of each scene by each method that is installed: method to scene to statistics."""
    every = cases(quick=False, count=count)
    found: dict[str, dict[str, Statistics]] = {}
    for method in (method for method in REGISTRATIONS if method.name in _SHOWN_REGISTRATIONS):
        with suppress(Absent):
            found[method.name] = {
                scene: statistics(method, [case for case in every if case.group == scene]) for scene in SCENES
            }
    return found


def draw_mosaics(made: dict[str, Outcome]) -> Figure:
    """Middle of each method's mosaic, and of the scene that was there."""
    figure = Figure(figsize=(12, 3.4), layout="constrained")
    panels = figure.subplots(1, len(made) + 1)
    best = made[Method.ELSPLUS.value]
    _show(panels[0], best.truth, "at rest, no noise")
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


def table(measured: dict[Scenario, dict[str, Outcome]]) -> list[str]:
    """Lines of the page's table."""
    lines = [
        "| scene, path, speed | method | median pair error (px) | error at the end (% of path) | wrong links | "
        "tracked | correlation with ELS+ at rest | with the focal plane |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for scenario, made in measured.items():
        for method, outcome in made.items():
            e = outcome.errors
            lines.append(
                f"| {scenario} | {NAMES[method]} | {e.median_pair_error_px:.3f} | {e.end_error_percent_of_path:.3f} "
                f"| {e.wrong_links} | {e.tracked} of {e.frames} | {outcome.correlation:.3f} "
                f"| {outcome.focal_correlation:.3f} |"
            )
    return lines


def pairs_table(found: dict[str, dict[str, Statistics]]) -> list[str]:
    """Failures and errors over many pairs."""
    scenes = list(next(iter(found.values())))
    lines = [
        "| method | pairs | "
        + " | ".join(f"{scene}: failed, of these unnoticed; rms error (px)" for scene in scenes)
        + " |",
        "|---|---|" + "---|" * len(scenes),
    ]
    for method, of in found.items():
        cells = [f"{s.failed_percent:.1f} %, {s.silent_percent:.1f} %; {s.rms_px:.3f}" for s in of.values()]
        lines.append(f"| {method} | {sum(s.pairs for s in of.values())} | {' | '.join(cells)} |")
    return lines


def turning_table(found: dict[Walk, Turned]) -> list[str]:
    """Return the table of selected motion models and their errors."""
    lines = [
        "| scene, path, speed | turns at (deg/s) | up to (deg) | modelled | from frame | error of the angle (deg, rms) "
        "| median pair error (px) | error at the end (% of path) | wrong links "
        "| largest distance from the truth (px): frame to frame; corrected live; finished |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for walk, t in found.items():
        strayed = "; ".join(f"{px:.2f}" for px in t.strayed_px)
        lines.append(
            f"| {walk.scene}, {walk.path}, {walk.speed_um_s / 1000:g} mm/s | {walk.turn_deg_s:g} | {t.angle_deg:.2f} "
            f"| {t.model.name.lower()} | {'-' if t.since is None else t.since} | {t.angle_error_deg:.3f} "
            f"| {t.errors.median_pair_error_px:.3f} | {t.errors.end_error_percent_of_path:.3f} "
            f"| {t.errors.wrong_links} | {strayed} |"
        )
    return lines


def _show(axes: Axes, image: np.ndarray[tuple[int, ...], np.dtype[np.float32]], title: str) -> None:
    top, left = (max(0, (size - _SHOWN_PX) // 2) for size in image.shape)
    part = image[top : top + _SHOWN_PX, left : left + _SHOWN_PX]
    axes.imshow(part, cmap="gray", vmin=0, vmax=float(np.percentile(part, 99.5)))
    axes.set_title(title, fontsize=9)
    axes.set_axis_off()


def drift_table(found: dict[tuple[str, bool], Drift]) -> list[str]:
    """Return the table of drift at the end of the track."""
    lines = [
        "| scene, path | length (px) | tracked | frame to frame (% of path) | loops closed live | after the graph |",
        "|---|---|---|---|---|---|",
    ]
    for (name, back), one in found.items():
        lines.append(
            f"| {name}, {'rounds' if back else 'straight on'} | {one.path_px:.0f} | {100 * one.tracked:.0f} % "
            f"| {one.alone_percent:.4f} | {one.live_percent:.4f} | {one.graph_percent:.4f} |"
        )
    return lines


TABLES: Final[dict[str, Callable[[Path, bool], list[str]]]] = {
    "methods": _methods,
    "acceptance": lambda _, quick: acceptance_table(
        ROWS[:1] if quick else ROWS, HELD_OUT_SEEDS[: 1 if quick else None]
    ),
    "pairs": lambda _, quick: pairs_table(many_pairs(4 if quick else PAIRS)),
    "drift": lambda _, quick: drift_table(
        {
            (name, back): drift(name, back=back, frames=40 if quick else 230)
            for name in ("fibres", "nuclei", "sparse")[: 1 if quick else None]
            for back in (False, True)
        }
    ),
    "turning": lambda _, quick: turning_table({walk: follow(walk) for walk in WALKS[: 1 if quick else None]}),
    "rotation": lambda _, quick: rotation.rotation_table(
        rotation.ROWS[:1] if quick else rotation.ROWS, rotation.HELD_OUT_SEEDS[: 1 if quick else None]
    ),
}
"""Tables of the page by their marks: folder of the pictures and `quick` to lines; each also draws its pictures."""
