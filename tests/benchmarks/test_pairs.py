from __future__ import annotations

import numpy as np
import pytest

from benchmarks.choices.registration import METHODS
from benchmarks.stability.pairs import cases, statistics

SEARCHED = next(method for method in METHODS if method.name == "link, searched")
TEMPLATE = next(method for method in METHODS if method.name == "template")


def test_shifts_fill_their_range() -> None:
    for case in cases(quick=True):
        moved = np.array([np.hypot(*pair.moved) for pair in case.items]) / case.context.diameter
        assert ((100 * moved <= case.level) & (100 * moved >= case.level - 20)).all()


def test_few_pairs_tell_a_search_from_a_template() -> None:
    few = cases(quick=True)
    assert statistics(SEARCHED, few).failed_percent == 0
    template = statistics(TEMPLATE, few)
    assert template.failed_percent == template.silent_percent > 10


@pytest.mark.slow
def test_a_thousand_pairs() -> None:
    """Shifts up to 60 % of the disc in dim light: failures below 1 %, error of textured scenes at most 0.05 px."""
    every = cases(quick=False, count=1000)
    assert sum(len(case.items) for case in every) >= 1000
    assert statistics(SEARCHED, every).failed_percent < 1
    for scene in ("fibres", "nuclei"):
        assert statistics(SEARCHED, [case for case in every if case.group == scene]).rms_px <= 0.05
