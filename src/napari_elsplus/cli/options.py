"""Options that several commands share, and the progress bar of all of them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click
from rich.console import Console
from rich.progress import track

if TYPE_CHECKING:
    from collections.abc import Iterable

    Item = TypeVar("Item")

FILE = click.Path(path_type=Path)

calibration_option = click.option(
    "-c", "--calibration", type=FILE, required=True, help="The rig's calibration, as `calibrate` writes it."
)
output_option = click.option("-o", "--output", type=FILE, required=True, help="File to write.")
force_option = click.option("--force", is_flag=True, help="Overwrite an existing output file.")


def progress(items: Iterable[Item], *, describe: str, total: float | None = None) -> Iterable[Item]:
    """Go through items with a progress bar on standard error; silent where that is no terminal."""
    console = Console(stderr=True)
    return track(
        items, description=describe, total=total, console=console, transient=True, disable=not console.is_terminal
    )
