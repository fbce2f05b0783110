"""Every benchmark runs in its small size, whatever this machine's speed, and its default finds the truth."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmarks.documents.benchmark import draw_benchmark
from benchmarks.harness.methods import Chart, Role
from benchmarks.harness.registry import MODULES, benchmark
from benchmarks.harness.running import run
from napari_elsplus.workflows.pictures.files import save_figure


@pytest.fixture(autouse=True)
def no_peers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A peer that happens to be installed here must not decide whether the tests pass."""
    monkeypatch.setenv("ELSPLUS_PEERS", str(tmp_path))


@pytest.mark.parametrize("name", MODULES)
def test_a_small_run_gives_every_default_a_finite_error(name: str, tmp_path: Path) -> None:
    if name == "display" and not (shutil.which("xvfb-run") or os.environ.get("DISPLAY")):
        pytest.skip("no screen")
    chosen = benchmark(name)
    assert chosen.name == name
    result = run(chosen, quick=True)
    defaults = [row for row in result.rows if row.role is Role.DEFAULT]
    assert defaults, f"no row of the default: {result.absent}"
    if chosen.chart is not Chart.FAILURES:
        assert all(np.isfinite(row.error) for row in defaults)
    assert all("PyFibreBundle" in name for name in result.absent), result.absent
    save_figure(draw_benchmark(result), tmp_path / "chart.png")
    assert (tmp_path / "chart.png").stat().st_size > 5000


def test_the_default_registration_is_nearer_than_whole_pixels() -> None:
    rows = {row.method: row for row in run(benchmark("registration"), quick=True).rows}
    assert rows["link, predicted"].error < 0.1 < rows["template"].error
