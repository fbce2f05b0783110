"""``process``: raw frames to LS, residual, ELS+ or ELSA images.

What computes is imported when the command is executed, so that a wrong option is refused at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from napari_elsplus.cli.options import (
    FILE,
    LazyChoice,
    calibration_option,
    force_option,
    output_option,
    progress,
    refuse_outputs,
)
from napari_elsplus.io import open_recording, read_calibration
from napari_elsplus.io.formats.registry import format_to_write, supported_recordings

if TYPE_CHECKING:
    from pathlib import Path


def _modes() -> list[str]:
    from napari_elsplus.processing.images.modes import Mode

    return [mode.value for mode in Mode]


def _core_filters() -> list[str]:
    from napari_elsplus.processing.images.cores import CoreFilter

    return [kind.value for kind in CoreFilter]


@click.command(
    epilog=f"RAW is one of: {supported_recordings()}.",
)
@click.argument("raw", type=FILE)
@calibration_option
@click.option(
    "--mode",
    type=LazyChoice(_modes),
    default="els",
    show_default=True,
    help="Image type: confocal (ls), aligned residual, their difference in one frame (els) or in two (elsa).",
)
@click.option(
    "--cores",
    type=LazyChoice(_core_filters),
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
def command(
    raw: Path,
    calibration: Path,
    mode: str,
    cores: str,
    flat_field: bool,
    row_reference: bool,
    row_power: bool,
    output: Path,
    force: bool,
) -> None:
    """Section the raw frames of RAW: float32 grey levels, signed, written as OME-TIFF or OME-Zarr (T, n, n)."""
    from napari_elsplus.workflows.sectioning import section

    refuse_outputs(output, force=force, inputs=(raw, calibration, calibration.with_suffix(".npz")))
    format_to_write(output)
    record = read_calibration(calibration)
    with open_recording(raw) as recording:
        images = section(
            recording,
            record,
            mode,
            cores=cores,
            flat_field=flat_field,
            row_reference=row_reference,
            row_power=row_power,
        )
        images.save(output, force=force, progress=progress)
    click.echo(f"{output}: {len(images)} {mode} images of {images.side} x {images.side} px")
