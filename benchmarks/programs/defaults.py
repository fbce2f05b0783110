"""The defaults of every choice, for asv to watch: cost and error of each, on the benchmarks' own small cases.

Run with asv; all methods are compared by ``python3 run.py bench NAME --out DIR``.
"""

from __future__ import annotations

from benchmarks.harness.methods import Role, TimedElsewhere
from benchmarks.harness.registry import benchmark


class Defaults:
    """One case of each benchmark, answered by what the software does unless told otherwise."""

    params = (
        "line",
        "pair",
        "cores",
        "sectioning",
        "frontend",
        "registration",
        "tracking",
        "insertion",
        "live",
        "recording",
    )
    param_names = ("benchmark",)
    timeout = 120

    def setup(self, name: str) -> None:
        """Prepare the default of a benchmark."""
        self.benchmark = benchmark(name)
        self.case = self.benchmark.cases(True)[0]
        method = next(m for m in self.benchmark.methods if m.role is Role.DEFAULT)
        self.call = method.prepare(self.case)
        self.call(self.case.items[0])

    def time_default(self, name: str) -> None:
        """Answer one item."""
        self.call(self.case.items[0])

    def track_error(self, name: str) -> float:
        """Return the error of the answer."""
        answer = self.call(self.case.items[0])
        if isinstance(answer, TimedElsewhere):
            answer = answer.answer
        return self.benchmark.judge(self.case.items[0], answer).error
