"""Every case measured on a clean rig, on the disturbed one, and on that with the correction switched off."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from math import isfinite, nan
from typing import TYPE_CHECKING, Final

from matplotlib.figure import Figure

from benchmarks.harness.table import write_rows
from benchmarks.imperfect.cases import CASES, corrects
from napari_elsplus.errors import ElsPlusError, InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from benchmarks.imperfect.cases import Case

COLUMNS: Final = (
    "case", "imperfections", "preset", "quantity", "unit", "clean", "disturbed", "switched_off", "aim", "holds",
    "refused",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Outcome:
    """One case measured.

    Parameters
    ----------
    case : Case
        Which.
    clean, disturbed, switched_off : float
        The number without the imperfection, with it, and with it and without its correction; NaN if it was refused, and
        of the last if nothing is corrected.
    refused : str
        What the software said, if it refused the disturbed rig.
    """

    case: Case
    clean: float
    disturbed: float
    switched_off: float
    refused: str

    @property
    def holds(self) -> bool:
        """True if the aim is reached."""
        return isfinite(self.disturbed) and self.case.aim.holds(self.clean, self.disturbed)

    def cells(self) -> list[str]:
        """Return the cells of a table, in the order of `COLUMNS`."""
        case, digits = self.case, self.case.quantity.digits

        def number(value: float) -> str:
            return f"{value:.{digits}f}" if isfinite(value) else ""

        return [
            case.name, case.imperfections, case.preset, case.quantity.name, case.quantity.unit, number(self.clean),
            number(self.disturbed) or "refused", number(self.switched_off), case.aim.text,
            "yes" if self.holds else "no", self.refused,
        ]  # fmt: skip


def run_cases(cases: Sequence[Case], path: Path, report: Callable[[str], None] = lambda _: None) -> list[Outcome]:
    """Measure cases one after the other; those that a CSV file has already are not measured again.

    Parameters
    ----------
    cases : sequence of Case
        Which.
    path : pathlib.Path
        The CSV file, a row for each case, which is written after each.
    report : callable
        Receives the name of the case that is being measured.

    Raises
    ------
    InputError
        If the file exists, and was not written by this function.
    """
    known = read_outcomes(path, cases) if path.exists() else {}
    for case in cases:
        if _key(case) not in known:
            report(f"{case.name}: {case.quantity.name}")
            known[_key(case)] = measure_case(case)
            write_outcomes([known[_key(each)] for each in cases if _key(each) in known], path, force=True)
    return [known[_key(case)] for case in cases]


def measure_case(case: Case) -> Outcome:
    """Measure one case."""
    clean, disturbed = case.clean, case.disturbed
    before = case.quantity.measure(clean, ())
    try:
        after = case.quantity.measure(disturbed, ())
    except ElsPlusError as error:
        return Outcome(case, before, nan, nan, str(error))
    return Outcome(case, before, after, _switched_off(case), "")


def _switched_off(case: Case) -> float:
    if not corrects(case.calibration, case.corrections):
        return nan
    try:
        return case.quantity.measure(case.disturbed, case.corrections)
    except ElsPlusError:
        return nan


def read_outcomes(path: Path, cases: Iterable[Case]) -> dict[tuple[str, str, str], Outcome]:
    """Return the outcomes of cases that a CSV file of :func:`write_outcomes` has, by their keys.

    Raises
    ------
    InputError
        If it is another file.
    """
    by_name = {_key(case): case for case in cases}
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if tuple(reader.fieldnames or ()) != COLUMNS:
            raise InputError(f"{path} is no table of cases", "choose another folder")
        rows = list(reader)
    outcomes = {}
    for row in rows:
        key = row["imperfections"], row["preset"], row["quantity"]
        if (case := by_name.get(key)) is not None:
            clean, disturbed, switched_off = (_number(row[name]) for name in ("clean", "disturbed", "switched_off"))
            outcomes[key] = Outcome(case, clean, disturbed, switched_off, row["refused"])
    return outcomes


def _key(case: Case) -> tuple[str, str, str]:
    """Return what tells one case from the others: imperfections, preset, quantity."""
    return case.imperfections, case.preset, case.quantity.name


def _number(text: str) -> float:
    return float(text) if text not in ("", "refused") else nan


def quick_cases() -> list[Case]:
    """Return a few cases that take seconds."""
    return [case for case in CASES if case.quick]


def write_outcomes(outcomes: list[Outcome], path: Path, *, force: bool = False) -> None:
    """Write outcomes to a CSV file, a row each.

    Raises
    ------
    InputError
        If the file exists and `force` is not given.
    """
    write_rows(path, COLUMNS, (outcome.cells() for outcome in outcomes), force=force)


def markdown(outcomes: list[Outcome]) -> str:
    """Return outcomes as a Markdown table, and how many aims are reached."""
    titles = ("imperfection", "measured", "clean", "disturbed", "switched off", "aim", "reached")
    rows = []
    for outcome in outcomes:
        name, _, preset, quantity, unit, clean, disturbed, off, aim, holds, _ = outcome.cells()
        rows.append((f"{name} ({preset})", f"{quantity} {unit}".strip(), clean, disturbed, off, aim, holds))
    lines = [" | ".join(row) for row in (titles, ("---",) * len(titles), *rows)]
    held = sum(outcome.holds for outcome in outcomes)
    return "\n".join([*(f"| {line} |" for line in lines), "", f"{held} of {len(outcomes)} aims are reached."])


def draw_outcomes(outcomes: list[Outcome]) -> Figure:
    """Draw each case's disturbed number, with and without its correction, relative to the clean one."""
    figure = Figure(figsize=(9, 1.2 + 0.26 * len(outcomes)), layout="constrained")
    axes = figure.subplots()
    for place, outcome in enumerate(outcomes):
        for value, marker, color in ((outcome.switched_off, "x", "tab:red"), (outcome.disturbed, "o", "tab:blue")):
            ratio = value / outcome.clean if outcome.clean else nan
            if isfinite(ratio) and ratio > 0:
                axes.plot(ratio, place, marker, color=color)
        if not isfinite(outcome.disturbed):
            axes.text(1, place, " refused", va="center", color="tab:red", fontsize=7)
    labels = [f"{one.case.name}: {one.case.quantity.name}" for one in outcomes]
    axes.set_yticks(range(len(outcomes)), labels, fontsize=7)
    axes.set(
        xscale="log", xlabel="disturbed over clean (cross: with the correction switched off)", ylim=(len(outcomes), -1)
    )
    axes.axvline(1, color="grey", lw=0.8)
    axes.grid(alpha=0.3, axis="x", which="both")
    return figure
