"""Records of a benchmark: methods, cases, and for each pair cost, error, and detected and silent failures.

:func:`benchmarks.harness.running.run` measures them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from math import nan
from typing import Any, NamedTuple

from napari_elsplus.errors import ElsPlusError


class Role(StrEnum):
    """Role of a method in the software."""

    DEFAULT = "default"
    """The default."""
    OPTION = "option"
    """An option of the software, or an alternative."""
    PAPER = "paper"
    """As Thrapp and Hughes describe it."""
    PEER = "peer"
    """Another project's."""


class Claim(StrEnum):
    """Confidence that a method reports with its result."""

    SURE = "sure"
    DOUBTFUL = "doubtful"
    REFUSED = "refused"


class Chart(StrEnum):
    """Type of chart."""

    PARETO = "cost against error"
    FAILURES = "failure map"
    PARSIMONY = "error against parameters"
    STAGES = "time of each stage"
    LATENCY = "how many frames are later than that"
    LEVELS = "against a level"


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
    """Result of a benchmark on this machine."""

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


def plain(answer: Callable[[Any], Any]) -> Callable[[Case], Callable[[Any], Any]]:
    """Return the preparation of a method that needs none."""
    return lambda _: answer


Stresses = Mapping[str, tuple[Sequence[float], Callable[[float], Case]]]
"""Name of each stress, with its unit, to its levels and what makes the case of a level."""


def stressed(stresses: Stresses, *, worst: int | None = None) -> list[Case]:
    """Make a case for each level of each stress, named and grouped after it.

    Parameters
    ----------
    stresses : mapping
        What there is; levels grow worse.
    worst : int, optional
        Only so many of the last levels of each.

    Examples
    --------
    >>> made = stressed({"electrons": ((300, 3), lambda level: Case("", [level]))}, worst=1)
    >>> [(case.name, case.level, case.items) for case in made]
    [('electrons: 3', 3, [3])]
    """
    return [
        replace(make(level), name=f"{group}: {level:g}", level=level, group=group)
        for group, (levels, make) in stresses.items()
        for level in (levels if worst is None else levels[-worst:])
    ]


def named(methods: Sequence[Method], names: Sequence[str]) -> tuple[Method, ...]:
    """Return the methods of these names, in their order.

    Raises
    ------
    KeyError
        If there is none of such a name.
    """
    known = {method.name: method for method in methods}
    return tuple(known[name] for name in names)
