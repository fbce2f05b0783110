"""A recording is processed beside what the disk alone takes, and all files but the table are deleted."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.programs.process import process


def test_frames_memory_and_the_disks_pace_are_tabulated(tmp_path: Path) -> None:
    own = np.ones(1 << 27)  # 1 GB, which the command does not use
    result = CliRunner().invoke(
        process, ["--out", str(tmp_path), "--frames", "3", "--turns", "1"], catch_exceptions=False
    )
    assert result.exit_code == 0
    assert [path.name for path in tmp_path.iterdir()] == ["process.csv"]
    with (tmp_path / "process.csv").open(encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert float(row["frames"]) == 3
    assert float(row["frames_per_s"]) > 0
    assert float(row["of_the_disks_pace"]) == pytest.approx(
        float(row["disk_seconds"]) / float(row["seconds"]), rel=0.01
    )
    assert 50 < float(row["memory_mb"]) < 1000 < own.nbytes / 1e6
