"""Mosaics of simulated recordings against the scene that was really there, for docs/mosaicing.md."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np

from napari_elsplus.evaluation.against_truth import TrackErrors, track_errors
from napari_elsplus.evaluation.rig import simulated_rig
from napari_elsplus.processing.frontend import FrontEnd
from napari_elsplus.processing.motion import Velocity
from napari_elsplus.processing.registration import Registrar
from napari_elsplus.processing.sectioning import Mode
from napari_elsplus.simulation.scenes import picture, scene
from napari_elsplus.simulation.trajectories import trajectory
from napari_elsplus.tracking_pipeline import Method, Pipeline, RawPairs

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.evaluation.rig import SimulatedRig
    from napari_elsplus.simulation.scenes import Scene

SMOOTHING_PX: Final = 1.0
SCENE_SMOOTHING_PX: Final = float(np.hypot(SMOOTHING_PX, 1.0))
"""The scene is smoothed like the mosaic, and by the pixel that the front end smooths with."""
TRANSLATION: Final = "translation"
"""Our method without rows per frame: every frame is taken as shot at once."""
METHODS: Final = (Method.PAPER.value, TRANSLATION, Method.ELSPLUS.value)
_SPREAD: Final = 0.01
_SCENE_PX: Final = 2400
_SCENE_UM_PER_PX: Final = 2.0


class Scenario(NamedTuple):
    """A probe moved over a scene of the simulator."""

    scene: str
    path: str
    speed_um_s: float
    frames: int

    def __str__(self) -> str:
        return f"{self.scene}, {self.path}, {self.speed_um_s / 1000:g} mm/s"


@dataclass(frozen=True)
class Outcome:
    """What a method made of a scenario.

    Attributes
    ----------
    errors : TrackErrors
        Of the track.
    error_px : numpy.ndarray
        (T,) distance from the true path, camera pixels, segments laid onto their true first position; nan if lost.
    mosaic, truth : numpy.ndarray
        (rows, cols) the largest segment's mosaic, and the focal plane of the scene on its pixels; 0 where not covered.
    correlation : float
        Between them.
    """

    errors: TrackErrors
    error_px: NDArray[np.float64]
    mosaic: NDArray[np.float32]
    truth: NDArray[np.float32]
    correlation: float


def outcomes(scenario: Scenario) -> dict[str, Outcome]:
    """Record a scenario and let each method make its mosaic."""
    rig = simulated_rig()
    path = trajectory(scenario.path, speed_um_s=scenario.speed_um_s)
    raw = rig.recording(scene(scenario.scene), path, scenario.frames)
    true_px = rig.positions_px(path, scenario.frames)
    return {method: _outcome(method, rig, raw, true_px, scenario) for method in METHODS}


def _outcome(
    method: str, rig: SimulatedRig, raw: NDArray[np.uint8], true_px: NDArray[np.float64], scenario: Scenario
) -> Outcome:
    calibration = rig.calibration
    if method == TRANSLATION:
        assert calibration.optics is not None
        untimed = calibration.optics.model_copy(update={"rows_per_frame": None})
        calibration, method = calibration.model_copy(update={"optics": untimed}), Method.ELSPLUS.value
    pairs = RawPairs(raw, Mode.ELS)
    pipeline = Pipeline(calibration, rig.instrument.frame_shape, method=method)
    for index in range(len(pairs)):
        pipeline.track(raw[index], index)
    pipeline.finish(pairs)
    found = np.array([(row.row_px, row.col_px) for row in pipeline.rows])
    segment = np.array([row.segment for row in pipeline.rows])
    offset = np.full_like(found, np.nan)
    for number in np.unique(segment):
        mine = np.flatnonzero((segment == number) & np.isfinite(found[:, 0]))
        if len(mine):
            offset[segment == number] = true_px[mine[0]] - found[mine[0]]
    largest = max(pipeline.mosaics, key=lambda number: int((segment == number).sum()))
    mine = (segment == largest) & np.isfinite(found[:, 0])
    start = np.asarray((true_px - found)[mine].mean(axis=0), np.float64)
    mosaic, truth, weight = _beside_truth(pipeline, largest, start, rig.um_per_px, scenario.scene)
    smoothing = zip((mosaic, truth), (SMOOTHING_PX, SCENE_SMOOTHING_PX), strict=True)
    smooth = [cv2.GaussianBlur(image, (0, 0), sigma)[weight > 0] for image, sigma in smoothing]
    return Outcome(
        track_errors(pipeline.rows, true_px),
        np.hypot(*(found + offset - true_px).T),
        mosaic,
        truth,
        float(np.corrcoef(*smooth)[0, 1]),
    )


def _beside_truth(
    pipeline: Pipeline, segment: int, start_px: NDArray[np.float64], um_per_px: float, name: str
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    mosaic = pipeline.mosaics[segment]
    assert mosaic.extent is not None
    image, weight = mosaic.read()
    rows, cols = (
        np.asarray(((np.arange(count) + first) * pipeline.camera_px_per_pixel + origin) * um_per_px, np.float64)
        for count, first, origin in zip(image.shape, mosaic.extent[:2], start_px, strict=True)
    )
    truth = np.asarray(scene(name).planes[0].texture.sample(rows, cols), np.float32)
    return image, np.where(weight > 0, truth, np.float32(0)), weight


class Judged(NamedTuple):
    """A link between two frames, accepted or not: its evidence, its correlation, and how wrong it is."""

    evidence: float
    correlation: float
    error_px: float


def few_fibres(seed: int, count: int = 180) -> Scene:
    """Straight fibres so far apart that some views show one of them, or none."""
    random = np.random.default_rng(seed)
    image = np.zeros((_SCENE_PX, _SCENE_PX), np.float32)
    for _ in range(count):
        middle, angle = random.uniform(0, _SCENE_PX, 2), random.uniform(0, np.pi)
        along = random.uniform(50, 200) * np.array([np.cos(angle), np.sin(angle)])
        ends = [(int(x), int(y)) for x, y in (middle - along, middle + along)]
        cv2.line(image, ends[0], ends[1], float(random.uniform(0.5, 1.0)), 4, cv2.LINE_AA)
    return picture(cv2.GaussianBlur(image, (0, 0), 1.0), _SCENE_UM_PER_PX)


def judged_links(speed_um_s: float, frames: int, seeds: int) -> list[Judged]:
    """Link successive frames of sparse scenes, each started a few pixels off, and compare with the truth.

    Parameters
    ----------
    speed_um_s : float
        Of the hand that moves the probe.
    frames, seeds : int
        Frames of each recording, and how many recordings.
    """
    rig = simulated_rig()
    judged = []
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        path = trajectory("hand", speed_um_s=speed_um_s, seed=seed)
        raw = rig.recording(few_fibres(seed), path, frames, seed=seed)
        front_end = FrontEnd(rig.calibration, rig.instrument.frame_shape)
        registrar, shutter, binning = Registrar(front_end.grid), front_end.grid.shutter, front_end.grid.binning
        true = rig.positions_px(path, frames) / binning
        views = []
        for frame in raw:
            view = registrar.view()
            front_end.image(frame, view.image)
            views.append(registrar.prepare(view))
        for k, step in enumerate(np.diff(true, axis=0)):
            guess = Velocity(*(step + random.normal(0, 4, 2)).tolist())
            expected = shutter.warp(guess, guess, shutter.step(guess, guess))
            link = registrar.link(views[k], views[k + 1], expected, (_SPREAD, _SPREAD))
            found = shutter.displacement(link.warp, shutter.velocities(link.warp)[1])
            error = float(np.hypot(*(np.array(found) - step))) * binning
            judged.append(Judged(link.evidence, link.correlation, error))
    return judged
