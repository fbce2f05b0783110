"""``mosaic``: the probe's track through a recording, and the mosaic of its images."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click
import numpy as np

from napari_elsplus.cli.options import FILE, force_option, output_option, progress, refuse_outputs
from napari_elsplus.errors import InputError
from napari_elsplus.io import open_recording, read_calibration
from napari_elsplus.io.formats.registry import format_to_write, supported_recordings
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.mosaicing.mosaic import Insertion
from napari_elsplus.processing.tracking.registry import Method, tracking_methods
from napari_elsplus.workflows.mosaicing import mosaic as make_mosaic

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


@click.command(
    epilog=f"RAW is one of: {supported_recordings()}.",
)
@click.argument("raw", type=FILE)
@click.option("-c", "--calibration", type=FILE, help="Calibration of the rig that recorded RAW (JSON).")
@click.option(
    "--mode",
    type=click.Choice([m.value for m in Mode]),
    help="Image type to track and insert.  [default: els]",
)
@click.option(
    "--finished", is_flag=True,
    help="RAW are finished images of any microscope: no calibration, tracked and inserted at their own resolution.",
)  # fmt: skip
@click.option(
    "--method", type=click.Choice(list(tracking_methods())), default=Method.ELSPLUS.value, show_default=True,
    help="; ".join(f"{name}: {method.description}" for name, method in tracking_methods().items()) + ".",
)  # fmt: skip
@click.option(
    "--insertion", type=click.Choice([i.value for i in Insertion]), default="dead-leaf", show_default=True,
    help="Rule by which overlapping images are combined; cores: finer than the cores, where the probe moved.",
)  # fmt: skip
@click.option(
    "--flat", type=FILE,
    help="Evenly lit image of the bundle that finished images were taken through, for --insertion cores.",
)  # fmt: skip
@output_option
@click.option("--track", type=FILE, help="Also write the track to this CSV file.")
@force_option
def command(
    raw: Path,
    calibration: Path | None,
    mode: str | None,
    finished: bool,
    method: str,
    insertion: str,
    flat: Path | None,
    output: Path,
    track: Path | None,
    force: bool,
) -> None:
    """Track the probe through RAW and insert its images into a mosaic."""
    if finished and (calibration is not None or mode is not None):
        given = "-c" if calibration is not None else "--mode"
        raise InputError(f"--finished excludes {given}", "finished images have neither a calibration nor a mode")
    if not finished and calibration is None:
        raise InputError("raw frames need a calibration", "give -c CAL, or --finished for finished images")
    files = () if calibration is None else (calibration, calibration.with_suffix(".npz"))
    refuse_outputs(output, track, force=force, inputs=(raw, flat, *files))
    format_to_write(output)
    record = None if calibration is None else read_calibration(calibration)
    even = None if flat is None else _mean_frame(flat)
    with open_recording(raw) as recording:
        result = make_mosaic(
            recording, record, mode, finished=finished, method=method, insertion=insertion, flat=even,
            progress=progress,
        )  # fmt: skip
    result.save(output, track, force=force)
    states = [row.state for row in result.track]
    click.echo(
        f"{states.count('tracked')} of {len(states)} frames tracked in {result.segments} segments, "
        f"{states.count('predicted')} predicted, {states.count('lost')} lost"
    )
    for note in result.notes:
        click.echo(f"note: {note}")


def _mean_frame(path: Path) -> NDArray[np.float32]:
    with open_recording(path) as frames:
        return np.asarray(np.mean([frames[k] for k in range(len(frames))], axis=0), np.float32)
