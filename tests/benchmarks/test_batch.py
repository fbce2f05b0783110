"""A batch that is killed and resumed ends with the files of single runs; files that differ are found."""

from __future__ import annotations

import csv
import os
from typing import TYPE_CHECKING

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from benchmarks.programs.batch import batch, differences

if TYPE_CHECKING:
    from pathlib import Path

needs_process_groups = pytest.mark.skipif(not hasattr(os, "killpg"), reason="kills a group of processes")


@pytest.mark.slow
@needs_process_groups
def test_a_killed_batch_ends_as_single_runs_do(tmp_path: Path) -> None:
    words = ["--out", str(tmp_path), "--recordings", "4", "--frames", "20", "--kills", "2", "--rounds", "1"]
    done = CliRunner().invoke(batch, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert "8 of 8 stages finished" in done.output
    assert "0 of 12 files differ from single runs" in done.output
    rows = list(csv.DictReader((tmp_path / "batch.csv").read_text(encoding="utf-8").splitlines()))
    assert [(row["run"], row["workers"]) for row in rows] == [
        ("killed", "2"), ("killed", "2"), ("resumed", "2"), ("batch", "1"), ("batch", "2"),
    ]  # fmt: skip
    assert all(float(row["peak_mb"]) > 50 for row in rows)


def test_files_that_differ_are_named(tmp_path: Path) -> None:
    folders = batched, single = [tmp_path / kind / "a" for kind in ("batch", "single")]
    for folder in folders:
        folder.mkdir(parents=True)
        for name in ("els.ome.tif", "mosaic.ome.tif"):
            tifffile.imwrite(folder / name, np.ones((4, 4), np.float32))
        (folder / "track.csv").write_text("frame\n0\n")
    assert differences(batched, single) == []
    tifffile.imwrite(batched / "els.ome.tif", np.full((4, 4), 1.0 + 1e-6, np.float32))
    (batched / "track.csv").write_text("frame\n1\n")
    assert differences(batched, single) == ["a/els.ome.tif", "a/track.csv"]
