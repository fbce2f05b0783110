"""Commands run in this process."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import click
import pytest

from napari_elsplus._program import run_program


class Run(NamedTuple):
    """How a command ended and what it printed."""

    code: int
    out: str
    err: str


def runner(command: click.Command, name: str, capsys: pytest.CaptureFixture[str]) -> Callable[..., Run]:
    """Return a function that runs the command with arguments of any type and returns how it ended."""

    def run(*arguments: object) -> Run:
        code: object = 0
        try:
            run_program(command, name, [str(argument) for argument in arguments])
        except SystemExit as leave:
            code = leave.code or 0
        assert isinstance(code, int)
        out, err = capsys.readouterr()
        return Run(code, out, err)

    return run
