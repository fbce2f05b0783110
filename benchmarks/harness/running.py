"""Methods take turns on the same data in one run, so that a busy machine slows all of them alike.

What is compiled or tabulated once is prepared beforehand and kept apart from the cost.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from math import inf, nan
from time import get_clock_info, perf_counter, thread_time
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from benchmarks.harness.machine import machine
from benchmarks.harness.methods import Absent, Claim, Judgement, Result, Row, TimedElsewhere
from napari_elsplus.errors import ElsPlusError

if TYPE_CHECKING:
    from collections.abc import Callable

    from benchmarks.harness.methods import Benchmark, Case, Method

_FINE_S: Final = 1e-6
REFUSED: Final = Judgement(inf, failed=True, claim=Claim.REFUSED)


def run(benchmark: Benchmark, *, quick: bool = False, report: Callable[[str], None] = lambda _: None) -> Result:
    """Measure every method on every case.

    Parameters
    ----------
    benchmark : Benchmark
        What is compared.
    quick : bool
        Small cases and a single round: whether it runs, not how fast.
    report : callable
        Called with the name of the case in progress.
    """
    rows: list[Row] = []
    absent: dict[str, str] = {}
    threads = cv2.getNumThreads()
    clock = perf_counter if benchmark.waits else thread_clock()
    cv2.setNumThreads(1)
    try:
        for case in benchmark.cases(quick):
            report(f"{benchmark.name}: {case.name}")
            runners = []
            for method in benchmark.methods:
                if method.name in absent:
                    continue
                try:
                    runners.append(_Runner(method, case, benchmark.judge, clock, benchmark.seconds > 0 and not quick))
                except Absent as error:
                    absent[method.name] = str(error)
            _take_turns(runners, 0.0 if quick else benchmark.seconds)
            rows += [runner.row(benchmark.name) for runner in runners]
    finally:
        cv2.setNumThreads(threads)
    return Result(benchmark, tuple(rows), absent, machine())


def _take_turns(runners: list[_Runner], seconds: float) -> None:
    """Let each method in turn do a round of all items, until all have had their time."""
    waiting = list(runners)
    while waiting:
        for runner in waiting:
            runner.round()
        waiting = [runner for runner in reversed(waiting) if runner.spent_s < seconds]


@dataclass
class _Runner:
    """One method at work on one case."""

    method: Method
    case: Case
    judge: Callable[[Any, Any], Judgement]
    clock: Callable[[], float]
    warms_up: bool
    seconds: list[float] = field(default_factory=list)
    judgements: list[Judgement] = field(default_factory=list)
    spent_s: float = 0.0

    def __post_init__(self) -> None:
        start = perf_counter()
        self._call = self.method.prepare(self.case)
        if self.warms_up:
            self._timed(self.case.items[0])
        self.warm_up_s = perf_counter() - start

    def round(self) -> None:
        """Answer every item once; the answers of the first round are judged."""
        first = not self.judgements
        for item in self.case.items:
            answer, seconds = self._timed(item)
            self.seconds.append(seconds)
            self.spent_s += seconds
            if first:
                self.judgements.append(REFUSED if isinstance(answer, ElsPlusError) else self.judge(item, answer))

    def _timed(self, item: Any) -> tuple[Any, float]:
        start = self.clock()
        try:
            answer = self._call(item)
        except Absent:
            raise
        except ElsPlusError as error:
            answer = error
        seconds = self.clock() - start
        return tuple(answer) if isinstance(answer, TimedElsewhere) else (answer, seconds)

    def row(self, benchmark: str) -> Row:
        """Summarise."""
        error = np.array([j.error if np.isfinite(j.error) else inf for j in self.judgements])
        low, middle, high = np.percentile(np.array(self.seconds) * 1e6 / self.case.calls, (25, 50, 75))
        wrong = Counter(j.claim for j in self.judgements if j.failed)
        names = dict.fromkeys(name for j in self.judgements for name in j.details)
        return Row(
            benchmark=benchmark,
            method=self.method.name,
            role=self.method.role,
            case=self.case.name,
            group=self.case.group,
            level=self.case.level,
            cost_us=float(middle),
            cost_spread_us=float(high - low) / 2,
            warm_up_ms=1e3 * self.warm_up_s,
            error=float(np.quantile(error, 0.5, method="lower")),
            error_p90=float(np.quantile(error, 0.9, method="lower")),
            items=len(self.judgements),
            failed=sum(wrong.values()),
            caught=wrong[Claim.REFUSED],
            flagged=wrong[Claim.DOUBTFUL],
            silent=wrong[Claim.SURE],
            false_alarms=sum(not j.failed and j.claim is not Claim.SURE for j in self.judgements),
            parameters=self.method.parameters,
            details={name: _median(j.details.get(name, nan) for j in self.judgements) for name in names},
        )


def thread_clock() -> Callable[[], float]:
    """Return the clock of this thread's processor time, or of the wall where the system counts that too coarsely."""
    fine = get_clock_info("thread_time").resolution < _FINE_S
    return thread_time if fine else perf_counter


def _median(values: Any) -> float:
    finite = [value for value in values if np.isfinite(value)]
    return float(np.median(finite)) if finite else nan
