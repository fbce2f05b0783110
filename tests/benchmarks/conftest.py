"""The benchmarks, which a checkout has and an installed package has not."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest

from commands import Run, runner

collect_ignore_glob = [] if find_spec("benchmarks") else ["test_*.py", "*/test_*.py"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.checkout)


@pytest.fixture
def bench_program(capsys: pytest.CaptureFixture[str]) -> Callable[..., Run]:
    """Run the benchmarks' command line with arguments of any type and return how it ended."""
    from benchmarks.__main__ import bench

    return runner(bench, "run.py bench", capsys)
