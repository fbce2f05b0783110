"""Test of a default against the Pareto front of cost and error."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from benchmarks.harness.methods import Role

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmarks.harness.methods import Result, Row


def pareto(rows: Sequence[Row]) -> list[Row]:
    """Rows of one case that no other beats in both cost and error, cheapest first.

    Examples
    --------
    >>> from types import SimpleNamespace as Row
    >>> rows = [Row(cost_us=c, error=e) for c, e in ((1, 9), (2, 5), (3, 6), (4, 1))]
    >>> [row.cost_us for row in pareto(rows)]
    [1, 2, 4]
    """
    front: list[Row] = []
    for row in sorted(rows, key=lambda row: (row.cost_us, row.error)):
        if np.isfinite(row.error) and (not front or row.error < front[-1].error):
            front.append(row)
    return front


def verdict(result: Result, case: str) -> str:
    """Return a sentence on one case: if the default lies on the Pareto front, else the methods that dominate it."""
    rows = result.of_case(case)
    default = next((row for row in rows if row.role is Role.DEFAULT), None)
    if default is None:
        return "no method is the default here"
    if not np.isfinite(default.error):
        return f"{default.method} (default) FAILS here"
    better = [row for row in rows if row.cost_us < default.cost_us and row.error < default.error]
    if not better:
        return f"{default.method} (default) is on the front"
    names = ", ".join(
        f"{row.method} ({row.role.value}: {row.cost_us / default.cost_us:.2g} of its time, "
        f"{row.error / default.error:.2g} of its error)"
        for row in better
    )
    return f"{default.method} (default) is OFF the front: beaten on both axes by {names}"
