"""The paper's figures, ours: drawn anew from the simulated rig, with the numbers that go with them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from benchmarks.studies import paper, resolution
from napari_elsplus.processing.analysis.image_quality import PAPER_ALIGNMENT_PERCENT, contrast, white_level
from napari_elsplus.processing.calibration.bundle.cancellation import FILTER_NAMES
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.tracking.registry import Method
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.workflows.comparison import compare
from napari_elsplus.workflows.pictures.comparison import draw_comparison
from napari_elsplus.workflows.pictures.files import save_figure

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from benchmarks.studies.paper import Calibrated, Mosaicked, MovingFrames
    from benchmarks.studies.resolution import Resolved
    from napari_elsplus.processing.calibration.bundle.cancellation import AlignmentErrors

    Image = NDArray[np.float32]

SHOWN: Final = (Mode.LS, Mode.ELSA, Mode.ELS)


def make(
    folder: Path, *, quick: bool = False, force: bool = False, report: Callable[[str], None] = lambda _: None
) -> dict[str, str]:
    """Draw the figures into a folder.

    Parameters
    ----------
    folder : pathlib.Path
        Gets ``paper-NAME.png`` for each.
    quick : bool
        Few frames: whether it runs.
    force : bool
        Overwrite existing files.
    report : callable
        Called with the name of the figure in progress.

    Returns
    -------
    dict
        Name to a markdown table of its numbers.
    """
    tables: dict[str, str] = {}

    def keep(name: str, figure: Figure, table: str) -> None:
        save_figure(figure, folder / f"paper-{name}.png", force=force)
        tables[f"paper-{name}"] = table

    report("calibration")
    found = paper.calibrate_simulated(Instrument.of("120hz" if not quick else "240hz"), 20 if quick else 400)
    keep("calibration", draw_calibration(found), calibration_table(found))
    tables["paper-alignment"] = alignment_table(found)
    report("USAF target")
    chosen = dict(list(resolution.modes().items())[1:2]) if quick else resolution.modes()
    resolved = {name: resolution.measure_mode(mode, 2 if quick else resolution.PLACES) for name, mode in chosen.items()}
    keep("resolution", draw_images({name: one.image for name, one in resolved.items()}, 2), resolution_table(resolved))
    report("lens paper, 10 Hz")
    frames = paper.lens_paper()
    comparison = compare(frames.raw, frames.rig.calibration, 1)
    keep("motion", draw_comparison(comparison), motion_table(frames))
    report("lens paper, 240 Hz")
    frames = paper.lens_paper_mosaic(8 if quick else 168)
    made = {
        "LS": paper.mosaic(frames, Mode.LS),
        "ELS+": paper.mosaic(frames, Mode.ELS),
        "ELS+, live": paper.mosaic(frames, Mode.ELS, live=True),
        "ELS+, the paper's tracking": paper.mosaic(frames, Mode.ELS, Method.PAPER),
    }
    keep("mosaics", draw_images({name: m.image for name, m in made.items()}, 2), mosaic_table(made))
    report("tissue, 60 Hz")
    frames = paper.tissue(6 if quick else 60)
    single = paper.sectioned(frames, SHOWN)
    made = {"LS": paper.mosaic(frames, Mode.LS), "ELS+": paper.mosaic(frames, Mode.ELS)}
    images = {f"{mode.label} frame": one.image for mode, one in single.items()}
    images |= {f"{name} mosaic": m.image for name, m in made.items()}
    keep("tissue", draw_images(images, 3), mosaic_table(made))
    return tables


def draw_calibration(found: Calibrated) -> Figure:
    """Draw line, sweep and located views as the camera sees them; the line in both views, and the galvo's map."""
    draft, bundle = found.draft, found.draft.calibration.bundle
    assert draft.offset is not None
    assert draft.galvo is not None
    assert bundle is not None
    galvo = draft.galvo
    figure = Figure(figsize=(12, 6.8), layout="constrained")
    grid = figure.add_gridspec(2, 6, height_ratios=(0.9, 1))
    for place, (title, picture) in enumerate(found.pictures.items()):
        axes = figure.add_subplot(grid[0, 2 * place : 2 * place + 2])
        axes.imshow(picture, cmap="gray", vmin=0, vmax=float(np.quantile(picture, 0.999)))
        axes.set_title(title, fontsize=9)
        axes.set_axis_off()
    for centre, colour in ((bundle.confocal_centre, "#0072b2"), (bundle.residual_centre, "#d55e00")):
        axes.add_patch(Circle(centre[::-1], bundle.diameter_px / 2, fill=False, color=colour))
        axes.plot(centre[1], centre[0], "+", color=colour, markersize=10)
    left, right = figure.add_subplot(grid[1, :3]), figure.add_subplot(grid[1, 3:])
    for name, line, colour in (("left", draft.offset.confocal, "#0072b2"), ("right", draft.offset.residual, "#d55e00")):
        rows = np.linspace(line.row - 12, line.row + 12, 200)
        bell = line.amplitude * np.exp(-((rows - line.row) ** 2) / (2 * line.width_rows**2))
        left.plot(rows, bell, color=colour, label=f"{name} view, row {line.row:.2f}")
    left.set(xlabel="row", ylabel="fitted line / grey levels", title=f"slit offset {draft.offset.rows:.3f} rows")
    left.legend(frameon=False)
    right.plot(galvo.volts[galvo.used], galvo.rows[galvo.used], ".", color="0.4", markersize=3)
    volts = np.array([galvo.volts.min(), galvo.volts.max()])
    right.plot(volts, np.asarray(galvo.row(volts)), color="#d55e00", linewidth=1)
    right.set(
        xlabel="galvo / V", ylabel="row of the line", title=f"1 - R\N{SUPERSCRIPT TWO} = {1 - galvo.r_squared:.1e}"
    )
    return figure


def calibration_table(found: Calibrated) -> str:
    """Found, its uncertainty, and its error."""
    calibration, errors = found.draft.calibration, found.errors
    offset, galvo, bundle, quality = calibration.offset, calibration.galvo, calibration.bundle, calibration.quality
    assert offset is not None
    assert galvo is not None
    assert bundle is not None
    assert quality is not None
    papers, papers_filtered = PAPER_ALIGNMENT_PERCENT
    return _table(
        ("", "found", "off the truth by"),
        ("slit offset / rows", f"{offset.rows:.3f} +- {offset.uncertainty_rows:.3f}", f"{errors.offset_rows:+.4f}"),
        ("galvo / V per row", f"{galvo.volts_per_row:.6f}", f"{errors.galvo_slope_percent:+.4f} %"),
        ("galvo at row 0 / V", f"{galvo.volts_at_row_zero:.4f}", f"{errors.galvo_intercept_rows:+.3f} rows"),
        ("1 - R\N{SUPERSCRIPT TWO}", f"{1 - galvo.r_squared:.1e}", "(the paper: 0.01)"),
        ("right view onto the left / px", "", f"{errors.pair_alignment_px:.4f}"),
        ("brightness of the right view", f"{bundle.residual_gain:.4f}", f"{errors.residual_gain_percent:+.3f} %"),
        ("alignment error", f"{100 * quality.alignment_error:.2f} %", f"(the paper: {papers} %)"),
        *(
            (f"the same, after the {FILTER_NAMES[kind]}", f"{100 * error:.2f} %", f"(the paper: {papers_filtered} %)")
            for kind, error in found.alignment.filtered.items()
        ),
    )


def alignment_table(found: Calibrated) -> str:
    """Alignment errors of views aligned by their cores and by their centres, after each filter, and the paper's."""
    kinds = (CoreFilter.GAUSSIAN, CoreFilter.MEDIAN)
    papers, papers_filtered = PAPER_ALIGNMENT_PERCENT
    usual = next(iter(found.by_centres))
    rows = {f"cores; {usual}": found.alignment} | {
        f"centres alone; {views}": errors for views, errors in found.by_centres.items()
    }

    def percents(errors: AlignmentErrors) -> list[str]:
        after = (f"{100 * errors.filtered[kind]:.2f} %" if kind in errors.filtered else "" for kind in kinds)
        return [f"{100 * errors.before:.2f} %", *after]

    return _table(
        ("views aligned by", "unfiltered", *(f"after the {FILTER_NAMES[kind]}" for kind in kinds)),
        ("the paper: centres alone; core filter said to be a 3x3 median", f"{papers} %", "", f"{papers_filtered} %"),
        *((name, *percents(errors)) for name, errors in rows.items()),
    )


def resolution_table(resolved: dict[str, Resolved]) -> str:
    """Finest resolved line pair of each mode, unfiltered and after the median, beside the paper's."""
    titles = (
        "pixels per core",
        "field / um",
        "line pair, unfiltered / um",
        "after the 3x3 median / um",
        "the paper / um",
    )
    return _table(
        ("mode", *titles),
        *(
            (
                name, f"{one.px_per_core:.1f}", f"{one.field_um:.0f}",
                *(f"{one.line_pair_um[cores]:.2f}" for cores in (CoreFilter.NONE, CoreFilter.MEDIAN)),
                resolution.PAPER.get(name, ""),
            )
            for name, one in resolved.items()
        ),
    )  # fmt: skip


def motion_table(frames: MovingFrames) -> str:
    """Background of each image as a share of its structure, and how far it is from the focal plane."""
    found = paper.sectioned(frames, SHOWN)
    step = float(np.hypot(*np.diff(frames.true_px, axis=0).T).mean()) * frames.rig.um_per_px
    rows = [(mode.label, f"{100 * one.background:.1f} %", f"{one.unexplained:.3f}") for mode, one in found.items()]
    titles = ("background over structure", "part the focal plane does not explain")
    return _table((f"probe moves {step:.0f} um a frame", *titles), *rows)


def mosaic_table(made: dict[str, Mosaicked]) -> str:
    """Tracks against the path."""
    rows = [
        (
            name, f"{m.errors.tracked}/{m.errors.frames}", str(m.segments), f"{m.errors.median_pair_error_px:.3f}",
            f"{m.errors.end_error_percent_of_path:.3f}", str(m.errors.wrong_links), f"{_haze(m.image):.2f}",
        )
        for name, m in made.items()
    ]  # fmt: skip
    titles = ("", "frames tracked", "segments", "pair error / px", "end error / % of the path", "wrong links")
    return _table((*titles, "background over structure"), *rows)


def _haze(image: Image) -> float:
    levels = contrast(image, image != 0)
    return levels.background / levels.structure


def draw_images(images: dict[str, Image], columns: int) -> Figure:
    """Draw grey images, each to its own white, 0.01 % saturated."""
    rows = -(-len(images) // columns)
    tallest = max(image.shape[0] / image.shape[1] for image in images.values())
    figure = Figure(figsize=(6 * columns, (6 * min(tallest, 0.75) + 0.4) * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in panels[len(images) :]:
        axes.set_axis_off()
    for axes, (name, image) in zip(panels, images.items(), strict=False):
        axes.imshow(image, cmap="gray", vmin=0, vmax=white_level(image[image != 0]), interpolation="nearest")
        axes.set_title(name)
        axes.set_axis_off()
    return figure


def _table(*rows: tuple[str, ...]) -> str:
    lines = [rows[0], ("---",) * len(rows[0]), *rows[1:]]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
