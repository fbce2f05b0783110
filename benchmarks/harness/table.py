"""Results as a table: for the terminal, for a spreadsheet, for the documentation."""

from __future__ import annotations

import csv
from itertools import takewhile
from math import isfinite, isnan
from typing import TYPE_CHECKING, Any

from benchmarks.harness.methods import Chart, Role, Row
from benchmarks.harness.verdict import verdict
from napari_elsplus.cli.options import refuse_outputs
from napari_elsplus.io import replacing

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from benchmarks.harness.methods import Result

_NUMBERS = (
    "level", "cost_us", "cost_spread_us", "warm_up_ms", "error", "error_p90",
    "items", "failed", "caught", "flagged", "silent", "false_alarms",
)  # fmt: skip


_OFTEN = 0.1
"""Failures on more of the inputs than this are a breakdown."""


def write_csv(result: Result, path: Path, *, force: bool = False) -> None:
    """Write every row, all digits, one column for each detail.

    Raises
    ------
    InputError
        If the file exists and is not to be overwritten.
    """
    details = list(dict.fromkeys(name for row in result.rows for name in row.details))
    names = ("benchmark", "case", "group", "method", "role", *_NUMBERS, "parameters", "is_default", "is_peer")
    rows = (
        (*(_cell(row, name) for name in names), *(row.details.get(name, "") for name in details)) for row in result.rows
    )
    write_rows(path, (*names, *details), rows, force=force)


def results_in(folder: Path, *names: str, force: bool) -> list[Path]:
    """Make a folder, and return the files of these names in it, which are to be written.

    Raises
    ------
    InputError
        If one exists and is not to be overwritten.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / name for name in names]
    refuse_outputs(*files, force=force)
    return files


def write_rows(path: Path, titles: Sequence[str], rows: Iterable[Sequence[object]], *, force: bool = False) -> None:
    """Write titles and rows as a spreadsheet.

    Raises
    ------
    InputError
        If the file exists and is not to be overwritten.
    """
    with replacing(path, force=force) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows((titles, *rows))


def _cell(row: Row, name: str) -> Any:
    match name:
        case "is_default":
            return int(row.role is Role.DEFAULT)
        case "is_peer":
            return int(row.role is Role.PEER)
        case "parameters":
            return "" if row.parameters is None else row.parameters
    value = getattr(row, name)
    return "" if isinstance(value, float) and isnan(value) else value


def header(result: Result) -> list[str]:
    """Column titles of :func:`lines`."""
    details = list(dict.fromkeys(name for row in result.rows for name in row.details))
    parameters = ["parameters"] if result.benchmark.chart is Chart.PARSIMONY else []
    claims = any(row.failed for row in result.rows)
    return [
        "case", "method", "is", "time", "of default's", result.benchmark.error_label, "90 %",
        *(["failed", "caught / flagged / silent"] if claims else []), *parameters, *details,
    ]  # fmt: skip


def lines(result: Result) -> list[list[str]]:
    """Return the rows as texts, times as ratios to the default's."""
    titles = header(result)
    found = []
    for row in result.rows:
        default = next((r for r in result.of_case(row.case) if r.role is Role.DEFAULT), row)
        cells = {
            "case": row.case,
            "method": row.method,
            "is": row.role.value,
            "time": duration(row.cost_us),
            "of default's": f"{row.cost_us / default.cost_us:.2g}",
            result.benchmark.error_label: number(row.error),
            "90 %": number(row.error_p90),
            "failed": f"{row.failed}/{row.items}",
            "caught / flagged / silent": f"{row.caught} / {row.flagged} / {row.silent}" if row.failed else "",
            "parameters": "" if row.parameters is None else str(row.parameters),
        }
        found.append([cells[t] if t in cells else number(row.details.get(t, float("nan"))) for t in titles])
    return found


def markdown(result: Result) -> str:
    """Return the table and what it says of the default, for the documentation."""
    titles = header(result)
    rows = [titles, ["---"] * len(titles), *lines(result)]
    text = "\n".join("| " + " | ".join(cell.replace("|", "/") for cell in row) + " |" for row in rows)
    said = (
        [f"- {case}: {verdict(result, case)}." for case in result.cases]
        if result.benchmark.chart in (Chart.PARETO, Chart.STAGES)
        else []
    )
    gone = [f"- Absent: {name} ({why})." for name, why in result.absent.items()]
    return "\n\n".join(part for part in (text, "\n".join([*said, *gone]), result.benchmark.remarks) if part)


def breakdowns(result: Result) -> str:
    """Return, for each stress and method, the level of breakdown and the silent failures, as markdown."""
    rows = [("stress", "method", "borne up to", "at the worst level, failed", "noticed", "silent"), ("---",) * 6]
    groups = dict.fromkeys((row.group, row.method) for row in result.rows)
    for group, method in groups:
        levels = [row for row in result.rows if (row.group, row.method) == (group, method)]
        borne = [row.level for row in takewhile(lambda row: row.failed <= _OFTEN * row.items, levels)]
        worst = max(levels, key=lambda row: row.failed / row.items)
        rows.append(
            (
                group, method, f"{borne[-1]:g}" if borne else "nothing tried",
                f"{_percent(worst.failed, worst.items)} ({worst.level:g})" if worst.failed else "none",
                _percent(sum(r.caught + r.flagged for r in levels), sum(r.failed for r in levels)),
                _percent(sum(r.silent for r in levels), sum(r.failed for r in levels)),
            )
        )  # fmt: skip
    gone = [f"Absent: {name} ({why})." for name, why in result.absent.items()]
    table = "\n".join("| " + " | ".join(row) + " |" for row in rows)
    return "\n\n".join([table, *gone, result.benchmark.remarks])


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.0f} %" if whole else "-"


def number(value: float) -> str:
    """Three digits; a dash for what is not there, `failed` for infinity."""
    if isnan(value):
        return "-"
    return f"{value:.3g}" if isfinite(value) else "failed"


def duration(us: float) -> str:
    """Microseconds below ten thousand, milliseconds above."""
    return f"{us:.0f} us" if us < 1e4 else f"{us / 1e3:.0f} ms"
