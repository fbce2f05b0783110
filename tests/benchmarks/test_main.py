from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from benchmarks.__main__ import PAGE_PROGRAMS, PAGES
from benchmarks.harness.registry import MODULES, PROGRAMS


def test_the_list_names_every_benchmark_and_its_question(bench_program) -> None:
    run = bench_program("list")
    lines = run.out.splitlines()
    assert run.code == 0
    assert [line.split()[0] for line in lines] == [*MODULES, "paper", "imperfect"]
    assert all(len(line.split()) > 3 for line in lines)


def test_a_benchmark_writes_table_and_chart_and_tells_of_its_default(bench_program, tmp_path: Path) -> None:
    run = bench_program("line", "--out", tmp_path / "new", "--quick")
    assert run.code == 0
    with (tmp_path / "new" / "line.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert sum(row["is_default"] == "1" for row in rows) == 1
    assert all(float(row["cost_us"]) > 0 for row in rows)
    assert (tmp_path / "new" / "line.png").read_bytes().startswith(b"\x89PNG")
    assert "(default) is " in run.out
    assert sorted(p.name for p in (tmp_path / "new").iterdir()) == ["line.csv", "line.png"]


def test_results_are_not_overwritten_unless_told(bench_program, tmp_path: Path) -> None:
    (tmp_path / "line.csv").write_text("mine")
    run = bench_program("line", "--out", tmp_path, "--quick")
    assert (run.code, run.err.count("\n")) == (2, 1)
    assert "--force" in run.err
    assert (tmp_path / "line.csv").read_text() == "mine"
    assert bench_program("line", "--out", tmp_path, "--quick", "--force").code == 0


def test_an_unknown_benchmark_is_bad_input(bench_program) -> None:
    assert bench_program("everything", "--out", "x").code == 2


def test_pages_are_filled_between_their_marks(bench_program, tmp_path: Path) -> None:
    for page in PAGES:
        (tmp_path / page).write_text(f"Mine in {page}.\n\n<!-- line -->\nold\n<!-- end -->\n")
    assert bench_program("docs", "--docs", tmp_path, "--quick", "--only", "line").code == 0
    text = (tmp_path / "performance.md").read_text()
    assert text.startswith("Mine in performance.md.")
    assert "| tilted Gaussian, all columns | default |" in text
    assert "old" not in text
    assert (tmp_path / "images" / "bench-line.png").exists()


def test_a_page_that_is_not_there_is_bad_input(bench_program, tmp_path: Path) -> None:
    run = bench_program("docs", "--docs", tmp_path, "--quick", "--only", "line", "--only", "weather")
    assert (run.code, run.err.count("\n")) == (2, 1)
    assert all(name in run.err for name in (*MODULES, *PAGE_PROGRAMS))
    for name in ("calibration", "recommendation", "physics", "subtraction", "mosaicing", "mosaicing-acceptance"):
        run = bench_program("docs", "--docs", tmp_path, "--quick", "--only", name)
        assert (run.code, run.err.count("\n")) == (2, 1), name
        assert "there is no" in run.err


def test_the_package_is_drawn(bench_program, tmp_path: Path) -> None:
    assert bench_program("docs", "--docs", tmp_path, "--only", "architecture").code == 0
    assert (tmp_path / "images" / "architecture.png").read_bytes().startswith(b"\x89PNG")


def test_every_program_is_a_command(bench_program) -> None:
    for name in PROGRAMS:
        run = bench_program(name, "--help")
        assert run.code == 0
        assert run.out.startswith(f"Usage: run.py bench {name} "), name


def test_the_mosaic_of_a_finished_stack_is_drawn(bench_program, tmp_path: Path) -> None:
    scene = np.random.default_rng(0).integers(0, 255, (15, 15)).astype(np.uint8).repeat(8, 0).repeat(8, 1)
    np.save(tmp_path / "stack.npy", np.stack([scene[k : k + 96, 2 * k : 2 * k + 96] for k in range(3)]))
    picture = tmp_path / "mosaic.png"
    assert bench_program("finished", tmp_path / "stack.npy", "--out", picture).code == 0
    assert picture.stat().st_size > 10_000
    assert bench_program("finished", tmp_path / "stack.npy", "--out", picture).code == 2


@pytest.mark.checkout
def test_every_benchmark_has_its_place_in_the_documentation() -> None:
    docs = Path(__file__).resolve().parents[2] / "docs"
    text = "".join((docs / page).read_text(encoding="utf-8") for page in PAGES)
    for name in MODULES:
        assert text.count(f"<!-- {name} -->") == 1, name
        assert f"images/bench-{name}.png" in text, name
