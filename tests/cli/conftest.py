"""The command line, run in this process."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import pytest

from napari_elsplus.cli import main


class Run(NamedTuple):
    """How a command ended and what it said."""

    code: int
    out: str
    err: str


@pytest.fixture
def elsplus(capsys: pytest.CaptureFixture[str]) -> Callable[..., Run]:
    """Run ``napari-elsplus`` with arguments of any type and return how it ended."""

    def run(*arguments: object) -> Run:
        code: object = 0
        try:
            main([str(argument) for argument in arguments])
        except SystemExit as leave:
            code = leave.code or 0
        assert isinstance(code, int)
        out, err = capsys.readouterr()
        return Run(code, out, err)

    return run
