"""The command line: a module per command, each a thin layer over one public function.

A command's module is imported when the command is run, so that ``napari-elsplus --help`` takes a tenth of a second; and
what computes is imported when the command is executed, so that a wrong option is refused as soon.
"""

from __future__ import annotations

import atexit
import gc
import sys
import warnings
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from napari_elsplus import __version__
from napari_elsplus.closing import unwound_by_signals
from napari_elsplus.errors import ElsPlusError, InputError, error_message
from napari_elsplus.processing.compilation import reported_compilation

if TYPE_CHECKING:
    from collections.abc import Iterator


class _Listed(NamedTuple):
    """A command: the folder below this one that has its module, which defines ``command``, and one line on it."""

    folder: str
    summary: str


COMMANDS: dict[str, _Listed] = {
    "demo": _Listed("files", "Calibrate, acquire, section and mosaic with the simulated rig."),
    "acquire": _Listed("rig", "Run a rig without a window."),
    "calibrate": _Listed("rig", "Measure slit offset, galvo map and view alignment."),
    "process": _Listed("files", "LS, residual, ELS+ or ELSA images of raw frames."),
    "mosaic": _Listed("files", "Track the probe and insert its images into a mosaic."),
    "batch": _Listed("files", "Sectioned images and mosaics of many recordings."),
    "compare": _Listed("files", "LS, ELSA and ELS+ of one frame side by side."),
    "axial": _Listed("files", "Axial response from a scan of depths."),
    "recommend": _Listed("files", "Slit and offset for haze at a depth."),
    "simulate": _Listed("files", "Simulate raw frames with known truth."),
    "rehearse": _Listed("rig", "Rehearse faults on the simulated rig."),
    "doctor": _Listed("rig", "Check software and devices."),
}
"""The commands by name, that of their module; listed here, so that ``--help`` imports none of them."""
MOVED: dict[str, str] = {"bench": "run `python3 run.py bench` in a checkout of the project"}
"""Commands of earlier versions, and their replacements."""

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
"""Exit codes after bad input, as of click, and after Ctrl-C, as of a shell: 128 and the number of the signal."""


class _CommandPerModule(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in MOVED:
            raise InputError(f"the command {cmd_name} is not in the package any more", MOVED[cmd_name])
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = import_module(f"{__name__}.{COMMANDS[cmd_name].folder}.{cmd_name}").command
        command.short_help = COMMANDS[cmd_name].summary
        return command

    def invoke(self, ctx: click.Context) -> Any:
        with reported_compilation(_display_compilation):
            return super().invoke(ctx)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, listed.summary) for name, listed in COMMANDS.items()])


@click.group(
    cls=_CommandPerModule, invoke_without_command=True, context_settings={"help_option_names": ["-h", "--help"]}
)
@click.version_option(__version__)
@click.pass_context
def elsplus(ctx: click.Context) -> None:
    """Enhanced line-scan (ELS+) fibre-bundle endomicroscopy. Without a command: open napari with the plugin."""
    if ctx.invoked_subcommand is None:
        import_module("napari_elsplus.cli.rig.window").open_window()


def _display_compilation(kernel: str) -> None:
    from napari_elsplus.cli.options import display  # not for `--help`

    display().compiling(kernel)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line with these arguments and exit; see :func:`run_program`."""
    run_program(elsplus, "napari-elsplus", arguments)


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
