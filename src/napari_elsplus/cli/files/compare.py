"""``compare``: LS, ELSA and ELS+ images of one frame side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from napari_elsplus.cli.options import (
    FILE,
    ReadingCommand,
    calibration_of,
    calibration_option,
    files_read,
    force_option,
    output_option,
    refuse_outputs,
)

if TYPE_CHECKING:
    from pathlib import Path


@click.command(cls=ReadingCommand)
@click.argument("raw", type=FILE)
@calibration_option
@click.option("--frame", default=0, show_default=True, help="Index of the raw frame; ELSA also takes the next.")
@output_option
@force_option
def command(raw: Path, calibration: Path | None, frame: int, output: Path, force: bool) -> None:
    """Draw LS, ELSA and ELS+ of one frame of RAW with a line profile, scaled as in the paper."""
    from napari_elsplus.io import open_recording
    from napari_elsplus.processing.images.modes import COMPARED_MODES
    from napari_elsplus.workflows.comparison import compare
    from napari_elsplus.workflows.pictures.files import refuse_format

    refuse_outputs(output, force=force, inputs=files_read(raw, calibration))
    refuse_format(output)
    with open_recording(raw) as recording:
        comparison = compare(recording, calibration_of(recording, calibration), frame)
    comparison.save(output, force=force)
    for mode in COMPARED_MODES:
        levels = comparison.contrast(mode)
        click.echo(f"{mode.label:5} contrast {levels.michelson:.3f}, background {levels.background:.3f} of white")
