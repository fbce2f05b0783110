"""Click commands as programs: exit codes, errors and warnings in one line, and signals that let devices be parked."""

from __future__ import annotations

import atexit
import gc
import sys
import warnings
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from napari_elsplus.closing import unwound_by_signals
from napari_elsplus.errors import ElsPlusError, error_message

if TYPE_CHECKING:
    from collections.abc import Iterator

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
"""Exit codes after bad input, as of click, and after Ctrl-C, as of a shell: 128 and the number of the signal."""


def run_program(command: click.Command, name: str, arguments: list[str] | None = None) -> None:
    """Run a click command as a program and exit: 0 on success, 2 and one line for bad input, 130 when interrupted.

    SIGTERM and SIGHUP end it as Ctrl-C does: devices are parked, unfinished files removed, undisturbed by more of them.
    A warning is one line, too.

    Parameters
    ----------
    command : click.Command
        The command or group.
    name : str
        Name of the program, the first word of an error line.
    arguments : list of str, optional
        The command line without the program's name; by default that of this process.

    Raises
    ------
    SystemExit
        Always on failure; on success only if the command exits itself.
    """
    atexit.register(gc.freeze)  # else the interpreter's last collection searches all that libraries hold: 0.1 s
    try:
        with unwound_by_signals(interrupts=True), _warnings_in_one_line(name):
            command.main(arguments, prog_name=name, standalone_mode=False)
    except (ElsPlusError, OSError) as error:
        _leave(f"{name}: {error_message(error)}", EXIT_BAD_INPUT)
    except click.ClickException as error:
        error.show()
        sys.exit(EXIT_BAD_INPUT)
    except (click.Abort, KeyboardInterrupt):
        _leave(f"{name}: interrupted", EXIT_INTERRUPTED)


@contextmanager
def _warnings_in_one_line(name: str) -> Iterator[None]:
    """Display warnings to the user as errors are; those to programmers stay as Python displays them."""
    before = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, UserWarning):
            click.echo(f"{name}: warning: {' '.join(str(message).split())}", err=True)
        else:
            before(message, category, *where, **more)

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = before


def _leave(line: str, code: int) -> None:
    click.echo(line, err=True)
    sys.exit(code)
