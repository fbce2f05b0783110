"""Whole recordings, raw frame to position: drift, speed, and what is wrong without being noticed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np

from benchmarks.choices.frontend import papers
from benchmarks.harness.methods import Benchmark, Case, Judgement, Method, Role, TimedElsewhere
from benchmarks.harness.peers import peer
from benchmarks.rigs.simulated import SimulatedRig, simulated_rig, tissue, without_timing
from napari_elsplus.io import TrackPoint
from napari_elsplus.processing.images.sectioning import Mode, Sectioner
from napari_elsplus.processing.tracking.registry import Method as Tracking
from napari_elsplus.processing.tracking.registry import tracking_methods
from napari_elsplus.processing.tracking.template_tracking import SIDE_PX, TemplateTracking
from napari_elsplus.simulation.accuracy import track_errors
from napari_elsplus.simulation.specimen.trajectories import trajectory
from napari_elsplus.workflows.tracking import Pipeline

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

_CANVAS_PX = 3000


class Recorded(NamedTuple):
    """Raw frames of a moving probe, and its true positions in camera pixels."""

    raw: NDArray[np.uint8]
    true_px: NDArray[np.float64]


def recorded(rig: SimulatedRig, scene: str, path: str, speed_um_s: float, frames: int, seed: int = 0) -> Recorded:
    """Record a scene along a path."""
    moved = trajectory(path, speed_um_s=speed_um_s, seed=seed)
    return Recorded(rig.recording(tissue(scene, seed), moved, frames, seed=seed), rig.positions_px(moved, frames))


def _cases(quick: bool) -> list[Case]:
    rig = simulated_rig()
    frames = 6 if quick else 96
    wanted = {
        "fibres, hand, 1.5 mm/s": ("fibres", "hand", 1500.0),
        "fibres, straight, 8 mm/s": ("fibres", "straight", 8000.0),
        "nuclei, straight, 0.2 mm/s": ("nuclei", "straight", 200.0),
        "sparse, hand, 1.5 mm/s": ("sparse", "hand", 1500.0),
    }
    names = list(wanted)[: 1 if quick else None]
    return [Case(name, [recorded(rig, *wanted[name], frames)], context=rig, calls=frames) for name in names]


def judge(item: Recorded, answer: Sequence[TrackPoint]) -> Judgement:
    """Error at the end, as a share of the path; a track with a wrong link that is called tracked has failed."""
    errors = track_errors(answer, item.true_px)
    return Judgement(
        errors.end_error_percent_of_path,
        failed=errors.wrong_links > 0,
        details={
            "pair error / px": errors.median_pair_error_px,
            "wrong links": errors.wrong_links,
            "tracked / %": 100 * errors.tracked / errors.frames,
            "segments": errors.segments,
        },
    )


def _pipeline(method: str, *, shutter: bool = True, loops: bool = False) -> Callable[[Case], Callable[[Recorded], Any]]:
    def prepare(case: Case) -> Callable[[Recorded], Any]:
        calibration = case.context.calibration if shutter else without_timing(case.context.calibration)

        def track(item: Recorded) -> list[TrackPoint]:
            pipeline = Pipeline(calibration, item.raw.shape[1:], method=method)
            for k, raw in enumerate(item.raw):
                pipeline.track(raw, k)
            if loops:
                pipeline.finish(lambda k: (item.raw[k], item.raw[k]))
            return pipeline.rows

        return track

    return prepare


def _papers_chain(case: Case) -> Callable[[Recorded], list[TrackPoint]]:
    rig = case.context
    front_end = papers(case)

    def track(item: Recorded) -> list[TrackPoint]:
        tracker = TemplateTracking(rig.calibration, rig.instrument.frame_shape, Mode.ELS)
        rows = []
        for k, raw in enumerate(item.raw):
            pose = tracker.estimate_pose(front_end(raw).image)
            px = pose.row * tracker.scale, pose.col * tracker.scale
            rows.append(_point(rig, k, px, pose.score))
        return rows

    return track


def _point(rig: SimulatedRig, frame: int, px: tuple[float, float], score: float) -> TrackPoint:
    um = px[0] * rig.um_per_px, px[1] * rig.um_per_px
    return TrackPoint(frame, np.nan, 0, *px, *um, score, np.nan, "tracked")


def _pyfibrebundle(case: Case) -> Callable[[Recorded], TimedElsewhere]:
    other, rig = peer("PyFibreBundle"), case.context
    sectioner = Sectioner(rig.calibration, rig.instrument.frame_shape)
    scale = sectioner.side / SIDE_PX

    def track(item: Recorded) -> TimedElsewhere:
        other("start_mosaic", size=_CANVAS_PX, blend=False)
        rows, seconds = [], 0.0
        for k, raw in enumerate(item.raw):
            small = cv2.resize(sectioner.els(raw), (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA)
            (row, col, score), took = other("add_to_mosaic", image=np.clip(small, 0, None))
            seconds += took
            rows.append(_point(rig, k, (float(row) * scale, float(col) * scale), float(score)))
        return TimedElsewhere(rows, seconds)

    return track


_REGISTERED = tuple(Method(name, Role.PEER, _pipeline(name)) for name in tracking_methods() if name not in {*Tracking})
"""Methods of other packages."""

METHODS = (
    Method("tracker", Role.DEFAULT, _pipeline(Tracking.ELSPLUS), 4),
    Method("tracker, then loops and mosaic", Role.OPTION, _pipeline(Tracking.ELSPLUS, loops=True), 4),
    Method("tracker, rolling shutter ignored", Role.OPTION, _pipeline(Tracking.ELSPLUS, shutter=False), 2),
    Method("the paper's, in OpenCV, float32", Role.PAPER, _papers_chain, 2),
    Method("the paper's, signed, aligned", Role.OPTION, _pipeline(Tracking.PAPER), 2),
    Method("PyFibreBundle Mosaic", Role.PEER, _pyfibrebundle, 2),
    *_REGISTERED,
)

BENCHMARK = Benchmark(
    name="tracking",
    question="Where the probe is, frame after frame",
    error_label="error at the end / % of the path",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    seconds=0.5,
    remarks=(
        "Time for each frame. The paper's chain is timed as it is written in OpenCV, and once more with this project's "
        "sectioning before it. PyFibreBundle is timed from finished images of 250 pixels, with its insertion; the "
        "others from raw frames, without. In the row with loops the mosaic is re-rendered."
    ),
)
