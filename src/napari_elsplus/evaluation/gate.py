"""Whether the tracker's gate tells wrong links from right ones, where there is little to see."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np

from napari_elsplus.evaluation.against_truth import WRONG_PX
from napari_elsplus.evaluation.rig import simulated_rig
from napari_elsplus.processing.tracking.frontend import FrontEnd
from napari_elsplus.processing.tracking.motion import Velocity
from napari_elsplus.processing.tracking.registration import Registrar
from napari_elsplus.processing.tracking.tracker import needed_evidence
from napari_elsplus.simulation.scenes import picture
from napari_elsplus.simulation.trajectories import Recorded, trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.evaluation.rig import SimulatedRig
    from napari_elsplus.processing.tracking.registration import View
    from napari_elsplus.simulation.scenes import Scene
    from napari_elsplus.simulation.trajectories import Trajectory

SMOOTH_PX: Final = 4.0
JERKY_PX: Final = 12.0
"""How far links start from the truth, root mean square in each direction, pixels of the tracking grid."""
_SCENE_PX: Final = 2400
_SCENE_UM_PER_PX: Final = 2.0
_SPEED_UM_S: Final = 3000.0
_FEWEST_SPREAD_PX: Final = 2.7
"""Spread of the velocity that the tracker learns from smooth motion."""
_JERK_FRAMES: Final = 2
_JERK_PX: Final = 30.0


class Judged(NamedTuple):
    """A link between two frames: its evidence over what the gate asks for, its correlation, and how wrong it is."""

    evidence: float
    correlation: float
    error_px: float
    accepted: bool


class Gate(NamedTuple):
    """What the gate made of many links.

    Parameters
    ----------
    wrong, right : int
        Links more than 3 px off, and less than half of that.
    caught_percent, kept_percent : float
        Wrong ones that were refused, and right ones that were not.
    caught_by_correlation_percent : float
        Wrong ones that a limit on the correlation would refuse that keeps as many of the right ones.
    """

    wrong: int
    right: int
    caught_percent: float
    kept_percent: float
    caught_by_correlation_percent: float


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


def jerky(rig: SimulatedRig, frames: int, seed: int) -> Recorded:
    """Return a path whose velocity goes, every other frame, for a new value that lies tens of pixels from the last."""
    random = np.random.default_rng(seed)
    t = np.arange(0, frames + 2, 1 / 16)
    knots = random.normal(20.0, _JERK_PX, (frames // _JERK_FRAMES + 4, 2))
    velocity = np.stack([np.interp(t / _JERK_FRAMES, np.arange(len(knots)), knot) for knot in knots.T], axis=1)
    path_um = np.cumsum(velocity, axis=0) / 16 * rig.um_per_px
    return Recorded(t * rig.instrument.optics.frame_period_s, path_um - path_um[0])


def judged_links(frames: int, seeds: int, fibres: int = 180, *, jerks: bool = False) -> list[Judged]:
    """Link successive frames of sparse scenes, each started some pixels off, and compare with the truth.

    Each pair is linked twice, as the tracker does: from a guess, and by a search over all shifts.

    Parameters
    ----------
    frames, seeds : int
        Frames of each recording, and how many recordings.
    fibres : int
        In the scene of 4.8 by 4.8 mm; the fewer, the less there is to see.
    jerks : bool
        Whether the probe jerks, and links start farther off; else a hand moves it smoothly at 3 mm/s.
    """
    rig = simulated_rig()
    judged = []
    for seed in range(seeds):
        path = jerky(rig, frames, seed) if jerks else trajectory("hand", speed_um_s=_SPEED_UM_S, seed=seed)
        judged += _links(rig, path, few_fibres(seed, fibres), frames, seed, JERKY_PX if jerks else SMOOTH_PX)
    return judged


def _links(
    rig: SimulatedRig, path: Trajectory, looked_at: Scene, frames: int, seed: int, off_px: float
) -> list[Judged]:
    front_end = FrontEnd(rig.calibration, rig.instrument.frame_shape)
    registrar, shutter, binning = Registrar(front_end.grid), front_end.grid.shutter, front_end.grid.binning
    views = []
    for frame in rig.recording(looked_at, path, frames, seed=seed):
        view = registrar.view()
        front_end.image(frame, view.image)
        views.append(registrar.prepare(view))
    true = rig.positions_px(path, frames) / binning
    random = np.random.default_rng(seed)
    spread_px = max(_FEWEST_SPREAD_PX, off_px if off_px > SMOOTH_PX else 0.0)
    judged = []
    for k, step in enumerate(np.diff(true, axis=0)):
        guess = Velocity(*(step + random.normal(0, off_px, 2)).tolist())
        expected = shutter.warp(guess, guess, shutter.step(guess, guess))
        spread = (spread_px / shutter.rows_per_frame,) * 2
        pair: tuple[View, View] = (views[k], views[k + 1])
        for link in (registrar.link(*pair, expected, spread), registrar.search(*pair, expected, spread, 2 * SMOOTH_PX)):
            if link is None:
                continue
            found = shutter.displacement(link.warp, shutter.velocities(link.warp)[1])
            error = float(np.hypot(*(np.array(found) - step))) * binning
            accepted = link.observed and link.evidence >= needed_evidence(spread_px)
            judged.append(Judged(link.evidence, link.correlation, error, accepted))
    return judged


def gate(links: Sequence[Judged]) -> Gate:
    """Count what the gate caught and kept.

    Examples
    --------
    >>> gate([Judged(0.5, 0.99, 0.1, True), Judged(0.01, 0.98, 9.0, False), Judged(0.3, 0.97, 8.0, True)])
    Gate(wrong=2, right=1, caught_percent=50.0, kept_percent=100.0, caught_by_correlation_percent=100.0)
    """
    correlation, error = np.array([(link.correlation, link.error_px) for link in links]).T
    accepted = np.array([link.accepted for link in links])
    wrong, right = error > WRONG_PX, error < WRONG_PX / 2
    kept = _part(accepted, right)
    limit = np.quantile(correlation[right], 1 - kept) if right.any() else np.nan
    return Gate(
        int(wrong.sum()),
        int(right.sum()),
        100 * _part(~accepted, wrong),
        100 * kept,
        100 * _part(correlation < limit, wrong),
    )


def _part(of: NDArray[np.bool_], among: NDArray[np.bool_]) -> float:
    return float(of[among].mean()) if among.any() else float("nan")
