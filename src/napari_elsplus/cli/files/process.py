"""``process``: raw frames to LS, residual, ELS+ or ELSA images."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from napari_elsplus.cli.options import (
    FILE,
    IMAGE_TYPE,
    LazyChoice,
    ReadingCommand,
    calibration_of,
    calibration_option,
    files_read,
    force_option,
    output_option,
    progress,
    refuse_outputs,
)

if TYPE_CHECKING:
    from pathlib import Path


@click.command(cls=ReadingCommand)
@click.argument("raw", type=FILE)
@calibration_option
@click.option(
    "--mode",
    type=IMAGE_TYPE,
    default="els",
    show_default=True,
    help="Image type: confocal (ls), aligned residual, their difference in one frame (els) or in two (elsa).",
)
@click.option(
    "--cores",
    type=LazyChoice("napari_elsplus.processing.images.cores:CoreFilter"),
    default="none",
    show_default=True,
    help="Suppression of the core pattern.",
)
@click.option("--flat-field", is_flag=True, help="Divide by the calibration's flat field.")
@click.option(
    "--row-reference/--no-row-reference",
    default=True,
    show_default=True,
    help="Take the camera's row noise off frames whose dark pixels, beside the bundle, show it.",
)
@click.option(
    "--row-power",
    is_flag=True,
    help="Divide rows by the laser's power where it differs from row to row, as both views show it.",
)
@output_option
@force_option
def command(raw: Path, calibration: Path | None, output: Path, force: bool, **options: Any) -> None:
    """Section the raw frames of RAW: float32 grey levels, signed, written as OME-TIFF or OME-Zarr (T, n, n)."""
    from napari_elsplus.io import open_recording
    from napari_elsplus.io.formats.registry import format_to_write
    from napari_elsplus.workflows.sectioning import section

    refuse_outputs(output, force=force, inputs=files_read(raw, calibration))
    format_to_write(output)
    with open_recording(raw) as recording:
        images = section(recording, calibration_of(recording, calibration), **options)
        images.save(output, force=force, progress=progress)
    click.echo(f"{output}: {len(images)} {images.mode.value} images of {images.side} x {images.side} px")
