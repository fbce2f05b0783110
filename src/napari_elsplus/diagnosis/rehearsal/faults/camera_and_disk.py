"""Faults of the camera and of the disk."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

from napari_elsplus.diagnosis.rehearsal.registry import fault

if TYPE_CHECKING:
    from napari_elsplus.diagnosis.rehearsal.stage import Stage

FAULTY_FRAMES = 5
"""Frames cut short, ended badly or lost; chosen."""


@fault("camera-unplugged", "parked within 0.5 s, recording kept, reported", 0.5)
def _camera_unplugged(stage: Stage, limit_s: float) -> None:
    """Unplug the camera while it streams."""
    stage.scan()
    stage.note_exposures()
    stage.fault("unplug")
    stage.expect_parked(limit_s)
    stage.expect_reported("unplugged", "camera")
    stage.finish()


def _faulty_frames(stage: Stage, limit_s: float, kind: str) -> None:
    """Cut frames short, end them with a bad trailer, or lose them in the camera, by `kind`."""
    stage.scan()
    stage.fault("camera", **{kind: FAULTY_FRAMES})
    stage.wait_for(lambda: sum(stage.status().dropped.values()) >= FAULTY_FRAMES, "count of frames lost", limit_s)
    stage.fault_s = time.perf_counter()
    stage.expect_undisturbed()
    reported = sum(stage.reported.values())
    stage.expect(reported == stage.lost, f"{reported} frames were reported as lost, {stage.lost} are missing")
    _keep_counts(stage)


fault("short-frames", "dropped and counted, the others recorded", 2.0)(partial(_faulty_frames, kind="short_frames"))
fault("bad-trailers", "dropped and counted, the others recorded", 2.0)(partial(_faulty_frames, kind="bad_trailers"))
fault("frame-gap", "counted, the others recorded", 2.0)(partial(_faulty_frames, kind="drop_frames"))


@fault("slow-disk", "frames dropped and counted, the stream goes on", 10.0)
def _slow_disk(stage: Stage, limit_s: float) -> None:
    """Let the disk take a tenth of a second for a frame."""
    stage.scan()
    stage.fault("delay", "disk", 0.1)
    stage.wait_for(lambda: stage.status().dropped.get("recorder slow"), "count of frames lost", limit_s)
    stage.expect_scanning()
    stage.expect_frames_go_on()
    stage.switch("quicken", "disk")
    stage.finish()
    _keep_counts(stage)


@fault("full-disk", "whole frames kept and readable, reported, the stream goes on", 2.0, posix=True)
def _full_disk(stage: Stage, limit_s: float) -> None:
    """Let files grow no further."""
    stage.scan()
    stage.fault("fill_disk")
    stage.expect_reported("disk", "rehearsal.ome.tif", timeout_s=limit_s)
    stage.expect_undisturbed()


def _keep_counts(stage: Stage) -> None:
    stage.keep_messages(", ".join(f"{count} {cause}" for cause, count in stage.reported.items()))
