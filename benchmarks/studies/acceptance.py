"""Acceptance of registrations by the tracker itself, on whole recordings of rich, sparse, jerky and jolted motion.

Every frame goes through :class:`~napari_elsplus.processing.tracking.tracker.Tracker` as it does live, with the motion
prior that the tracker has built up by then. Counted are right registrations that it keeps, and wrong ones that it
accepts.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import cv2
import numpy as np

from benchmarks.rigs.simulated import simulated_rig
from napari_elsplus.processing.tracking.backward_tracking import completed
from napari_elsplus.processing.tracking.front_end.front_end import FrontEnd
from napari_elsplus.processing.tracking.front_end.grid import FIELD
from napari_elsplus.processing.tracking.methods import prepared_frames
from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.processing.tracking.pose_graph.graph import PoseGraph
from napari_elsplus.processing.tracking.pose_graph.nodes import NodeRegistration
from napari_elsplus.processing.tracking.pose_graph.refinement import refine
from napari_elsplus.processing.tracking.registration.pair_registration import Registrar
from napari_elsplus.processing.tracking.tracker import Tracker
from napari_elsplus.simulation.accuracy import WRONG_PX
from napari_elsplus.simulation.specimen.scenes import fibres, picture
from napari_elsplus.simulation.specimen.textures import draw_fibres
from napari_elsplus.simulation.specimen.trajectories import HandHeld, Recorded, Trajectory

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from benchmarks.rigs.simulated import SimulatedRig
    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.simulation.specimen.scenes import Scene

FRAMES: Final = 40
"""Frames of a recording; chosen: longer ones repeat what the tracker has learnt by then."""
HELD_OUT_SEEDS: Final = range(800, 820)
"""Seeds of the recordings that are reported; none of them was used to choose a constant."""
_SCENE_UM: Final = 4800.0
_SCENE_UM_PER_PX: Final = 2.0
_HALF_WIDTH_UM: Final = 4.0
_HALF_LENGTHS_UM: Final = (100.0, 400.0)
_RATES_HZ: Final = (240.0, 120.0, 60.0, 20.0)
_LONE_FIBRES: Final = 3
_LONE_SCENE_UM: Final = 1000.0
"""Square in which three fibres lie: about the path of 40 frames, so that one or two are in view."""
_SPEED_UM_S: Final = 3000.0
_SLOW_RATE_HZ: Final = 30.0
_SLOW_SPEED_UM_S: Final = 600.0
"""Frame rate below which the hand moves more slowly, so that 40 frames stay within the scene."""
_JERK_FRAMES: Final = 2
_JERK_PX: Final = 30.0
_JOLT_EVERY: Final = 9
_JOLTS_PX: Final = (60.0, 90.0)
"""Displacements of a jolt, camera pixels within one frame period."""
_UNEVEN_PX: Final = WRONG_PX / 4
"""Difference between the within-frame motions of two frames, camera pixels, root mean square, beyond which no affine
warp relates them and the pair is not counted among those that can be kept."""
_CORE_PX: Final = 1.2
CONSTRAINED: Final = 0.1
"""Least change of the view for a wrong shift: see :func:`change_of_view`. The blunt end of one fibre makes 0.3."""


@dataclass(frozen=True, slots=True)
class Row:
    """A scene, a motion and a frame rate.

    Parameters
    ----------
    fibres : int
        Fibres in the scene of 4.8 by 4.8 mm; 0 for rich tissue, 3 for as many near the path.
    motion : str
        ``hand``, ``jerky`` (a new velocity every other frame) or ``jolted`` (60 to 90 px within one frame, now and
        then).
    rate_hz : float
        Frame rate of the 240 Hz preset, idle time between frames included.
    """

    fibres: int
    motion: str
    rate_hz: float

    def __str__(self) -> str:
        scene = "rich" if not self.fibres else f"{self.fibres} fibres"
        return f"{scene}, {self.motion}, {self.rate_hz:g} Hz"


ROWS: Final = (
    *(Row(count, "hand", rate) for count in (0, 60) for rate in _RATES_HZ),
    Row(180, "hand", 240.0),
    Row(20, "hand", 240.0),
    Row(_LONE_FIBRES, "hand", 240.0),
    *(Row(count, "jerky", rate) for count in (0, 180, 60) for rate in (240.0, 60.0)),
    *(Row(count, "jolted", 240.0) for count in (0, 60)),
)  # fmt: skip


class TruePath(NamedTuple):
    """Images of a recording, and what is true of them.

    Parameters
    ----------
    images : numpy.ndarray
        (T, n, n) float32 tracking images.
    positions : numpy.ndarray
        (T, 2) of the probe, pixels of the grid.
    countable : numpy.ndarray
        (T - 1,) bool: successive frames that share enough structure, and moved evenly enough, for a right registration.
    """

    images: NDArray[np.float32]
    positions: NDArray[np.float64]
    countable: NDArray[np.bool_]


class Counts(NamedTuple):
    """Result of one or more recordings; sums and concatenations.

    Parameters
    ----------
    countable, kept : int
        Pairs of successive frames that constrain their shift; those of them that the tracker registered rightly.
    accepted, wrong, avoidable : int
        Registrations that the tracker accepted; those that are more than 3 camera px off; those of them between frames
        that constrain their shift.
    errors_px, normalised : numpy.ndarray
        Error of each accepted registration, camera px; of each finished position, over its stated standard deviation.
    drift_px, path_px : float
        Error from first to last frame of each segment, and path within them, camera px.
    segments : int
        Segments.
    """

    countable: int
    kept: int
    accepted: int
    wrong: int
    avoidable: int
    errors_px: NDArray[np.float64]
    normalised: NDArray[np.float64]
    drift_px: float
    path_px: float
    segments: int


def few_fibres(seed: int, count: int = 180, extent_um: float = _SCENE_UM) -> Scene:
    """Return straight fibres so far apart that some views show one of them, or none.

    They are smooth along their length: steps at their edges would constrain shifts along a fibre.

    Parameters
    ----------
    seed : int
        Seed of the scene.
    count : int
        Number of fibres.
    extent_um : float
        Side of the central square in which the middles of the fibres lie.
    """
    random = np.random.default_rng(seed)
    drawn = np.empty((count, 2, 4), np.float32)
    for ends in drawn:
        middle, angle = random.uniform(0, _SCENE_UM, 2), random.uniform(0, np.pi)
        middle = _SCENE_UM / 2 + (middle - _SCENE_UM / 2) * extent_um / _SCENE_UM
        along = random.uniform(*_HALF_LENGTHS_UM) * np.array([np.cos(angle), np.sin(angle)])
        ends[:, :2] = middle - along, middle + along
        ends[:, 2:] = _HALF_WIDTH_UM, random.uniform(0.5, 1.0)
    image = np.zeros((int(_SCENE_UM / _SCENE_UM_PER_PX),) * 2, np.float32)
    draw_fibres(image, 0.0, 0.0, _SCENE_UM_PER_PX, drawn)
    return picture(cv2.GaussianBlur(image, (0, 0), 1.0), _SCENE_UM_PER_PX)


def jerky(rig: SimulatedRig, frames: int, seed: int) -> Recorded:
    """Return a path whose velocity goes, every other frame, for a new value that lies tens of pixels from the last."""
    random = np.random.default_rng(seed)
    t = np.arange(0, frames + 2, 1 / 16)
    knots = random.normal(20.0, _JERK_PX, (frames // _JERK_FRAMES + 4, 2))
    velocity = np.stack([np.interp(t / _JERK_FRAMES, np.arange(len(knots)), knot) for knot in knots.T], axis=1)
    path_um = np.cumsum(velocity, axis=0) / 16 * rig.um_per_px
    return Recorded(t * rig.instrument.optics.frame_period_s, path_um - path_um[0])


def jolted(rig: SimulatedRig, frames: int, seed: int) -> Recorded:
    """Return the path of a hand that is jolted by 60 to 90 px within one frame period, about every ninth frame."""
    random = np.random.default_rng(seed)
    t = np.arange(0, frames + 2, 1 / 16)
    times_s = t * rig.instrument.optics.frame_period_s
    path_um = HandHeld(_SPEED_UM_S, seed=seed).positions_um(times_s)
    for begin in np.arange(_JOLT_EVERY, frames, _JOLT_EVERY) + 0.0:
        begin += random.uniform(-2, 2)
        angle, px = random.uniform(0, 2 * np.pi), random.uniform(*_JOLTS_PX)
        done = np.clip(t - begin, 0, 1)
        done = done**2 * (3 - 2 * done)
        path_um += done[:, None] * px * rig.um_per_px * np.array([np.sin(angle), np.cos(angle)])
    return Recorded(times_s, path_um)


def recorded(row: Row, seed: int, frames: int = FRAMES) -> TruePath:
    """Simulate a recording of a row.

    Parameters
    ----------
    row : Row
        Scene, motion and frame rate.
    seed : int
        Seed of scene, motion and noise.
    frames : int
        Number of frames.
    """
    rig = simulated_rig(rate_hz=row.rate_hz)
    path: Trajectory
    if row.motion == "hand":
        path = HandHeld(_SLOW_SPEED_UM_S if row.rate_hz < _SLOW_RATE_HZ else _SPEED_UM_S, seed=seed)
    else:
        path = {"jerky": jerky, "jolted": jolted}[row.motion](rig, frames, seed)
    path = _centred(path, rig, frames)
    extent_um = _LONE_SCENE_UM if row.fibres == _LONE_FIBRES else _SCENE_UM
    scene = few_fibres(seed, row.fibres, extent_um) if row.fibres else fibres(seed)
    images = np.stack(rig.tracking_images(rig.recording(scene, path, frames, seed=seed)))
    grid = grid_of(row)
    positions = rig.positions_px(path, frames) / grid.binning
    even = _unevenness_px(rig, path, frames, grid) < _UNEVEN_PX
    if row.fibres:
        even &= change_of_view(scene, positions, grid, grid.binning * rig.um_per_px) > CONSTRAINED
    overlap = np.hypot(*np.diff(positions, axis=0).T) < 0.6 * grid.diameter
    return TruePath(images, positions, even & overlap)


def _centred(path: Trajectory, rig: SimulatedRig, frames: int) -> Recorded:
    """Return a path about the middle of the scene, which it then does not leave."""
    times_s = np.arange(0, frames + 1, 1 / 16) * rig.instrument.optics.frame_period_s
    path_um = path.positions_um(times_s)
    return Recorded(times_s, path_um - (path_um.max(axis=0) + path_um.min(axis=0)) / 2)


def grid_of(row: Row) -> Grid:
    """Return the grid of a row's tracking images."""
    rig = simulated_rig(rate_hz=row.rate_hz)
    return FrontEnd(rig.calibration, rig.instrument.frame_shape).grid


def _unevenness_px(rig: SimulatedRig, path: Trajectory, frames: int, grid: Grid) -> NDArray[np.float64]:
    """Return how differently successive frames are distorted beyond an affine warp, (T - 1,), camera px, rms."""
    reach = 0.5 * grid.diameter / grid.shutter.line_periods_per_frame
    within = np.linspace(-reach, reach, 15)
    periods = np.maximum(rig.periods_at_middle(frames)[:, None] + within, 0)
    times_s = np.asarray(periods.ravel() * rig.instrument.optics.frame_period_s, np.float64)
    places = path.positions_um(times_s).reshape(frames, len(within), 2) / rig.um_per_px
    places -= places.mean(axis=1, keepdims=True)
    slopes = (within[:, None] * places).sum(axis=1) / (within**2).sum()
    bent = places - slopes[:, None] * within[:, None]
    unevenness: NDArray[np.float64] = np.sqrt((np.diff(bent, axis=0) ** 2).sum(axis=2).mean(axis=1))
    return unevenness


def change_of_view(looked_at: Scene, places: NDArray[np.float64], grid: Grid, um_per_px: float) -> NDArray[np.float64]:
    """Change of the overlap of successive frames by a shift that is just wrong, in the least constrained direction.

    Parameters
    ----------
    looked_at : Scene
        Its first plane is in focus, seen through cores that blur it.
    places : numpy.ndarray
        (T, 2) positions of the probe, pixels of the grid.
    grid : Grid
        Of the tracked images.
    um_per_px : float
        Size of its pixels.

    Returns
    -------
    numpy.ndarray
        (T - 1,) sum of squared changes over the pixels that both frames show, a fibre of full brightness being 1.
    """
    texture, radius = looked_at.planes[0].texture, 0.5 * FIELD * grid.diameter
    wrong_px = WRONG_PX / grid.binning
    reach = np.arange(-int(radius) - 4, int(radius) + 5, dtype=np.float64)
    y, x = np.meshgrid(reach, reach, indexing="ij")
    changes = []
    for before, after in itertools.pairwise(places):
        (row, col), (down, across) = (before + after) / 2, (after - before) / 2
        view = texture.sample((row + reach) * um_per_px, (col + reach) * um_per_px)
        seen = cv2.GaussianBlur(np.asarray(view, np.float32), (0, 0), _CORE_PX)
        shared = np.maximum(np.hypot(y - down, x - across), np.hypot(y + down, x + across)) < radius - 2
        slopes = np.stack([slope[shared] for slope in np.gradient(seen)])
        changes.append(wrong_px**2 * float(np.linalg.eigvalsh(slopes @ slopes.T)[0]))
    return np.array(changes)


def tracked(recording: TruePath, grid: Grid) -> Counts:
    """Track a recording and compare every accepted registration with the truth."""
    tracker = Tracker(Registrar(grid))
    poses = []
    for image in recording.images:
        tracker.slot()[:] = image
        poses.append(tracker.add())
    poses, links = completed(poses, tracker, recording.images.__getitem__)
    frame = prepared_frames(tracker.registrar, recording.images.__getitem__, len(poses))
    finished = refine(poses, links, PoseGraph(NodeRegistration(tracker.registrar), frame), tracker.model)
    true, errors, right, avoidable = recording.positions, [], set(), 0
    for earlier, later, moved, *_ in links:
        miss = np.array(moved) - (true[later] - true[earlier])
        errors.append(float(np.hypot(*miss)) * grid.binning)
        if later == earlier + 1 and errors[-1] <= WRONG_PX:
            right.add(earlier)
        avoidable += errors[-1] > WRONG_PX and bool(recording.countable[earlier:later].all())
    places = np.array([(pose.row, pose.col) for pose in poses])
    segment = np.array([pose.segment if pose.state is TrackingState.TRACKED else -1 for pose in poses])
    same = (segment[1:] == segment[:-1]) & (segment[1:] >= 0)
    step_error = np.hypot(*(np.diff(places, axis=0) - np.diff(true, axis=0)).T) * grid.binning
    kept = (same & (step_error <= WRONG_PX)) | np.isin(np.arange(len(true) - 1), list(right))
    drift = path = 0.0
    for number in np.unique(segment[segment >= 0]):
        first, last = np.flatnonzero(segment == number)[[0, -1]]
        drift += grid.binning * float(np.hypot(*(places[last] - places[first] - true[last] + true[first])))
        path += grid.binning * float(np.hypot(*np.diff(true[first : last + 1], axis=0).T).sum())
    return Counts(
        int(recording.countable.sum()), int((kept & recording.countable).sum()), len(errors),
        sum(error > WRONG_PX for error in errors), avoidable, np.array(errors), normalised_errors(finished, true),
        drift, path, len(np.unique(segment[segment >= 0])),
    )  # fmt: skip


def normalised_errors(poses: Sequence[Pose], true: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return errors of a finished track over what is stated, of each frame against the one tracked before it.

    Parameters
    ----------
    poses : sequence of Pose
        One for every frame.
    true : numpy.ndarray
        (T, 2) positions, pixels of the grid.
    """
    errors = np.array([pose.at for pose in poses]) - true @ (1, 1j)
    segment = np.array([pose.segment if pose.state is TrackingState.TRACKED else -1 for pose in poses])
    each = [np.flatnonzero(segment == number) for number in np.unique(segment[segment >= 0])]
    sigma = np.array([pose.sigma for pose in poses])
    return np.concatenate([abs(np.diff(errors[own])) / sigma[own[1:]] for own in each] or [np.zeros(0)])


def total(counts: Iterable[Counts]) -> Counts:
    """Return the counts of several recordings together."""

    def added(values: Sequence[Any]) -> Any:
        return np.concatenate(values) if isinstance(values[0], np.ndarray) else sum(values)

    return Counts(*map(added, zip(*counts, strict=True)))


def measure(row: Row, seeds: Iterable[int] = HELD_OUT_SEEDS, frames: int = FRAMES) -> Counts:
    """Track the recordings of a row."""
    grid = grid_of(row)
    return total(tracked(recorded(row, seed, frames), grid) for seed in seeds)


def counted(found: Mapping[Row, Counts]) -> str:
    """Return a sentence: wrong registrations in rows of rich tissue, in those with fibres, and of these of a hand."""
    groups = {
        "of rich tissue": [c for row, c in found.items() if not row.fibres],
        "with fibres": [c for row, c in found.items() if row.fibres],
        "with fibres and a hand": [c for row, c in found.items() if row.fibres and row.motion == "hand"],
    }
    sums = {name: total(counts) for name, counts in groups.items() if counts}
    parts = (
        f"{c.wrong} of {c.accepted} registrations in the rows {name} ({c.avoidable} between frames that are counted)"
        for name, c in sums.items()
    )
    return f"Wrong are {'; '.join(parts)}."


def acceptance_table(rows: Iterable[Row] = ROWS, seeds: Iterable[int] = HELD_OUT_SEEDS) -> list[str]:
    """Return a sentence of counts and the lines of a table of all rows."""
    chosen = list(seeds)
    found = {row: measure(row, chosen) for row in rows}
    lines = [
        counted(found),
        "",
        "| scene, motion, frame rate | pairs | kept | registrations accepted | wrong | median error (px) "
        "| rms error over stated standard deviation | drift (% of path) | segments |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row, c in found.items():
        median, scatter = (
            (float(np.median(c.errors_px)), float(np.sqrt(np.mean(c.normalised**2) / 2))) if c.accepted else (0.0, 0.0)
        )
        lines.append(
            f"| {row} | {c.countable} | {100 * c.kept / max(c.countable, 1):.1f} % | {c.accepted} | {c.wrong} "
            f"| {median:.3f} | {scatter:.2f} | {100 * c.drift_px / max(c.path_px, 1e-9):.3f} | {c.segments} |"
        )
    return lines
