"""The door without a screen: a module per command, each a thin layer over one public function.

A command's module is imported when the command is run or described, so that ``napari-elsplus doctor`` answers at once.
"""

from __future__ import annotations

import sys
from importlib import import_module

import click

from napari_elsplus import __version__
from napari_elsplus.errors import ElsPlusError, explained

COMMANDS: tuple[str, ...] = (
    "demo",
    "acquire",
    "calibrate",
    "process",
    "mosaic",
    "compare",
    "axial",
    "simulate",
    "bench",
    "doctor",
)
"""Names of the commands; each is the ``command`` of the module of that name in this package."""

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


class _CommandPerModule(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = import_module(f"napari_elsplus.cli.{cmd_name}").command
        return command


@click.group(
    cls=_CommandPerModule, invoke_without_command=True, context_settings={"help_option_names": ["-h", "--help"]}
)
@click.version_option(__version__)
@click.pass_context
def elsplus(ctx: click.Context) -> None:
    """Enhanced line-scan (ELS+) fibre-bundle endomicroscopy. Without a command: open napari with the plugin."""
    if ctx.invoked_subcommand is None:
        import_module("napari_elsplus.cli.rig.window").open_window()


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit: 0 on success, 2 and one line for bad input, 130 when interrupted."""
    try:
        elsplus.main(arguments, prog_name="napari-elsplus", standalone_mode=False)
    except (ElsPlusError, OSError) as error:
        _leave(explained(error), EXIT_BAD_INPUT)
    except click.ClickException as error:
        error.show()
        sys.exit(EXIT_BAD_INPUT)
    except (click.Abort, KeyboardInterrupt):
        _leave("interrupted", EXIT_INTERRUPTED)


def _leave(line: str, code: int) -> None:
    click.echo(f"napari-elsplus: {line}", err=True)
    sys.exit(code)
