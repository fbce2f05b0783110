"""Named methods on named cases: what each costs, how wrong it is, and whether it knows when it has failed.

Methods take turns on the same data in one run, so that a busy machine slows all of them alike; what is compiled or
tabulated once is prepared beforehand and kept apart from the cost.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum
from math import inf, nan
from time import get_clock_info, perf_counter, thread_time
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import cv2
import numpy as np

from napari_elsplus.errors import ElsPlusError
from napari_elsplus.evaluation.machine import machine

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence


_FINE_S: Final = 1e-6


class Role(StrEnum):
    """What a method is to the software."""

    DEFAULT = "default"
    """What is done unless something else is asked for."""
    OPTION = "option"
    """What the software can also do, or could have done."""
    PAPER = "paper"
    """As Thrapp and Hughes describe it."""
    PEER = "peer"
    """Another project's."""


class Claim(StrEnum):
    """What a method says of its own answer."""

    SURE = "sure"
    DOUBTFUL = "doubtful"
    REFUSED = "refused"


class Chart(StrEnum):
    """How the result is drawn."""

    PARETO = "cost against error"
    FAILURES = "failure map"
    PARSIMONY = "error against parameters"


class Absent(ElsPlusError):
    """A peer that is not installed here."""


class Judgement(NamedTuple):
    """One answer held against the truth."""

    error: float
    failed: bool = False
    claim: Claim = Claim.SURE
    details: Mapping[str, float] = {}


class TimedElsewhere(NamedTuple):
    """An answer from another process, which took its own time."""

    answer: Any
    seconds: float


@dataclass(frozen=True)
class Case:
    """Inputs that belong together: one scene, one level of stress.

    Parameters
    ----------
    name : str
        Its name.
    items : sequence
        One input for each call.
    level : float
        How strong the stress is, where the cases of a group are levels of one.
    group : str
        The stress.
    context : Any
        What a method may prepare itself with: calibration, flat field.
    calls : int
        Frames in each item: the cost is told for one of them.
    """

    name: str
    items: Sequence[Any]
    level: float = nan
    group: str = ""
    context: Any = None
    calls: int = 1


@dataclass(frozen=True)
class Method:
    """One way to do it.

    Parameters
    ----------
    name : str
        Its name.
    role : Role
        Default, option, the paper's, a peer's.
    prepare : callable
        Case to the function that is timed, which takes one item; raises `Absent` where it cannot be had.
    parameters : int, optional
        Number of parameters that it fits.
    """

    name: str
    role: Role
    prepare: Callable[[Case], Callable[[Any], Any]]
    parameters: int | None = None


@dataclass(frozen=True)
class Row:
    """One method on one case.

    Attributes
    ----------
    benchmark, method, case, group : str
        Names.
    role : Role
        What the method is to the software.
    level : float
        Of the stress; not-a-number where there is none.
    cost_us, cost_spread_us : float
        Median time of a call and half its interquartile range, microseconds.
    warm_up_ms : float
        Preparation and the first call: compilation, tables.
    error, error_p90 : float
        Median and 90 % quantile of the error; infinite errors are failures.
    items, failed, caught, flagged, silent, false_alarms : int
        Inputs; wrong answers; of these refused, doubted, and not noticed; right answers that were doubted or refused.
    parameters : int or None
        Number of parameters that the method fits.
    details : dict
        Further numbers, medians.
    """

    benchmark: str
    method: str
    role: Role
    case: str
    group: str
    level: float
    cost_us: float
    cost_spread_us: float
    warm_up_ms: float
    error: float
    error_p90: float
    items: int
    failed: int
    caught: int
    flagged: int
    silent: int
    false_alarms: int
    parameters: int | None
    details: dict[str, float]


@dataclass(frozen=True)
class Result:
    """What a benchmark found on this machine."""

    benchmark: Benchmark
    rows: tuple[Row, ...]
    absent: dict[str, str]
    machine: str

    @property
    def cases(self) -> list[str]:
        """Names of the cases, in order."""
        return list(dict.fromkeys(row.case for row in self.rows))

    def of_case(self, case: str) -> list[Row]:
        """Rows of one case."""
        return [row for row in self.rows if row.case == case]


@dataclass(frozen=True)
class Benchmark:
    """A choice that the software makes, with everything that it could have chosen.

    Parameters
    ----------
    name : str
        As ``bench`` knows it.
    question : str
        What is chosen, in one line.
    error_label : str
        What the error is, with its unit.
    cases : callable
        Whether it is to be quick, to the cases.
    methods : tuple of Method
        What is compared.
    judge : callable
        Item and answer to a judgement; it never sees which method answered.
    chart : Chart
        How it is drawn.
    remarks : str
        What the numbers do not say by themselves: why a default is off the front, what is not comparable.
    seconds : float
        Time for each method and case; the first round is always finished. Zero: costs are of no interest, and nothing
        is warmed up.
    waits : bool
        Whether methods wait, for a disk or another process: then the clock on the wall is read, else the processor
        time of the thread, which other programs on a shared machine disturb less.
    """

    name: str
    question: str
    error_label: str
    cases: Callable[[bool], Sequence[Case]]
    methods: tuple[Method, ...]
    judge: Callable[[Any, Any], Judgement]
    chart: Chart = Chart.PARETO
    remarks: str = ""
    seconds: float = 0.4
    waits: bool = False

    def run(self, *, quick: bool = False, tell: Callable[[str], None] = lambda _: None) -> Result:
        """Measure every method on every case.

        Parameters
        ----------
        quick : bool
            Small cases and a single round: whether it runs, not how fast.
        tell : callable
            Is told which case is being measured.
        """
        rows: list[Row] = []
        absent: dict[str, str] = {}
        threads = cv2.getNumThreads()
        clock = perf_counter if self.waits else thread_clock()
        cv2.setNumThreads(1)
        try:
            for case in self.cases(quick):
                tell(f"{self.name}: {case.name}")
                runners = []
                for method in self.methods:
                    if method.name in absent:
                        continue
                    try:
                        runners.append(_Runner(method, case, self.judge, clock, self.seconds > 0 and not quick))
                    except Absent as error:
                        absent[method.name] = str(error)
                _take_turns(runners, 0.0 if quick else self.seconds)
                rows += [runner.row(self.name) for runner in runners]
        finally:
            cv2.setNumThreads(threads)
        return Result(self, tuple(rows), absent, machine())


def _take_turns(runners: list[_Runner], seconds: float) -> None:
    """Let each method in turn do a round of all items, until all have had their time."""
    waiting = list(runners)
    while waiting:
        for runner in waiting:
            runner.round()
        waiting = [runner for runner in reversed(waiting) if runner.spent < seconds]


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
    spent: float = 0.0

    def __post_init__(self) -> None:
        start = perf_counter()
        self._call = self.method.prepare(self.case)
        if self.warms_up:
            self._timed(self.case.items[0])
        self.warm_up = perf_counter() - start

    def round(self) -> None:
        """Answer every item once; the answers of the first round are judged."""
        first = not self.judgements
        for item in self.case.items:
            answer, seconds = self._timed(item)
            self.seconds.append(seconds)
            self.spent += seconds
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
            warm_up_ms=1e3 * self.warm_up,
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


REFUSED = Judgement(inf, failed=True, claim=Claim.REFUSED)


def _median(values: Any) -> float:
    finite = [value for value in values if np.isfinite(value)]
    return float(np.median(finite)) if finite else nan


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
    """Say of one case whether the default lies on the Pareto front, and if not, what beats it on both axes."""
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
