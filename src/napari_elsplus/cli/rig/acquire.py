"""``acquire``: the live engine without a screen."""

from __future__ import annotations

import gc
import time
from contextlib import ExitStack
from threading import TIMEOUT_MAX
from typing import TYPE_CHECKING

import click

from napari_elsplus.cli.options import (
    FILE,
    POSITIVE,
    calibration_files,
    calibration_progress,
    force_option,
    progress,
    refuse_outputs,
    tracked,
)
from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.parking import ParkStage
from napari_elsplus.hardware.priority import keep_pace
from napari_elsplus.hardware.rig import SIMULATED
from napari_elsplus.instrument.optics import PRESETS
from napari_elsplus.instrument.scanning import dark_advice, lag_advice, rate_advice

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from napari_elsplus.acquisition.engine.engine import Engine
    from napari_elsplus.acquisition.engine.status import Status
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.workflows.tracking import Pipeline

_STEP_S = 0.1
"""Seconds from one step of the progress bar to the next; chosen, shorter than it can be read."""
ALL_OF_IT_S = 3600.0
"""Seconds before the command that are recorded, too; chosen, longer than the engine has streamed by then."""


@click.command()
@click.option("--rig", "rig_name", default=SIMULATED, show_default=True, help="Name of the rig; `doctor` lists them.")
@click.option("-c", "--calibration", type=FILE, help="Calibration file; without one the simulated rig is calibrated.")
@click.option("--preset", type=click.Choice(list(PRESETS)), default="240hz", show_default=True, help="Camera region.")
@click.option("--slit-rows", type=click.IntRange(1), default=3, show_default=True, help="Width of the rolling slit.")
@click.option("--rate-hz", type=POSITIVE, help="Frames per second; the preset's by default.")
@click.option("--seconds", type=POSITIVE, required=True, help="How long.")
@click.option("--record", type=FILE, help="Record the raw frames to this OME-TIFF.")
@click.option("--mosaic", type=FILE, help="Write the mosaic to this OME-TIFF or OME-Zarr.")
@click.option("--track", type=FILE, help="Write the probe's track to this CSV file.")
@click.option("--report", type=FILE, required=True, help="Write what happened to this JSON file.")
@force_option
def command(
    rig_name: str,
    calibration: Path | None,
    preset: str,
    slit_rows: int,
    rate_hz: float | None,
    seconds: float,
    record: Path | None,
    mosaic: Path | None,
    track: Path | None,
    report: Path,
    force: bool,
) -> None:
    """Run the live engine for some seconds: section every frame, record, track, insert into the mosaic, report."""
    from napari_elsplus.acquisition.calibrating.simulated import use_simulated_calibration
    from napari_elsplus.acquisition.engine.live_images import LiveView
    from napari_elsplus.acquisition.engine.status import Settings
    from napari_elsplus.acquisition.live_engine import live_engine
    from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
    from napari_elsplus.io import beside, read_calibration, refuse_suffix, write_json
    from napari_elsplus.io.disk import require_room
    from napari_elsplus.io.formats.registry import format_to_write
    from napari_elsplus.io.recorder import RECORDING_SUFFIXES

    beside_record = () if record is None else [beside(record, f".calibration{ending}") for ending in (".json", ".npz")]
    read, suffixes = calibration_files(calibration), {track: ".csv", report: ".json"}
    refuse_outputs(record, *beside_record, mosaic, track, report, force=force, inputs=read, suffixes=suffixes)
    if record is not None:
        refuse_suffix(record, *RECORDING_SUFFIXES)
    if mosaic is not None:
        format_to_write(mosaic)
    if seconds > TIMEOUT_MAX:
        raise InputError(f"--seconds is {seconds:g}", f"give at most {TIMEOUT_MAX:.3g}, which a clock counts")
    keep_pace()
    given = None if calibration is None else read_calibration(calibration)
    with ExitStack() as held:
        rig, engine = held.enter_context(live_engine(rig_name, Settings(preset, slit_rows, rate_hz)))
        if record is not None:
            require_room(record, seconds * engine.setup.bytes_per_s)
        if record is not None or mosaic is not None or track is not None:
            _refuse_more_than_kept(seconds, engine.setup.frame_rate_hz)
        if given is not None:
            engine.use(given)
        else:
            engine.show(None)
            use_simulated_calibration(rig, engine, progress=calibration_progress)
        assert engine.calibration is not None
        tracker = None
        if mosaic is not None or track is not None:
            from napari_elsplus.acquisition.mosaic.tracking import LiveTrack

            tracker = LiveTrack(engine.calibration, engine.setup.frame_shape)
            held.callback(tracker.close)
            engine.track(tracker)
        engine.show(LiveView() if tracker is None else None)  # else nobody looks at other images than the mosaic
        gc.freeze()  # also what the calibration and the track have allocated
        engine.start()
        if record is not None:
            engine.record(RecordingPlan(record, earlier_s=ALL_OF_IT_S, force=force))
        completed, kept = False, [record]
        try:
            _stream(engine, seconds)
            completed = not engine.status().faults
        finally:
            engine.stop()
            engine.finish_recording()
            status = engine.status()
            remarks = list(notes(status, engine.calibration))
            write_json(report, {**status.report(), "notes": remarks}, indent=1, force=force)
            if tracker is not None:
                tracker.settle()
                if completed or tracker.pipeline.mosaics:
                    _write(tracker.pipeline, engine, mosaic, track, force)
                    kept += [mosaic, track]
                remarks.insert(0, tracked(tracker.pipeline.rows))
            names = ", ".join(str(path) for path in kept if path is not None and path.exists())
            if names and not completed:
                click.echo(f"what was acquired until now is kept in {names}", err=True)
    click.echo(summary(status))
    for remark in remarks:
        click.echo(f"note: {remark}")
    parking = rig.scanner.park_state  # after closing
    if parking.stage is ParkStage.NOT_PARKED:
        raise DeviceError(parking.message, "keep it off until the galvo is parked")
    if faults := engine.status().faults:
        raise InputError(faults[0].problem, faults[0].remedy)


def _refuse_more_than_kept(seconds: float, rate_hz: float) -> None:
    """Refuse a run of more frames than a recording that can be read, a track or a mosaic may have."""
    from napari_elsplus.io.formats.source import MAX_FRAMES

    if seconds * rate_hz > MAX_FRAMES:
        raise InputError(
            f"--seconds {seconds:g} at {rate_hz:g} Hz are {seconds * rate_hz:.3g} frames",
            f"give at most {MAX_FRAMES / rate_hz:.0f} s, or keep neither recording, mosaic nor track",
        )


def _stream(engine: Engine, seconds: float) -> None:
    """Stream for some seconds, counted from the first frame."""
    while engine.status().live and not engine.status().acquired:
        time.sleep(_STEP_S / 10)
    end_s = time.monotonic() + seconds
    steps = max(1, round(seconds / _STEP_S))
    for step in progress(range(steps), "Acquiring"):
        time.sleep(max(0.0, end_s - (steps - step - 1) * seconds / steps - time.monotonic()))
        if not engine.status().live:
            break


def _write(pipeline: Pipeline, engine: Engine, mosaic: Path | None, track: Path | None, force: bool) -> None:
    from napari_elsplus.io import ImageMetadata, write_mosaic, write_track
    from napari_elsplus.processing.mosaicing.montage import montage

    calibration = engine.calibration
    assert calibration is not None
    if track is not None:
        write_track(track, pipeline.rows, force=force)
    if mosaic is not None:
        image = montage(list(pipeline.mosaics.values()))
        write_mosaic(mosaic, image, ImageMetadata(um_per_px=pipeline.um_per_px, calibration=calibration), force=force)


def notes(status: Status, calibration: Calibration) -> Iterator[str]:
    """Yield what else there is to know of a run by its status and calibration: why images are not what they should be.

    Parameters
    ----------
    status : Status
        At its end.
    calibration : Calibration
        By which it scanned.
    """
    from napari_elsplus.processing.analysis.saturation import saturation_note

    lag = lag_advice(calibration)
    saturated = saturation_note(status.saturated)
    yield from filter(None, (saturated, status.notice, status.disagreement, dark_advice(calibration)))
    if lag:
        yield f"{lag}; `calibrate --rig` and the Calibration panel measure it"
    if rate := rate_advice(calibration):
        yield f"{rate}; `acquire` and `calibrate --rig` take --rate-hz"
    for section, reason in status.stale.items():
        yield f"the calibration's {section} may not hold: {reason}"


def summary(status: Status) -> str:
    """Return the status in one line."""
    dropped = ", ".join(f"{count} {cause}" for cause, count in status.dropped.items()) or "none"
    latency = status.latency_ms
    return (
        f"{status.acquired} frames at {status.mean_hz:.1f} Hz, "
        f"{status.processed} processed, {status.recorded} recorded; "
        f"lost: {dropped}; latency {latency.p50:.1f} ms median, {latency.p99:.1f} ms p99, {latency.max:.1f} ms at most"
    )
