"""When the tracker models rotation: never where the probe does not turn, soon where it does."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from benchmarks.rigs.simulated import simulated_rig, tissue
from benchmarks.studies.drift import tracked_live
from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel, turned_by
from napari_elsplus.simulation.accuracy import TrackErrors, track_errors
from napari_elsplus.simulation.specimen.trajectories import Turning, trajectory
from napari_elsplus.workflows.sectioning import RawPairs
from napari_elsplus.workflows.tracking import Pipeline

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.io import TrackPoint


class Walk(NamedTuple):
    """A probe moved over a scene while it turns.

    Parameters
    ----------
    scene, path : str
        Names.
    speed_um_s : float
        Of its middle.
    turn_deg_s : float
        How fast it turns at first; it turns to and fro.
    frames, seed : int
        How long, and which.
    """

    scene: str
    path: str
    speed_um_s: float
    turn_deg_s: float
    frames: int
    seed: int = 0


REACH_DEG = 10.0


class Turned(NamedTuple):
    """Result of a walk.

    Parameters
    ----------
    model : MotionModel
        What was modelled in the end.
    since : int or None
        First frame for which rotation was modelled.
    angle_deg : float
        Largest true angle.
    angle_error_deg : float
        Root-mean-square error of the angle in the finished track.
    errors : TrackErrors
        Of the finished track.
    strayed_px : tuple of float
        Largest distance of the longest segment's frames from the truth, camera pixels: from frame to frame alone, with
        all that is corrected live, and of the finished track.
    """

    model: MotionModel
    since: int | None
    angle_deg: float
    angle_error_deg: float
    errors: TrackErrors
    strayed_px: tuple[float, float, float]


def recorded(walk: Walk) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.float64]]:
    """Return raw frames, true positions (camera pixels, in the first frame's orientation) and angles (radians)."""
    rig = simulated_rig()
    path = Turning(trajectory(walk.path, speed_um_s=walk.speed_um_s, seed=walk.seed), walk.turn_deg_s, REACH_DEG)
    raw = rig.recording(tissue(walk.scene, walk.seed), path, walk.frames, seed=walk.seed)
    angle = path.angles_rad(rig.periods_at_middle(walk.frames) * rig.instrument.optics.frame_period_s)
    place = rig.positions_px(path, walk.frames)
    return raw, (place - place[0]) @ turned_by(-float(angle[0])).T, angle - angle[0]


def follow(walk: Walk) -> Turned:
    """Record a walk, track it, and finish the track."""
    raw, place, angle = recorded(walk)
    rig = simulated_rig()
    pipeline = Pipeline(rig.calibration, rig.instrument.frame_shape)
    for index in range(walk.frames):
        pipeline.track(raw[index], index)
    since = next((k for k, pose in enumerate(pipeline.poses) if pose.angle != 0), None)
    strayed_px = _strayed_px(pipeline.rows, place, angle), _strayed_px(tracked_live(rig, raw), place, angle)
    pipeline.finish(RawPairs(raw, "els"))
    found = np.array([pose.angle for pose in pipeline.poses])
    known = np.isfinite([pose.row for pose in pipeline.poses])
    error = float(np.rad2deg(np.sqrt(np.mean((found - angle)[known] ** 2))))
    model = MotionModel.RIGID if found.any() else MotionModel.TRANSLATION
    largest, errors = float(np.rad2deg(np.abs(angle).max())), track_errors(pipeline.rows, place)
    return Turned(model, since, largest, error, errors, (*strayed_px, _strayed_px(pipeline.rows, place, angle)))


def _strayed_px(rows: Sequence[TrackPoint], true_px: NDArray[np.float64], true_angle: NDArray[np.float64]) -> float:
    """Largest distance of the longest segment's frames from the truth, its first one lying right."""
    tracked = [k for k, row in enumerate(rows) if row.state == TrackingState.TRACKED]
    longest, _ = Counter(rows[k].segment for k in tracked).most_common(1)[0]
    those = [k for k in tracked if rows[k].segment == longest]
    found = np.array([(rows[k].row_px, rows[k].col_px) for k in those])
    true = (true_px[those] - true_px[those[0]]) @ turned_by(-float(true_angle[those[0]])).T
    return float(np.hypot(*(found - found[0] - true).T).max())
