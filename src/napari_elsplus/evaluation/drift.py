"""How far the track strays over thousands of pixels: as frames come, and once loops are closed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.evaluation.rig import measured
from napari_elsplus.evaluation.stability.pairs import ELECTRONS_OF_WHITE, WHITE_DN
from napari_elsplus.processing.sectioning import Mode
from napari_elsplus.simulation.instrument import Instrument
from napari_elsplus.simulation.scenes import scene
from napari_elsplus.simulation.trajectories import Recorded, Straight
from napari_elsplus.tracking_pipeline import Pipeline, RawPairs

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.evaluation.rig import SimulatedRig
    from napari_elsplus.simulation.trajectories import Trajectory

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
    live_percent, graph_percent : float
        As frames came; after loops were closed and all positions solved for at once.
    tracked : float
        Share of the frames that were tracked.
    """

    path_px: float
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
    rig = measured(Instrument.of("240hz", electrons_per_dn=ELECTRONS_OF_WHITE / WHITE_DN, read_noise_e=2.0))
    path: Trajectory = rounds(rig, frames) if back else Straight(SPEED_UM_S)
    raw = rig.recording(scene(scene_name), path, frames, seed=1)
    pairs, pipeline = RawPairs(raw, Mode.ELS), Pipeline(rig.calibration, rig.instrument.frame_shape)
    for index in range(frames):
        pipeline.track(raw[index], index)
    true_px = rig.positions_px(path, frames)
    length_px = float(np.hypot(*np.diff(true_px, axis=0).T).sum())
    live = _strayed_px(pipeline, true_px)
    pipeline.finish(pairs)
    tracked = float(np.mean([row.state == "tracked" for row in pipeline.rows]))
    return Drift(length_px, 100 * live / length_px, 100 * _strayed_px(pipeline, true_px) / length_px, tracked)


def _strayed_px(pipeline: Pipeline, true_px: NDArray[np.float64]) -> float:
    first, last = pipeline.rows[0], pipeline.rows[-1]
    if first.segment != last.segment:
        return float("nan")
    found = np.array([last.row_px - first.row_px, last.col_px - first.col_px])
    return float(np.hypot(*(found - (true_px[-1] - true_px[0]))))
