"""Starting times are measured in processes of their own, and written beside their goals."""

from __future__ import annotations

import csv
from pathlib import Path

from click.testing import CliRunner

from benchmarks.programs.start import STARTS, start


def test_each_checkout_is_started_and_its_times_are_tabulated(tmp_path: Path) -> None:
    here = Path(__file__).resolve().parents[2]
    arguments = ["--out", str(tmp_path), "--times", "1", "--only", "import", "--against", str(here)]
    result = CliRunner().invoke(start, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    with (tmp_path / "start.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["checkout"] for row in rows] == ["here", "against"]
    assert all(0 < float(row["median_s"]) < 60 and float(row["goal_s"]) == STARTS[0].goal_s for row in rows)
