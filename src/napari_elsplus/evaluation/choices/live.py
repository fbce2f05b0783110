"""From raw frame to mosaic, everything that has to be done before the next frame comes."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from napari_elsplus.evaluation.choices import insertion
from napari_elsplus.evaluation.choices.frontend import Raw, papers
from napari_elsplus.evaluation.choices.insertion import Canvas, Stroke
from napari_elsplus.evaluation.harness import Benchmark, Case, Judgement, Method, Role, TimedElsewhere
from napari_elsplus.evaluation.peers import peer
from napari_elsplus.evaluation.rig import SimulatedRig, simulated_rig
from napari_elsplus.evaluation.running import thread_clock
from napari_elsplus.processing.paper_mosaic import SIDE_PX, PaperTracker
from napari_elsplus.processing.sectioning import Sectioner
from napari_elsplus.simulation.scenes import scene
from napari_elsplus.simulation.trajectories import HandHeld, Straight, Trajectory
from napari_elsplus.tracking_pipeline import Pipeline

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

_CANVAS_PX = 1200


class Live(NamedTuple):
    """Raw frames as they come, the scene, and where the probe was in the first of them (um)."""

    raw: NDArray[np.uint8]
    name: str
    start_um: NDArray[np.float64]


class Found(NamedTuple):
    """A mosaic, its pixel, and where the probe's first position lies in it (row, col)."""

    canvas: Canvas
    um_per_px: float


def _record(rig: SimulatedRig, name: str, path: Trajectory, frames: int) -> Live:
    raw = rig.recording(scene(name), path, frames)
    return Live(raw, name, rig.positions_px(path, 1)[0] * rig.um_per_px)


def _cases(quick: bool) -> list[Case]:
    rig = simulated_rig()
    frames = 4 if quick else 72
    paths: dict[str, Trajectory] = {
        "fibres, straight, 8 mm/s": Straight(8000.0),
        "fibres, hand, 1.5 mm/s": HandHeld(1500.0),
    }
    names = list(paths)[: 1 if quick else None]
    return [Case(name, [_record(rig, "fibres", paths[name], frames)], context=rig, calls=frames) for name in names]


def judge(item: Live, answer: Found) -> Judgement:
    """Part of the mosaic that the focal plane does not explain, positions counted from the first frame's true one."""
    um = answer.um_per_px
    start = item.start_um / um
    placed = answer.canvas._replace(top=answer.canvas.top + start[0], left=answer.canvas.left + start[1])
    return insertion.judge(Stroke([], np.empty((0, 2)), np.empty((0, 2)), item.name, um), placed)


def _ours(case: Case) -> Callable[[Live], Found]:
    rig = case.context

    def run(item: Live) -> Found:
        pipeline = Pipeline(rig.calibration, rig.instrument.frame_shape)
        for k, raw in enumerate(item.raw):
            pipeline.add(raw, k)
        mosaic = max(pipeline.mosaics.values(), key=lambda m: m.read()[0].size)
        image, weight = mosaic.read()
        assert mosaic.extent is not None
        canvas = Canvas(image, weight > 0, mosaic.extent.top, mosaic.extent.left)
        return Found(canvas, pipeline.camera_px_per_pixel * rig.um_per_px)

    return run


def _papers(case: Case) -> Callable[[Live], Found]:
    rig = case.context
    front_end = papers(case)
    sectioner = Sectioner(rig.calibration, rig.instrument.frame_shape)

    def run(item: Live) -> Found:
        tracker = PaperTracker(sectioner.diameter_px, sectioner.side)
        mask = insertion.field_mask(tracker.grid)
        side, middle = tracker.grid.side, (_CANVAS_PX - tracker.grid.side) // 2
        canvas, covered = np.zeros((_CANVAS_PX,) * 2, np.float32), np.zeros((_CANVAS_PX,) * 2, np.uint8)
        for raw in item.raw:
            image = front_end(Raw(raw, "", (0.0, 0.0))).image
            pose = tracker.add(image)
            row, col = int(pose.row) + middle, int(pose.col) + middle
            here = np.s_[row : row + side, col : col + side]
            cv2.copyTo(image, mask, canvas[here])
            cv2.copyTo(mask, mask, covered[here])
        origin = -middle - (side - 1) / 2
        return Found(Canvas(canvas, covered.astype(bool), origin, origin), tracker.scale * rig.um_per_px)

    return run


def _pyfibrebundle(case: Case) -> Callable[[Live], TimedElsewhere]:
    """Prepare the paper's front end followed by PyFibreBundle's mosaic; the time is that of both."""
    other, rig = peer("PyFibreBundle"), case.context
    front_end = papers(case)
    sectioner = Sectioner(rig.calibration, rig.instrument.frame_shape)

    def run(item: Live) -> TimedElsewhere:
        clock, seconds = thread_clock(), 0.0
        other("start_mosaic", size=_CANVAS_PX, blend=True)
        for raw in item.raw:
            start = clock()
            image = front_end(Raw(raw, "", (0.0, 0.0))).image
            seconds += clock() - start
            seconds += other("add_to_mosaic", image=image).seconds
        canvas = other("mosaic").answer.astype(np.float32)
        # it puts the middle of the first image onto the middle of the canvas
        origin = -_CANVAS_PX / 2 + 0.5
        um = sectioner.side / SIDE_PX * rig.um_per_px
        return TimedElsewhere(Found(Canvas(canvas, canvas != 0, origin, origin), um), seconds)

    return run


METHODS = (
    Method("fused, tracked, unsheared", Role.DEFAULT, _ours),
    Method("the paper's, in OpenCV", Role.PAPER, _papers),
    Method("the paper's front end, PyFibreBundle", Role.PEER, _pyfibrebundle),
)

BENCHMARK = Benchmark(
    name="live",
    question="From a raw frame to the mosaic",
    error_label="part of the mosaic that the focal plane does not explain",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    remarks=(
        "One thread, time for each frame of 524 x 1328 pixels; 240 frames per second leave 4167 us. What the live "
        "engine adds (the camera's ring, recording, display) is not in it."
    ),
)
