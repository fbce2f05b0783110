"""``napari-elsplus mosaic``: a recording to a mosaic and the probe's track."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click
import numpy as np

from napari_elsplus.cli.options import FILE, calibration_option, force_option, output_option, progress, refuse_outputs
from napari_elsplus.io import open_recording, read_calibration, write_mosaic, write_track
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.mosaicing.montage import montage
from napari_elsplus.processing.mosaicing.mosaic import Insertion
from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.workflows.line_timing import with_timing
from napari_elsplus.workflows.sectioning import RawPairs
from napari_elsplus.workflows.tracking import UNLINKED, Method, Pipeline
from napari_elsplus.workflows.two_threads import Pipelined

if TYPE_CHECKING:
    from pathlib import Path


@click.command(short_help="Track the probe, and lay its frames into a mosaic.")
@click.argument("raw", type=FILE)
@calibration_option
@click.option(
    "--mode", type=click.Choice([m.value for m in Mode]), default="els", show_default=True, help="Which image."
)
@click.option(
    "--method", type=click.Choice([m.value for m in Method]), default="elsplus", show_default=True,
    help="elsplus: sub-pixel, rolling shutter undone; paper: the paper's template matching.",
)  # fmt: skip
@click.option(
    "--insertion", type=click.Choice([i.value for i in Insertion]), default="dead-leaf", show_default=True,
    help="How frames are laid over one another.",
)  # fmt: skip
@output_option
@click.option("--track", type=FILE, help="Also write the track to this CSV file.")
@force_option
def command(
    raw: Path, calibration: Path, mode: str, method: str, insertion: str, output: Path, track: Path | None, force: bool
) -> None:
    """Track the probe through RAW and lay the frames into a mosaic."""
    refuse_outputs(output, track, force=force, inputs=(raw, calibration, calibration.with_suffix(".npz")))
    record = read_calibration(calibration)
    with open_recording(raw) as recording:
        rows, cols = recording.shape[1:]
        pairs, times = RawPairs(recording, mode), recording.times_s
        said = ""
        if method == Method.ELSPLUS:
            record, said = with_timing(record, pairs, mode)
        pipeline = Pipeline(record, (rows, cols), mode, method=method, insertion=insertion)
        with Pipelined(pipeline, lay=False) as two_threads:
            for index in progress(range(len(pairs)), describe="Tracking"):
                frame = pairs.frame(index)
                confocal, residual = pairs(index)
                two_threads.add(confocal, frame, np.nan if times is None else float(times[frame]), residual)
        pipeline.finish(pairs, lambda frames: progress(frames, describe="Mosaic"))
    image = montage(list(pipeline.mosaics.values()))
    notes = {"method": method, "mode": mode}
    write_mosaic(output, image, pipeline.um_per_px, calibration=record, metadata=notes, force=force)
    if track is not None:
        write_track(track, pipeline.rows, force=force)
    if said:
        click.echo(said)
    click.echo(_summary(pipeline))
    if sum(row.state == TrackingState.TRACKED for row in pipeline.rows) < 2:
        click.echo(f"note: {UNLINKED}")


def _summary(pipeline: Pipeline) -> str:
    states = [row.state for row in pipeline.rows]
    return (
        f"{states.count('tracked')} of {len(states)} frames tracked in {len(pipeline.mosaics)} segments, "
        f"{states.count('predicted')} predicted, {states.count('lost')} lost"
    )
