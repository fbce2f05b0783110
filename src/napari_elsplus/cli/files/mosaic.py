"""``mosaic``: the probe's track through a recording, and the mosaic of its images."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from napari_elsplus.cli.options import (
    FILE,
    IMAGE_TYPE,
    LazyChoice,
    LazyHelp,
    ReadingCommand,
    calibration_of,
    calibration_option,
    files_read,
    force_option,
    output_option,
    progress,
    refuse_outputs,
    tracked,
)
from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray


def _described_methods() -> str:
    from napari_elsplus.processing.tracking.registry import tracking_methods

    return "; ".join(f"{name}: {method.description}" for name, method in tracking_methods().items()) + "."


@click.command(cls=ReadingCommand)
@click.argument("raw", type=FILE)
@calibration_option
@click.option("--mode", type=IMAGE_TYPE, help="Image type to track and insert.  [default: els]")
@click.option(
    "--finished", is_flag=True,
    help="RAW are finished images of any microscope: no calibration, tracked and inserted at their own resolution.",
)  # fmt: skip
@click.option(
    "--method", cls=LazyHelp, describe=_described_methods, default="elsplus", show_default=True,
    type=LazyChoice("napari_elsplus.processing.tracking.registry:tracking_methods"),
)  # fmt: skip
@click.option(
    "--insertion", default="dead-leaf", show_default=True,
    type=LazyChoice("napari_elsplus.processing.mosaicing.mosaic:Insertion"),
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
    flat: Path | None,
    output: Path,
    track: Path | None,
    force: bool,
    **options: Any,
) -> None:
    """Track the probe through RAW and insert its images into a mosaic."""
    from napari_elsplus.io import open_recording
    from napari_elsplus.io.formats.registry import format_to_write
    from napari_elsplus.workflows.mosaicing import mosaic as make_mosaic

    if finished and (calibration is not None or mode is not None):
        given = "-c" if calibration is not None else "--mode"
        raise InputError(f"--finished excludes {given}", "finished images have neither a calibration nor a mode")
    inputs = (flat, *((raw,) if finished else files_read(raw, calibration)))
    refuse_outputs(output, track, force=force, inputs=inputs, suffixes={track: ".csv"})
    format_to_write(output)
    even = None if flat is None else _mean_of(flat)
    with open_recording(raw) as recording:
        otherwise = ", or give --finished for finished images"
        record = None if finished else calibration_of(recording, calibration, otherwise)
        result = make_mosaic(recording, record, mode, finished=finished, flat=even, progress=progress, **options)
    result.save(output, track, force=force)
    states = [row.state for row in result.track]
    click.echo(f"{tracked(result.track)}, {states.count('predicted')} predicted, {states.count('lost')} lost")
    for note in result.notes:
        click.echo(f"note: {note}")


def _mean_of(path: Path) -> NDArray[np.float32]:
    from napari_elsplus.io import open_recording
    from napari_elsplus.processing.calibration.frame_regions import mean_frame

    with open_recording(path) as frames:
        return mean_frame(frames)
