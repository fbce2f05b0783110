"""Charts of benchmarks: cost against error with the Pareto front, failure maps, error against parameters."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from benchmarks.harness.methods import Chart, Role
from benchmarks.harness.verdict import pareto

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from benchmarks.harness.methods import Result, Row

COLOURS: Final = {Role.DEFAULT: "#d55e00", Role.OPTION: "#0072b2", Role.PAPER: "#000000", Role.PEER: "#009e73"}
MARKERS: Final = {Role.DEFAULT: "*", Role.OPTION: "o", Role.PAPER: "s", Role.PEER: "^"}
_OFTEN: Final = 0.05
"""Methods that fail on more of the inputs than this are drawn hollow."""
_FIELD_IN: Final = 4.6
_STAGE: Final = " / us"
"""Suffix of the details that are times of stages."""
_NARROW: Final = 50
"""Logarithmic axes that span less than this factor are marked at 1, 2 and 5."""
_LINE: Final = 0.035
"""Height of a line of labels, as a part of the panel."""


def draw_benchmark(result: Result) -> Figure:
    """Draw a benchmark's result as it asks to be drawn.

    Parameters
    ----------
    result : Result
        What was measured.

    Returns
    -------
    matplotlib.figure.Figure
        To be saved; it belongs to no screen.
    """
    draw = {
        Chart.PARETO: _pareto,
        Chart.FAILURES: _failures,
        Chart.PARSIMONY: _parsimony,
        Chart.STAGES: _stages,
        Chart.LATENCY: _latency,
        Chart.LEVELS: _levels,
    }
    figure = draw[result.benchmark.chart](result)
    figure.suptitle(result.benchmark.question)
    absent = f"   absent: {', '.join(result.absent)}" if result.absent else ""
    figure.supxlabel(result.machine + absent, fontsize=7, color="0.4")
    return figure


def _panels(count: int, height: float = 4.2) -> tuple[Figure, list[Axes]]:
    columns = min(count, 3)
    rows = -(-count // columns)
    figure = Figure(figsize=(max(_FIELD_IN * columns, 7.5), height * rows + 0.8), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for unused in axes[count:]:
        unused.set_axis_off()
    return figure, list(axes[:count])


def _pareto(result: Result) -> Figure:
    figure, panels = _panels(len(result.cases))
    for axes, case in zip(panels, result.cases, strict=True):
        rows = [row for row in result.of_case(case) if np.isfinite(row.error)]
        front = pareto(rows)
        axes.plot(
            [r.cost_us for r in front], [_shown(r.error) for r in front], color="0.6", drawstyle="steps-post", zorder=1
        )
        for row in rows:
            _draw_point(axes, row)
        lost = [row.method for row in result.of_case(case) if not np.isfinite(row.error)]
        axes.set_title(case + (f"\nno answer: {', '.join(lost)}" if lost else ""), fontsize=10)
        axes.set_xscale("log")
        if all(row.error > 0 for row in rows):
            axes.set_yscale("log")
        axes.set_xlabel("time for each / \N{MICRO SIGN}s")
        axes.set_ylabel(result.benchmark.error_label)
        axes.margins(x=0.25, y=0.15)
        axes.grid(visible=True, which="major", color="0.92")
        axes.autoscale_view()
        _label_points(axes, rows)
        for axis, limits in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
            if axis.get_scale() == "log":
                narrow = limits[1] < _NARROW * limits[0]
                axis.set_major_locator(LogLocator(subs=(1, 2, 5) if narrow else (1,)))
                axis.set_major_formatter(StrMethodFormatter("{x:g}"))
                axis.set_minor_formatter(NullFormatter())
    return figure


def _draw_point(axes: Axes, row: Row) -> None:
    colour, often = COLOURS[row.role], row.failed > _OFTEN * row.items
    axes.errorbar(row.cost_us, row.error, xerr=row.cost_spread_us, color=colour, linewidth=0.8, zorder=2)
    axes.plot(
        row.cost_us, row.error, MARKERS[row.role], color=colour, markerfacecolor="white" if often else colour,
        markersize=13 if row.role is Role.DEFAULT else 7, zorder=3,
    )  # fmt: skip


def _label_points(axes: Axes, rows: list[Row]) -> None:
    """Write each method's name beside its point, towards the middle of the panel, and not over another's."""
    to_panel = axes.transData + axes.transAxes.inverted()
    places = to_panel.transform([(row.cost_us, row.error) for row in rows])
    above = -1.0
    for (x, y), row in sorted(zip(places.tolist(), rows, strict=True), key=lambda placed: placed[0][1]):
        to_the_left = x > 0.5
        above = max(y + 0.015, above + _LINE)
        label = row.method + (f" ({100 * row.failed / row.items:.0f} % fail)" if row.failed else "")
        axes.text(
            x + (-0.02 if to_the_left else 0.02), above, label, transform=axes.transAxes, fontsize=7,
            color=COLOURS[row.role], ha="right" if to_the_left else "left",
        )  # fmt: skip


def _shown(error: float) -> float:
    return max(error, 1e-12)


def _failures(result: Result) -> Figure:
    """For each stress, methods down and levels across: failures, and how many of them nobody noticed."""
    groups = list(dict.fromkeys(row.group for row in result.rows))
    methods = list(dict.fromkeys(row.method for row in result.rows))
    figure, panels = _panels(len(groups), 0.42 * len(methods) + 1.3)
    for axes, group in zip(panels, groups, strict=True):
        rows = [row for row in result.rows if row.group == group]
        levels = list(dict.fromkeys(row.level for row in rows))
        shares = np.full((len(methods), len(levels)), np.nan)
        for row in rows:
            at = methods.index(row.method), levels.index(row.level)
            shares[at] = row.failed / row.items
            if row.failed:
                silent = f"\n{100 * row.silent / row.items:.0f} silent" if row.silent else "\nnoticed"
                axes.text(
                    at[1], at[0], f"{100 * row.failed / row.items:.0f}{silent}", ha="center", va="center", fontsize=6.5
                )
        axes.imshow(shares, cmap="Reds", vmin=0, vmax=1.3, aspect="auto")
        axes.set_title(group, fontsize=10)
        axes.set_xticks(range(len(levels)), [f"{level:g}" for level in levels], fontsize=8)
        axes.set_yticks(range(len(methods)), methods, fontsize=7)
    return figure


def _parsimony(result: Result) -> Figure:
    figure, panels = _panels(len(result.cases))
    for axes, case in zip(panels, result.cases, strict=True):
        rows = sorted(result.of_case(case), key=lambda row: row.parameters or 0)
        counted = [(row, row.parameters) for row in rows if row.parameters is not None]
        axes.plot([count for _, count in counted], [row.error for row, _ in counted], color="0.75", zorder=1)
        for row, count in counted:
            axes.plot(count, row.error, MARKERS[row.role], color=COLOURS[row.role],
                      markersize=13 if row.role is Role.DEFAULT else 7, zorder=3)  # fmt: skip
            axes.annotate(row.method, (count, row.error), (5, 4), textcoords="offset points", fontsize=7)
        for row in rows:
            if row.parameters is None:
                axes.axhline(row.error, color=COLOURS[row.role], linestyle="--", label=row.method)
                axes.legend(frameon=False, fontsize=7)
        axes.set_title(case, fontsize=10)
        axes.set_xlabel("parameters")
        axes.set_ylabel(result.benchmark.error_label)
        if all(0 < row.error < np.inf for row in rows):
            axes.set_yscale("log")
        axes.margins(x=0.3, y=0.2)
        axes.grid(visible=True, which="major", color="0.92")
    return figure


def _stages(result: Result) -> Figure:
    """For each method a bar of what a frame costs, in the pieces that were measured."""
    stages = list(dict.fromkeys(name for row in result.rows for name in row.details if name.endswith(_STAGE)))
    height = 0.45 * max(len(result.of_case(case)) for case in result.cases) + 1.1
    figure = Figure(figsize=(9.0, height * len(result.cases) + 1.0), layout="constrained")
    panels = figure.subplots(len(result.cases), 1, squeeze=False, sharex=True).ravel()
    colours = [*colormaps["tab10"].colors[: len(stages)]]  # type: ignore[attr-defined]
    for axes, case in zip(panels, result.cases, strict=True):
        rows = result.of_case(case)
        default = next((row for row in rows if row.role is Role.DEFAULT), rows[0])
        for place, row in enumerate(rows):
            left = 0.0
            for stage, colour in zip(stages, colours, strict=True):
                us = row.details.get(stage, 0.0)
                us = us if np.isfinite(us) else 0.0
                axes.barh(place, us, left=left, color=colour, height=0.6)
                left += us
            axes.barh(place, max(row.cost_us - left, 0.0), left=left, color="0.85", height=0.6)
            ratio = "" if row is default else f", {row.cost_us / default.cost_us:.2g} times"
            axes.text(
                max(row.cost_us, left), place, f"  {row.cost_us:.0f} \N{MICRO SIGN}s{ratio}; error {row.error:.2g}",
                va="center", fontsize=8,
            )  # fmt: skip
        axes.set_yticks(range(len(rows)), [row.method for row in rows], fontsize=8)
        for label, row in zip(axes.get_yticklabels(), rows, strict=True):
            label.set_color(COLOURS[row.role])
        axes.invert_yaxis()
        axes.set_title(case, fontsize=10)
        axes.margins(x=0.35)
        axes.spines[["top", "right"]].set_visible(False)
    panels[-1].set_xlabel("time for each frame / \N{MICRO SIGN}s")
    keys = [
        Patch(color=colour, label=stage.removesuffix(_STAGE)) for stage, colour in zip(stages, colours, strict=True)
    ]
    panels[0].legend(
        handles=[*keys, Patch(color="0.85", label="not taken apart")], loc="upper right", ncols=2, fontsize=8,
        frameon=False,
    )  # fmt: skip
    return figure


def _latency(result: Result) -> Figure:
    """For each method, the share of frames that are later than a latency."""
    figure, panels = _panels(len(result.cases))
    for axes, case in zip(panels, result.cases, strict=True):
        for row, style in zip(result.of_case(case), cycle(("o-", "s--", "^:"))):
            known = {name.removesuffix(" % / ms"): ms for name, ms in row.details.items() if name.endswith(" % / ms")}
            later = [1 - float(percent) / 100 for percent in known]
            drawn = [(ms, share) for ms, share in zip(known.values(), later, strict=True) if share > 0]
            label = f"{row.method}, {row.cost_us:.0f} \N{MICRO SIGN}s of processor time a frame"
            axes.plot(*zip(*drawn, strict=True), style, color=COLOURS[row.role], label=label)
            axes.plot(max(known.values()), drawn[-1][1] / 3, "|", color=COLOURS[row.role])
        axes.set_title(case, fontsize=10)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("latency / ms (bars: the largest)")
        axes.set_ylabel("share of frames that are later")
        axes.grid(visible=True, which="major", color="0.92")
        axes.legend(frameon=False, fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.13))
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
    return figure


def _levels(result: Result) -> Figure:
    """Draw what is measured against a level: its rate, and what each image costs."""
    figure, (rate, cost) = _panels(2)
    for method in dict.fromkeys(row.method for row in result.rows):
        rows = [row for row in result.rows if row.method == method]
        levels, colour = [row.level for row in rows], COLOURS[rows[0].role]
        rate.plot(levels, [1e3 / row.error for row in rows], "o-", color=colour, label=method)
        for name, style in (("update / ms", "o-"), ("drawing and all else / ms", "s:")):
            label = f"{name.removesuffix(' / ms')}, {method}"
            cost.plot(levels, [row.details[name] for row in rows], style, color=colour, label=label)
    rate.set_ylabel("images shown each second")
    cost.set_ylabel("time of the window for each image / ms")
    for axes in (rate, cost):
        axes.set_xlabel(result.rows[0].group)
        axes.set_xticks(sorted({row.level for row in result.rows}))
        axes.set_ylim(bottom=0)
        axes.legend(frameon=False, fontsize=7)
        axes.grid(visible=True, which="major", color="0.92")
    return figure
