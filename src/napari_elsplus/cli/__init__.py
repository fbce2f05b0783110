"""The command line: a module per command, each a thin layer over one public function.

A command's module is imported when the command is run, so that ``napari-elsplus --help`` takes a tenth of a second; and
what computes is imported when the command is executed, so that a wrong option is refused as soon.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

import click

from napari_elsplus import __version__
from napari_elsplus._program import run_program
from napari_elsplus.errors import InputError
from napari_elsplus.processing.compilation import reported_compilation


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
    """Run the command line with these arguments and exit; see :func:`~napari_elsplus._program.run_program`."""
    run_program(elsplus, "napari-elsplus", arguments)
