"""From raw frame to mosaic, everything that has to be done before the next frame comes."""

from __future__ import annotations

from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from benchmarks.choices import insertion
from benchmarks.choices.frontend import papers, papers_chain
from benchmarks.choices.insertion import Canvas, Stroke
from benchmarks.harness.methods import Benchmark, Case, Chart, Judgement, Method, Role, TimedElsewhere
from benchmarks.harness.peers import peer
from benchmarks.harness.running import thread_clock
from benchmarks.rigs.simulated import SimulatedRig, simulated_rig
from benchmarks.studies.stages import PapersCanvas, our_stages, papers_stages
from napari_elsplus.processing.images.sectioning import Mode, Sectioner
from napari_elsplus.processing.tracking.template_tracking import SIDE_PX, TemplateTracking
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.specimen.trajectories import HandHeld, Straight, Trajectory
from napari_elsplus.workflows.tracking import Pipeline
from napari_elsplus.workflows.two_threads import tracking_images

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

_CANVAS_PX = 1200


class Live(NamedTuple):
    """Raw frames as they come, the scene, and where the probe was in the first of them (um)."""

    raw: NDArray[np.uint8]
    name: str
    start_um: NDArray[np.float64]


class Found(NamedTuple):
    """A mosaic, its pixel, and how long each stage took (us) where that was measured."""

    canvas: Canvas
    um_per_px: float
    stages: Mapping[str, float] = {}


def _record(rig: SimulatedRig, name: str, path: Trajectory, frames: int) -> Live:
    raw = rig.recording(scene(name), path, frames)
    return Live(raw, name, rig.positions_px(path, 1)[0] * rig.um_per_px)


def _cases(quick: bool) -> list[Case]:
    rig = simulated_rig()
    frames = 4 if quick else 144
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
    judged = insertion.judge(Stroke([], np.empty((0, 2)), np.empty((0, 2)), item.name, um), placed)
    stages = {f"{stage} / us": us for stage, us in answer.stages.items()}
    return judged._replace(details={**judged.details, **stages})


def _ours(*, two_threads: bool = False) -> Callable[[Case], Callable[[Live], TimedElsewhere]]:
    """Prepare this software's pipeline; on two threads the clock on the wall is read."""

    def prepare(case: Case) -> Callable[[Live], TimedElsewhere]:
        rig = case.context
        clock = perf_counter if two_threads else thread_clock()
        stages: dict[str, float] = {}

        def run(item: Live) -> TimedElsewhere:
            pipeline = Pipeline(rig.calibration, rig.instrument.frame_shape)
            start = clock()
            if two_threads:
                images = tracking_images(pipeline, ((raw, raw) for raw in item.raw), len(item.raw))
                for k, image in enumerate(images):
                    pose = pipeline.tracking.estimate_pose(image)
                    pipeline.note(pose, k, np.nan)
                    pipeline.insert(partial(np.asarray, image), pose)
            else:
                for k, raw in enumerate(item.raw):
                    pipeline.add(raw, k)
            seconds = clock() - start
            if not (two_threads or stages):
                stages.update(our_stages(rig.calibration, item.raw))
            read = {key: mosaic.read() for key, mosaic in pipeline.mosaics.items()}
            largest = max(read, key=lambda key: read[key][0].size)
            (image, weight), extent = read[largest], pipeline.mosaics[largest].extent
            assert extent is not None
            canvas = Canvas(image, weight > 0, extent.top, extent.left)
            return TimedElsewhere(Found(canvas, pipeline.camera_px_per_pixel * rig.um_per_px, stages), seconds)

        return run

    return prepare


def _papers(*, eight_bits: bool) -> Callable[[Case], Callable[[Live], TimedElsewhere]]:
    """Prepare the paper's chain in OpenCV, matched in eight bits, or as float32, which OpenCV does faster."""

    def prepare(case: Case) -> Callable[[Live], TimedElsewhere]:
        rig = case.context
        eight, floats = papers_chain(case, down_sampled=True), papers(case)
        clock = thread_clock()
        stages: dict[str, float] = {}

        def front_end(raw: NDArray[np.uint8]) -> NDArray[np.uint8] | NDArray[np.float32]:
            return eight(raw) if eight_bits else floats(raw).image

        def tracker() -> TemplateTracking:
            return TemplateTracking(rig.calibration, rig.instrument.frame_shape, Mode.ELS)

        mask = insertion.field_mask(tracker().grid)

        def run(item: Live) -> TimedElsewhere:
            matching, canvas = tracker(), PapersCanvas(mask, _CANVAS_PX)
            start = clock()
            for raw in item.raw:
                image = front_end(raw)
                pose = matching.estimate_pose(image)
                canvas(image, pose.row, pose.col)
            seconds = clock() - start
            if not stages:
                stages.update(papers_stages(item.raw, front_end, tracker, mask, _CANVAS_PX))
            side = matching.grid.side
            origin = -((_CANVAS_PX - side) // 2) - (side - 1) / 2
            seen = Canvas(canvas.image.astype(np.float32), canvas.covered.astype(bool), origin, origin)
            return TimedElsewhere(Found(seen, matching.scale * rig.um_per_px, stages), seconds)

        return run

    return prepare


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
            image = front_end(raw).image
            seconds += clock() - start
            seconds += other("add_to_mosaic", image=image).seconds
        canvas = other("mosaic").answer.astype(np.float32)
        # it puts the middle of the first image onto the middle of the canvas
        origin = -_CANVAS_PX / 2 + 0.5
        um = sectioner.side / SIDE_PX * rig.um_per_px
        return TimedElsewhere(Found(Canvas(canvas, canvas != 0, origin, origin), um), seconds)

    return run


METHODS = (
    Method("fused, tracked, unsheared", Role.DEFAULT, _ours()),
    Method("the same on two threads", Role.OPTION, _ours(two_threads=True)),
    Method("the paper's, in OpenCV, eight bits", Role.PAPER, _papers(eight_bits=True)),
    Method("the paper's, matched as float32", Role.OPTION, _papers(eight_bits=False)),
    Method("the paper's front end, PyFibreBundle", Role.PEER, _pyfibrebundle),
)

BENCHMARK = Benchmark(
    name="live",
    question="From a raw frame to the mosaic",
    error_label="part of the mosaic that the focal plane does not explain",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    chart=Chart.STAGES,
    remarks=(
        "Time for each frame of 524 x 1328 pixels, first touch of the canvas included; 240 frames per second leave "
        "4167 us. One thread, but for the second row, which is timed by the clock on the wall. Stages are measured one "
        "by one in passes of their own and leave out what lies between them; the search is made once, at the start. "
        "What the live engine adds is charted by `engine`."
    ),
)
