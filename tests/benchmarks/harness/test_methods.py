from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from time import thread_time

import numpy as np
import pytest

from benchmarks.documents.benchmark import draw_benchmark
from benchmarks.harness.methods import (
    Absent,
    Benchmark,
    Case,
    Claim,
    Judgement,
    Method,
    Role,
    TimedElsewhere,
)
from benchmarks.harness.running import run
from benchmarks.harness.table import header, lines, markdown, write_csv
from benchmarks.harness.verdict import verdict
from napari_elsplus.errors import MeasurementError


def calling(function: Callable[[float], object]) -> Callable[[Case], Callable[[float], object]]:
    return lambda _: function


def absent(_: Case) -> Callable[[float], object]:
    raise Absent("Foreign is not installed", "install it")


def refusing(item: float) -> float:
    if item > 2:
        raise MeasurementError(f"{item} is too much", "give less")
    return item


def slowly(seconds: float, answer: Callable[[float], object]) -> Callable[[float], object]:
    def call(item: float) -> object:
        stop = thread_time() + seconds
        while thread_time() < stop:
            pass
        return answer(item)

    return call


def judge(item: float, answer: tuple[float, Claim] | float) -> Judgement:
    value, claim = answer if isinstance(answer, tuple) else (answer, Claim.SURE)
    error = abs(value - item)
    return Judgement(error, failed=error > 0.5, claim=claim, details={"answer": value})


METHODS = (
    Method("exact", Role.DEFAULT, calling(slowly(2e-3, lambda item: item))),
    Method("off by one", Role.OPTION, calling(lambda item: item + 1)),
    Method("doubts itself", Role.OPTION, calling(lambda item: (item + (item > 2), Claim.DOUBTFUL))),
    Method("refuses", Role.PAPER, calling(refusing)),
    Method("Foreign", Role.PEER, absent),
    Method("elsewhere", Role.PEER, calling(lambda item: TimedElsewhere(item, 7.0))),
)


def bench(*methods: Method) -> Benchmark:
    cases = [Case("numbers", [0.0, 1.0, 2.0, 3.0])]
    return Benchmark("numbers", "Which number it is", "error", lambda _: cases, methods or METHODS, judge)


@pytest.fixture(scope="module")
def result():
    return run(bench(), quick=True)


def row(result, method):
    return next(row for row in result.rows if row.method == method)


def test_failures_are_caught_flagged_or_silent(result) -> None:
    told = {name: row(result, name) for name in ("exact", "off by one", "doubts itself", "refuses")}
    counts = {name: (r.failed, r.caught, r.flagged, r.silent, r.false_alarms) for name, r in told.items()}
    assert counts == {
        "exact": (0, 0, 0, 0, 0),
        "off by one": (4, 0, 0, 4, 0),
        "doubts itself": (1, 0, 1, 0, 3),
        "refuses": (1, 1, 0, 0, 0),
    }


def test_a_refusal_is_an_infinite_error_and_not_left_out(result) -> None:
    assert row(result, "refuses").error == 0
    assert row(result, "refuses").error_p90 == 0
    never = run(bench(Method("never", Role.DEFAULT, calling(lambda item: refusing(item + 3)))), quick=True)
    assert never.rows[0].error == np.inf
    assert verdict(never, "numbers") == "never (default) FAILS here"


def test_what_is_not_installed_is_told(result) -> None:
    assert result.absent == {"Foreign": "Foreign is not installed: install it"}
    assert "Foreign" not in {r.method for r in result.rows}
    assert "Absent: Foreign" in markdown(result)


def test_another_process_tells_its_own_time(result) -> None:
    assert row(result, "elsewhere").cost_us == pytest.approx(7e6)


def test_cost_is_the_time_of_a_call(result) -> None:
    assert row(result, "exact").cost_us >= 2000
    assert row(result, "exact").cost_us > row(result, "off by one").cost_us


def test_methods_take_turns_until_each_has_had_its_time() -> None:
    calls: list[str] = []
    methods = [
        Method(name, Role.OPTION, calling(slowly(2e-3, lambda item, name=name: calls.append(name) or item)))
        for name in "ab"
    ]
    one = Benchmark("turns", "Whose turn", "error", lambda _: [Case("one", [0.0])], tuple(methods), judge, seconds=0.02)
    run(one)
    assert calls[:4] == ["a", "b", "a", "b"]  # warm-up of each, then the first round
    assert all(4 < calls.count(name) <= 1 + 20 // 2 for name in "ab")  # 20 ms at 2 ms a call, after the warm-up


def test_a_default_that_is_beaten_on_both_axes_is_told() -> None:
    slow = Method("slow and wrong", Role.DEFAULT, calling(slowly(1e-3, lambda item: item + 0.2)))
    quick = Method("quick and right", Role.PEER, calling(lambda item: item + 0.1))
    said = verdict(run(bench(slow, quick), quick=True), "numbers")
    assert "slow and wrong (default) is OFF the front" in said
    assert "quick and right (peer" in said


def test_the_table_and_the_file_hold_every_row(result, tmp_path: Path) -> None:
    write_csv(result, tmp_path / "numbers.csv")
    with (tmp_path / "numbers.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [r["method"] for r in rows] == [r.method for r in result.rows]
    assert [r["method"] for r in rows if r["is_default"] == "1"] == ["exact"]
    assert [r["method"] for r in rows if r["is_peer"] == "1"] == ["elsewhere"]
    assert {len(line) for line in lines(result)} == {len(header(result))}


def test_the_chart_shows_every_method_that_answered(result) -> None:
    axes = draw_benchmark(result).axes[0]
    shown = " ".join(text.get_text() for text in axes.texts)
    assert all(r.method in shown for r in result.rows)
