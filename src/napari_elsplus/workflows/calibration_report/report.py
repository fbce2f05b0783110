"""Calibration report: one PDF with every number, fit, residual and picture of a calibration, for a lab's files.

Matplotlib is imported when one is drawn: the Calibration panel displays the numbers without it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from napari_elsplus import __version__
from napari_elsplus.instrument.calibration import AcquiredWith, FrameSection, OpticsSection
from napari_elsplus.io import refuse_suffix, replacing
from napari_elsplus.processing.calibration.draft import Setup
from napari_elsplus.processing.calibration.step import StepState
from napari_elsplus.processing.calibration.steps import calibration_steps
from napari_elsplus.processing.calibration.summaries import unevenness, with_uncertainty
from napari_elsplus.workflows.calibration_report.history import QUANTITIES
from napari_elsplus.workflows.calibration_report.plots import picture
from napari_elsplus.workflows.pictures.curves import PAPER_COLOURS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import BundleSection, Calibration
    from napari_elsplus.processing.calibration.draft import Draft
    from napari_elsplus.workflows.calibration_report.history import CalibrationHistory
    from napari_elsplus.workflows.calibration_report.picture import Picture, Plot

PAGE_MM: Final = (210.0, 297.0)
"""Width and height of a page: A4."""
DASHES: Final = {"none": "", "solid": "-", "dashed": "--", "dotted": ":"}
MAX_PLOT_HEIGHT: Final = 0.36
"""Of a page; chosen: a single plot is not stretched over the whole page."""
PICTURE_DPI: Final = 200
"""Resolution of pictures in the file, pixels per inch; chosen for print."""


def save_calibration_report(
    draft: Draft, path: Path, *, history: CalibrationHistory | None = None, force: bool = False
) -> int:
    """Save a calibration report: a page of numbers, a page for each step that was measured, and the history.

    Parameters
    ----------
    draft : Draft
        Calibration, and the results of the steps that were measured; a calibration that was read from a file has its
        numbers and arrays only.
    path : pathlib.Path
        PDF file; written beside and renamed.
    history : CalibrationHistory, optional
        Of earlier calibrations; a page is drawn of two or more.
    force : bool
        Overwrite an existing file.

    Returns
    -------
    int
        Number of pages.

    Raises
    ------
    InputError
        If the file is not named NAME.pdf, or exists and `force` is not given.
    """
    from matplotlib.backends.backend_pdf import PdfPages

    refuse_suffix(path, ".pdf")
    with replacing(path, force=force) as unfinished, PdfPages(unfinished) as pages:
        for number, figure in enumerate(draw_calibration_report(draft, history), 1):
            figure.text(0.92, 0.03, f"{number}", ha="right", fontsize=8, color="0.4")
            pages.savefig(figure, dpi=PICTURE_DPI)
        pages.infodict()["Title"] = f"Calibration report, {draft.calibration.created}"
    return number


def draw_calibration_report(draft: Draft, history: CalibrationHistory | None = None) -> Iterator[Figure]:
    """Draw the pages of a calibration report one by one; see :func:`save_calibration_report`."""
    setup = _setup(draft.calibration)
    yield _summary_page(draft)
    for step in calibration_steps():
        if step.key in draft.found:
            found = draft.found[step.key]
            yield _step_page(step.title, picture(step, found, draft, setup), _images(found, draft.calibration))
    if history is not None and len(history.files) > 1:
        yield _history_page(history)


class Number(NamedTuple):
    """A number of a calibration in words.

    Parameters
    ----------
    step : str
        Key of the step that measures it; empty for the optics.
    quantity, value, unit : str
        Value with one standard deviation, where it is known.
    """

    step: str
    quantity: str
    value: str
    unit: str


def calibration_numbers(calibration: Calibration) -> list[Number]:
    """Return the numbers of a calibration, each value with one standard deviation.

    Parameters
    ----------
    calibration : Calibration
        Complete or not; a section that was not measured has none.
    """
    rows = [
        Number(one.step, one.name, with_uncertainty(*found) if found[1] else f"{found[0]:.5g}", one.unit)
        for one in QUANTITIES
        if (found := one.of(calibration)) is not None
    ]
    if calibration.bundle is not None:
        centres = {"confocal": calibration.bundle.confocal_centre, "residual": calibration.bundle.residual_centre}
        rows += [
            Number("pair", f"{view} centre (row, col)", f"{row:.2f}, {col:.2f}", "px")
            for view, (row, col) in centres.items()
        ]
    if calibration.background is not None:
        level = f"{float(calibration.background.mean()):.2f}"
        rows.append(Number("background", "mean of the background", level, "grey levels"))
    if calibration.flat is not None:
        rows.append(Number("flat", "unevenness", f"{100 * unevenness(calibration.flat):.1f}", "%"))
    return rows


def _setup(calibration: Calibration) -> Setup:
    """Return the settings of a calibration's frames."""
    optics = calibration.optics or OpticsSection()
    return Setup(
        calibration.frame or FrameSection(shape=(1, 1)),
        calibration.acquired_with or AcquiredWith(),
        optics.line_period_s,
        optics.line_periods_per_frame,
        optics.um_per_px,
    )


def _page(title: str) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(PAGE_MM[0] / 25.4, PAGE_MM[1] / 25.4))
    figure.text(0.1, 0.94, title, fontsize=16, fontweight="bold")
    return figure


def _summary_page(draft: Draft) -> Figure:
    calibration = draft.calibration
    taken = calibration.acquired_with
    figure = _page("Calibration report")
    facts = [f"measured {calibration.created.replace('T', ' ').removesuffix('Z')} UTC"]
    if taken is not None:
        settings = (
            (taken.rig, "rig {}"), (taken.objective, "objective {}"), (taken.slit_rows, "slit {:g} rows"),
            (taken.frame_rate_hz, "{:.1f} Hz"), (taken.gain_db, "gain {:g} dB"),
        )  # fmt: skip
        facts.append(", ".join(text.format(value) for value, text in settings if value is not None))
    facts.append(f"napari-elsplus {__version__}; uncertainties are one standard deviation")
    figure.text(0.1, 0.925, "\n".join(fact for fact in facts if fact), fontsize=9, va="top", linespacing=1.5)
    rows = [("step", "state", ""), *_states(draft), ("", "", ""), ("quantity", "value", "unit")]
    rows += [number[1:] for number in calibration_numbers(calibration)]
    for line, cells in enumerate(rows):
        weight = "bold" if cells[0] in ("step", "quantity") else "normal"
        for left, cell in zip((0.1, 0.45, 0.72), cells, strict=True):
            figure.text(left, 0.85 - 0.02 * line, cell, fontsize=10, fontweight=weight)
    arrays = [
        (name, image)
        for name, image in (("background", calibration.background), ("flat field", calibration.flat))
        if image is not None
    ]
    for index, (name, image) in enumerate(arrays):
        _show(figure.add_axes((0.1 + 0.42 * index, 0.06, 0.36, 0.16)), name, image)
    return figure


def _states(draft: Draft) -> list[tuple[str, str, str]]:
    states = []
    for step in calibration_steps():
        state, reason = step.state(draft)
        elsewhere = "not measured in this session" if state is StepState.DONE and step.key not in draft.found else ""
        states.append((step.title, str(state), reason or elsewhere))
    return states


def _step_page(title: str, shown: Picture, images: Sequence[tuple[str, NDArray[Any], BundleSection | None]]) -> Figure:
    figure = _page(title[:1].upper() + title[1:])
    figure.text(0.1, 0.92, shown.headline.replace("\n", ", "), fontsize=13, va="top")
    notes = [*shown.lines, *shown.details, *(f"Warning: {warning}" for warning in shown.warnings)]
    figure.text(0.1, 0.895, "\n".join(notes), fontsize=8, va="top", linespacing=1.5)
    top = 0.87 - 0.016 * len(notes)
    height = min((top - 0.08) / max(len(shown.plots) + len(images), 1), MAX_PLOT_HEIGHT)
    for index, plot in enumerate(shown.plots):
        _draw(figure.add_axes((0.14, top - (index + 1) * height + 0.05, 0.76, height - 0.06)), plot)
    for index, (name, image, bundle) in enumerate(images, len(shown.plots)):
        axes = figure.add_axes((0.1, top - (index + 1) * height + 0.02, 0.8, height - 0.05))
        _show(axes, name, image, bundle)
    return figure


def _history_page(history: CalibrationHistory) -> Figure:
    figure = _page("History")
    notes = [f"{len(history.files)} calibrations of this rig", *(f"Warning: {one}" for one in history.warnings)]
    figure.text(0.1, 0.92, "\n".join(notes), fontsize=8, va="top", linespacing=1.5)
    top = 0.89 - 0.016 * len(notes)
    rows = -(-len(history.trends) // 2)
    height = min((top - 0.05) / max(rows, 1), MAX_PLOT_HEIGHT)
    for index, trend in enumerate(history.trends):
        row, col = divmod(index, 2)
        _draw(figure.add_axes((0.14 + 0.44 * col, top - (row + 1) * height + 0.05, 0.32, height - 0.07)), trend.plot)
    return figure


def _draw(axes: Axes, plot: Plot) -> None:
    for curve in plot.curves:
        (line,) = axes.plot(curve.x, curve.y, color=PAPER_COLOURS[curve.colour], linewidth=1)
        line.set(linestyle=DASHES[curve.dash], marker="." if curve.marks else "", markersize=3)
        line.set_label(curve.name if curve.listed else f"_{curve.name}")
    for position, colour, text in plot.marks:
        axes.axvline(position, color=PAPER_COLOURS[colour], linestyle=":", linewidth=0.8)
        axes.text(
            position, 0.95, f" {text}", transform=axes.get_xaxis_transform(), fontsize=8, color=PAPER_COLOURS[colour]
        )
    axes.set_xlabel(plot.bottom, fontsize=9)
    axes.set_ylabel(plot.left, fontsize=9)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    if any(curve.listed for curve in plot.curves):
        axes.legend(frameon=False, fontsize=8)


def _images(found: Any, calibration: Calibration) -> list[tuple[str, NDArray[Any], BundleSection | None]]:
    """Return the pictures of a step's result: name, image, and the bundle to be outlined."""
    if isinstance(found, np.ndarray) and found.ndim == 2:
        return [("flat field, mean 1", found, None)]
    if isinstance(mean := getattr(found, "mean", None), np.ndarray):
        return [("mean frame", mean, None)]
    if isinstance(image := getattr(found, "image", None), np.ndarray):
        return [("mean frame, with the located views", image, calibration.bundle)]
    return []


def _show(axes: Axes, name: str, image: NDArray[Any], bundle: BundleSection | None = None) -> None:
    shown = axes.imshow(image, cmap="gray", vmax=float(np.quantile(image, 0.999)), interpolation="nearest")
    bar = axes.figure.colorbar(shown, ax=axes, fraction=0.04, pad=0.02)
    bar.ax.tick_params(labelsize=7)
    axes.set_title(name, fontsize=9)
    axes.tick_params(labelsize=7)
    if bundle is not None:
        from matplotlib.patches import Circle

        centres = ((bundle.confocal_centre, "blue"), (bundle.residual_centre, "orange"))
        for (row, col), colour in centres:
            axes.add_patch(Circle((col, row), bundle.diameter_px / 2, fill=False, color=PAPER_COLOURS[colour]))
