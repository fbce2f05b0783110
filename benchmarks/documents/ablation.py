"""Table and chart of the ablation of the acceptance test and the tracker's decisions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure

from benchmarks.studies.ablation import KINDS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmarks.studies.ablation import Change, Outcome

    Ablated = tuple[Change, list[Outcome]]

_MARKS: Final = {"left out": ("X", "#d55e00"), "x 0.5": ("v", "#0072b2"), "x 2": ("^", "#009e73")}
_OTHER: Final = ("o", "0.4")


def ablation_table(found: Sequence[Ablated]) -> str:
    """Return the table: for each change and kind of recording wrong registrations, right ones kept, and drift."""
    kinds = [str(kind) for kind in KINDS[: len(found[0][1])]]
    lines = [
        f"| rule or constant | change | wrong, all | {' | '.join(kinds)} |",
        f"|---|---|---|{'---|' * len(kinds)}",
    ]
    for change, outcomes in found:
        cells = (f"{o.wrong}; {o.kept_percent:.1f} %; {o.drift_percent:.3f} %" for o in outcomes)
        lines.append(
            f"| {change.rule} | {change.change} | {sum(o.wrong for o in outcomes)} of "
            f"{sum(o.accepted for o in outcomes)} | {' | '.join(cells)} |"
        )
    return "\n".join(lines)


def draw_ablation(found: Sequence[Ablated]) -> Figure:
    """Draw what each change does to wrong registrations and right ones kept, against the package as it is."""
    (_, base), *rest = found
    rules = list(dict.fromkeys(change.rule for change, _ in rest))
    figure = Figure(figsize=(11, 0.24 * len(rules) + 1.6), layout="constrained")
    wrong, kept = figure.subplots(1, 2, sharey=True)
    labelled = set()
    for change, outcomes in rest:
        mark, colour = _MARKS.get(change.change, _OTHER)
        label = change.change if change.change in _MARKS else "else"
        more = sum(o.wrong for o in outcomes) - sum(o.wrong for o in base)
        gained = float(np.mean([o.kept_percent - b.kept_percent for o, b in zip(outcomes, base, strict=True)]))
        for axes, value in ((wrong, more), (kept, gained)):
            axes.plot(
                value, rules.index(change.rule), mark, color=colour, alpha=0.8,
                label=label if axes is wrong and label not in labelled else None,
            )  # fmt: skip
        labelled.add(label)
    wrong.set(yticks=range(len(rules)), xlabel="wrong registrations, change")
    wrong.set_yticklabels(rules, fontsize=8)
    wrong.set_xscale("symlog", linthresh=5)
    kept.set_xscale("symlog", linthresh=2)
    kept.set_xlabel("right registrations kept, change in % points")
    wrong.invert_yaxis()
    for axes in (wrong, kept):
        axes.axvline(0, color="0.6", lw=0.8)
        axes.grid(axis="y", lw=0.3)
    figure.legend(loc="outside upper center", ncols=4, frameon=False)
    wrong_of_all = f"{sum(o.wrong for o in base)} of {sum(o.accepted for o in base)}"
    figure.supxlabel(f"unchanged, {wrong_of_all} registrations are wrong", fontsize=8, color="0.4")
    return figure
