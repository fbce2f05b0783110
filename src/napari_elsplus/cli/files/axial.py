"""``axial``: drop-off distances and signal kept from a scan of depths."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING

import click

from napari_elsplus.cli.options import (
    FILE,
    ReadingCommand,
    calibration_of,
    calibration_option,
    files_read,
    force_option,
    progress,
    refuse_outputs,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from napari_elsplus.processing.axial.axial_response import AxialResponse, DropOff


@click.command(cls=ReadingCommand)
@click.argument("scan", type=FILE)
@calibration_option
@click.option("--depths", type=FILE, help="CSV with header `depth_um`, a line per frame; by default beside the scan.")
@click.option("-o", "--output", type=FILE, required=True, help="JSON file to write.")
@click.option("--plot", type=FILE, help="Also draw the curves.")
@force_option
def command(
    scan: Path, calibration: Path | None, depths: Path | None, output: Path, plot: Path | None, force: bool
) -> None:
    """Measure 3 dB and 10 dB drop-offs of LS and ELS+, and the in-focus signal kept, from SCAN."""
    from napari_elsplus.io import open_recording, read_depths_um, write_json
    from napari_elsplus.processing.axial.axial_notes import axial_content
    from napari_elsplus.workflows.axial import measure_axial_response

    inputs = (*files_read(scan, calibration), depths)
    refuse_outputs(output, plot, force=force, inputs=inputs, suffixes={output: ".json"})
    if plot is not None:
        from napari_elsplus.workflows.pictures.files import refuse_format

        refuse_format(plot)
    with open_recording(scan) as recording:
        known = calibration_of(recording, calibration)
        depth_um = None if depths is None else read_depths_um(depths)
        response = measure_axial_response(recording, known, depth_um, progress=progress)
    write_json(output, axial_content(response), indent=1, allow_nan=False, force=force)
    if plot is not None:
        from napari_elsplus.workflows.pictures.axial import draw_axial_response
        from napari_elsplus.workflows.pictures.files import save_figure

        save_figure(draw_axial_response(response), plot, force=force)
    for line in _summary(response):
        click.echo(line)
    click.echo(f"wrote {output}")


def _summary(response: AxialResponse) -> Iterator[str]:
    from napari_elsplus.processing.axial.axial_notes import axial_notes

    for name, three, ten in (
        ("LS", response.ls_3db, response.ls_10db),
        ("ELS+", response.els_3db, response.els_10db),
    ):
        yield f"{name}: 3 dB at {_distance(three)}, 10 dB at {_distance(ten)}"
    yield f"signal kept in contact: {_stated(100 * response.signal_kept, 100 * response.signal_kept_uncertainty)} %"
    yield from axial_notes(response)


def _distance(drop: DropOff) -> str:
    return f"{_stated(drop.um, drop.uncertainty_um)} um" if isfinite(drop.um) else "beyond the scan"


def _stated(value: float, uncertainty: float) -> str:
    from napari_elsplus.processing.calibration.summaries import with_uncertainty

    return with_uncertainty(value, uncertainty).replace("±", "+-")
