"""``recommend``: slit and offset for haze at a depth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from napari_elsplus.cli.options import FILE, POSITIVE, force_option, refuse_outputs
from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path


@click.command()
@click.option("--depth-um", type=POSITIVE, required=True, help="Distance of the haze from the probe's face.")
@click.option(
    "--keep", type=click.FloatRange(0, 1, min_open=True, max_open=True), default=0.95, show_default=True,
    help="Least fraction of the in-focus signal that ELS+ keeps.",
)  # fmt: skip
@click.option("-c", "--calibration", type=FILE, required=True, help="Calibration with the line's core and halo (JSON).")
@click.option("--plate", type=FILE, help="JSON that `axial` wrote for a plate on this rig; else the model's plate.")
@click.option("-o", "--output", type=FILE, help="Also write all values to this JSON file.")
@force_option
def command(
    depth_um: float, keep: float, calibration: Path, plate: Path | None, output: Path | None, force: bool
) -> None:
    """Recommend slit and offset that suppress haze from a depth and keep enough of the signal."""
    from napari_elsplus.io import read_calibration, write_json
    from napari_elsplus.io.text import read_json
    from napari_elsplus.workflows.recommendation.recommend import recommend

    refuse_outputs(output, force=force, inputs=(calibration, plate), suffixes={output: ".json"})
    measured = None
    if plate is not None:
        measured = read_json(plate, "name the one that `axial` wrote")
        if not isinstance(measured, dict):
            raise InputError(f"{plate.name} has no depths", "name the JSON that `axial` wrote")
    found = recommend(read_calibration(calibration), depth_um, keep, measured)
    content, sigmas = found.content(), found.sigmas
    if output is not None:
        write_json(output, content, indent=1, allow_nan=False, force=force)
    click.echo(f"slit {found.slit_rows:g} rows, offset {found.offset_rows:.1f} +- {sigmas['offset_rows']:.1f} rows")
    for words, name, unit, factor in (
        ("signal kept", "signal_kept", "%", 100.0),
        ("ELS+ 3 dB", "drop_3db_um", "um", 1.0),
        ("ELS+ 10 dB", "drop_10db_um", "um", 1.0),
        (f"ELS+ at {depth_um:g} um over contact", "haze", "%", 100.0),
    ):
        value, sigma = factor * content[name], factor * sigmas[name]
        click.echo(f"{words}: {value:.1f} +- {sigma:.1f} {unit} (now {factor * content['present'][name]:.1f} {unit})")
    for note in found.notes:
        click.echo(f"note: {note}")
