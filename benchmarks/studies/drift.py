"""Drift of the track over thousands of pixels: frame to frame, with live loop closure, and after the pose graph."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from benchmarks.rigs.simulated import dim
from benchmarks.stability.pairs import ELECTRONS_OF_WHITE
from napari_elsplus.acquisition.mosaic.tracking import LiveTrack
from napari_elsplus.acquisition.streaming.ring import Stamp
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.specimen.trajectories import Recorded, Straight
from napari_elsplus.workflows.sectioning import RawPairs
from napari_elsplus.workflows.tracking import Pipeline

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from benchmarks.rigs.simulated import SimulatedRig
    from napari_elsplus.io import TrackPoint
    from napari_elsplus.simulation.specimen.trajectories import Trajectory

SPEED_UM_S: Final = 8_000.0
_RADIUS_UM: Final = 300.0
_WIDENS: Final = 0.1
"""Part by which the rounds widen from the first to the last."""


class Drift(NamedTuple):
    """Distance from the true path at its end, in % of its length.

    Parameters
    ----------
    path_px : float
        Length of the path, camera pixels.
    alone_percent, live_percent, graph_percent : float
        From frame to frame alone; with loops closed as the live mosaic does it; after the graph of all frames.
    tracked : float
        Share of the frames that were tracked.
    """

    path_px: float
    alone_percent: float
    live_percent: float
    graph_percent: float
    tracked: float


def rounds(rig: SimulatedRig, frames: int) -> Recorded:
    """Return rounds about one place, slowly widening, at an even speed."""
    period_s = rig.instrument.optics.frame_period_s
    frame = np.arange(0, frames + 2, 1 / 16)
    angle = SPEED_UM_S * period_s / _RADIUS_UM * frame
    radius = _RADIUS_UM * (1 + _WIDENS * frame / frames)
    return Recorded(frame * period_s, np.column_stack([radius * np.sin(angle), radius * (1 - np.cos(angle))]))


def drift(scene_name: str, *, back: bool, frames: int = 230) -> Drift:
    """Track a long recording in dim light and compare its end with the truth.

    Parameters
    ----------
    scene_name : str
        A textured scene.
    back : bool
        Whether the probe goes round and comes back; else it goes straight on.
    frames : int
        How many.
    """
    rig = dim(ELECTRONS_OF_WHITE)
    path: Trajectory = rounds(rig, frames) if back else Straight(SPEED_UM_S)
    raw = rig.recording(scene(scene_name), path, frames, seed=1)
    pairs, pipeline = RawPairs(raw, Mode.ELS), Pipeline(rig.calibration, rig.instrument.frame_shape)
    for index in range(frames):
        pipeline.track(raw[index], index)
    true_px = rig.positions_px(path, frames)
    length_px = float(np.hypot(*np.diff(true_px, axis=0).T).sum())
    strayed_px = [_strayed_px(pipeline.rows, true_px), _strayed_px(tracked_live(rig, raw), true_px)]
    pipeline.finish(pairs)
    strayed_px.append(_strayed_px(pipeline.rows, true_px))
    tracked = float(np.mean([row.state == "tracked" for row in pipeline.rows]))
    alone, closed, graph = (100 * px / length_px for px in strayed_px)
    return Drift(length_px, alone, closed, graph, tracked)


def tracked_live(rig: SimulatedRig, raw: NDArray[np.uint8]) -> list[TrackPoint]:
    """Track a recording as the live mosaic does, loops closed while frames come, and return its rows."""
    live = LiveTrack(rig.calibration, rig.instrument.frame_shape)
    for index, frame in enumerate(raw):
        time_s = index * rig.instrument.optics.frame_period_s
        live.add(frame, Stamp(index, time_s, time_s, index))
    live.settle()
    live.close()
    return live.pipeline.rows


def _strayed_px(rows: Sequence[TrackPoint], true_px: NDArray[np.float64]) -> float:
    first, last = rows[0], rows[-1]
    if first.segment != last.segment:
        return float("nan")
    found = np.array([last.row_px - first.row_px, last.col_px - first.col_px])
    return float(np.hypot(*(found - (true_px[-1] - true_px[0]))))
