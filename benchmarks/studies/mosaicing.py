"""Mosaics of simulated recordings against the scene that was really there, for docs/tracking-accuracy.md."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np

from benchmarks.rigs.simulated import StopAndGo, simulated_rig, without_timing
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.mosaicing.mosaic import Insertion, Mosaic, rim_weights
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.registry import Method
from napari_elsplus.simulation.accuracy import TrackErrors, track_errors
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.specimen.trajectories import trajectory
from napari_elsplus.workflows.sectioning import RawPairs
from napari_elsplus.workflows.tracking import Pipeline

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from benchmarks.rigs.simulated import SimulatedRig

SMOOTHING_PX: Final = 1.0
SCENE_SMOOTHING_PX: Final = float(np.hypot(SMOOTHING_PX, 1.0))
"""The focal plane is smoothed like the mosaic, and by the pixel that the front end smooths with."""
TRANSLATION: Final = "translation"
"""Our method without rows per frame: every frame is taken as shot at once."""
METHODS: Final = (Method.PAPER.value, TRANSLATION, Method.ELSPLUS.value)
_STEP_PX: Final = 70.0
"""Distance of the resting places from which the scene is looked at, pixels of the tracking grid."""


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
    """Result of a method on a scenario.

    Attributes
    ----------
    errors : TrackErrors
        Of the track.
    error_px : numpy.ndarray
        (T,) distance from the true path, camera pixels, segments laid onto their true first position; nan if lost.
    mosaic, truth : numpy.ndarray
        (rows, cols) the largest segment's mosaic, and what a probe at rest sees there without noise; 0 where not
        covered.
    correlation : float
        Between them: what motion, noise and tracking cost.
    focal_correlation : float
        Of the mosaic with the focal plane of the scene alone: what ELS+ leaves of other planes counts as well.
    """

    errors: TrackErrors
    error_px: NDArray[np.float64]
    mosaic: NDArray[np.float32]
    truth: NDArray[np.float32]
    correlation: float
    focal_correlation: float


def outcomes(scenario: Scenario) -> dict[str, Outcome]:
    """Record a scenario and let each method make its mosaic."""
    rig = simulated_rig()
    path = trajectory(scenario.path, speed_um_s=scenario.speed_um_s)
    raw = rig.recording(scene(scenario.scene), path, scenario.frames)
    true_px = rig.positions_px(path, scenario.frames)
    margin_um = rig.instrument.bundle.radius_um
    ends_um = true_px.min(axis=0) * rig.um_per_px, true_px.max(axis=0) * rig.um_per_px
    at_rest = SeenAtRest(rig, scenario.scene, ends_um[0] - margin_um, ends_um[1] + margin_um)
    return {method: _outcome(method, rig, raw, true_px, scenario, at_rest) for method in METHODS}


def _outcome(
    method: str,
    rig: SimulatedRig,
    raw: NDArray[np.uint8],
    true_px: NDArray[np.float64],
    scenario: Scenario,
    at_rest: SeenAtRest,
) -> Outcome:
    calibration = rig.calibration
    if method == TRANSLATION:
        calibration, method = without_timing(calibration), Method.ELSPLUS.value
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
    mosaic = pipeline.mosaics[largest]
    assert mosaic.extent is not None
    image, weight = mosaic.read()
    rows, cols = (
        np.asarray(((np.arange(count) + first) * pipeline.camera_px_per_pixel + origin) * rig.um_per_px, np.float64)
        for count, first, origin in zip(image.shape, mosaic.extent[:2], start, strict=True)
    )
    covered = weight > 0
    truth = np.where(covered, at_rest.sample(rows, cols), np.float32(0))
    focal = scene(scenario.scene).planes[0].texture.sample(rows, cols)
    return Outcome(
        track_errors(pipeline.rows, true_px),
        np.hypot(*(found + offset - true_px).T),
        image,
        truth,
        _correlation(image, truth, SMOOTHING_PX, covered),
        _correlation(image, np.where(covered, focal, np.float32(0)), SCENE_SMOOTHING_PX, covered),
    )


def _correlation(
    mosaic: NDArray[np.float32], truth: NDArray[np.float32], smoothing_px: float, covered: NDArray[np.bool_]
) -> float:
    pair = zip((mosaic, truth), (SMOOTHING_PX, smoothing_px), strict=True)
    return float(np.corrcoef(*(cv2.GaussianBlur(image, (0, 0), sigma)[covered] for image, sigma in pair))[0, 1])


class SeenAtRest:
    """Reference image of a scene without noise and motion: ELS+ at rest at many positions, combined.

    Parameters
    ----------
    rig : SimulatedRig
        The instrument.
    name : str
        The scene.
    low_um, high_um : numpy.ndarray
        First and last (row, col) of the scene that is looked at.
    """

    def __init__(self, rig: SimulatedRig, name: str, low_um: NDArray[np.float64], high_um: NDArray[np.float64]) -> None:
        grid = Grid.of(rig.calibration)
        self._um = grid.binning * rig.um_per_px
        rows, cols = (
            np.arange(low, high + _STEP_PX, _STEP_PX)
            for low, high in zip(low_um / self._um, high_um / self._um, strict=True)
        )
        places = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)
        path = StopAndGo(places * self._um, rig.instrument.optics.frame_period_s)
        images = rig.tracking_images(rig.recording(scene(name), path, len(places), noise=False))
        weights = rim_weights(grid, rig.instrument.offset_rows / grid.binning) ** 2
        mosaic = Mosaic(grid, Insertion.FEATHERED, weights=weights)
        for image, (row, col) in zip(images, places.tolist(), strict=True):
            mosaic.insert(image, row, col)
        assert mosaic.extent is not None
        self._image, self._corner = mosaic.read()[0], mosaic.extent[:2]

    def sample(self, rows_um: NDArray[np.float64], cols_um: NDArray[np.float64]) -> NDArray[np.float32]:
        """Grey levels at each row and column of the scene; 0 where it was not looked at."""
        rows, cols = (
            np.asarray(at / self._um - first, np.float32)
            for at, first in zip((rows_um, cols_um), self._corner, strict=True)
        )
        across, down = np.meshgrid(cols, rows)
        return np.asarray(cv2.remap(self._image, across, down, cv2.INTER_CUBIC), np.float32)
