"""Acceptance test of registrations in low-texture scenes: wrong ones rejected, right ones kept."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np

from benchmarks.rigs.simulated import simulated_rig
from napari_elsplus.processing.tracking.front_end.front_end import FrontEnd
from napari_elsplus.processing.tracking.front_end.grid import FIELD
from napari_elsplus.processing.tracking.motion.prediction import UNEVEN, needed_times, surprise_of, unevenly
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity
from napari_elsplus.processing.tracking.motion.warp_prior import warp_prior
from napari_elsplus.processing.tracking.registration.low_texture import DOUBT, LowTextureFallback, unlit
from napari_elsplus.processing.tracking.registration.pair_registration import Registrar
from napari_elsplus.processing.tracking.tracker import SURE_CORRELATION
from napari_elsplus.simulation.accuracy import WRONG_PX
from napari_elsplus.simulation.specimen.scenes import picture
from napari_elsplus.simulation.specimen.textures import draw_fibres
from napari_elsplus.simulation.specimen.trajectories import Recorded, trajectory

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from benchmarks.rigs.simulated import SimulatedRig
    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.motion.warp_prior import WarpPrior
    from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, PreparedFrame
    from napari_elsplus.simulation.specimen.scenes import Scene
    from napari_elsplus.simulation.specimen.trajectories import Trajectory

SMOOTH_PX: Final = 4.0
JERKY_PX: Final = 12.0
"""Error of the starting shift, root mean square in each direction, pixels of the tracking grid."""
_SCENE_UM: Final = 4800.0
_SCENE_UM_PER_PX: Final = 2.0
_HALF_WIDTH_UM: Final = 4.0
_HALF_LENGTHS_UM: Final = (100.0, 400.0)
_SPEED_UM_S: Final = 3000.0
_SMOOTH_SPREAD_PX: Final = 2.7
"""Spread of the velocity that the tracker learns from smooth motion."""
_VELOCITY_SIGMA_PX: Final = 0.3
"""Standard deviation of the earlier frame's velocity."""
_JERK_FRAMES: Final = 2
_JERK_PX: Final = 30.0
_UNEVEN_PX: Final = WRONG_PX / 4
"""Error from within-frame acceleration, camera pixels, up to which registrations are judged."""
_CORE_PX: Final = 1.2
TOLD: Final = 0.1
"""Least change of the view for a wrong shift: see :func:`change_of_view`. The blunt end of one fibre makes 0.3."""


class Judged(NamedTuple):
    """A link between two frames, with and without a second look.

    Parameters
    ----------
    correlation, first_certainty : float
        At first sight.
    certainty : float
        In the end; what is needed is 1.
    error_px : float
        How wrong it is in the end, camera pixels.
    first_error_px : float
        The same at first sight.
    accepted : bool
        What the gate says in the end.
    told : bool
        Whether both frames share anything that tells the shift in every direction.
    last_correlation : float
        In the end.
    """

    correlation: float
    first_certainty: float
    certainty: float
    error_px: float
    first_error_px: float
    accepted: bool
    told: bool
    last_correlation: float


class Gate(NamedTuple):
    """Result of the acceptance test on many registrations.

    Parameters
    ----------
    wrong, right : int
        Links more than 3 px off; and less than half of that, where the frames tell the shift.
    caught_percent, kept_percent : float
        Wrong ones that were refused, and right ones that were not.
    first_caught_percent, first_kept_percent : float
        The same without a second look, of the links that were wrong and right then.
    """

    wrong: int
    right: int
    caught_percent: float
    kept_percent: float
    first_caught_percent: float
    first_kept_percent: float


def few_fibres(seed: int, count: int = 180) -> Scene:
    """Straight fibres so far apart that some views show one of them, or none.

    They are smooth along their length: steps at their edges, as a line drawn without care has them, would tell shifts
    along a fibre, up to whole steps.
    """
    random = np.random.default_rng(seed)
    fibres = np.empty((count, 2, 4), np.float32)
    for ends in fibres:
        middle, angle = random.uniform(0, _SCENE_UM, 2), random.uniform(0, np.pi)
        along = random.uniform(*_HALF_LENGTHS_UM) * np.array([np.cos(angle), np.sin(angle)])
        ends[:, :2] = middle - along, middle + along
        ends[:, 2:] = _HALF_WIDTH_UM, random.uniform(0.5, 1.0)
    image = np.zeros((int(_SCENE_UM / _SCENE_UM_PER_PX),) * 2, np.float32)
    draw_fibres(image, 0.0, 0.0, _SCENE_UM_PER_PX, fibres)
    return picture(cv2.GaussianBlur(image, (0, 0), 1.0), _SCENE_UM_PER_PX)


def jerky(rig: SimulatedRig, frames: int, seed: int) -> Recorded:
    """Return a path whose velocity goes, every other frame, for a new value that lies tens of pixels from the last."""
    random = np.random.default_rng(seed)
    t = np.arange(0, frames + 2, 1 / 16)
    knots = random.normal(20.0, _JERK_PX, (frames // _JERK_FRAMES + 4, 2))
    velocity = np.stack([np.interp(t / _JERK_FRAMES, np.arange(len(knots)), knot) for knot in knots.T], axis=1)
    path_um = np.cumsum(velocity, axis=0) / 16 * rig.um_per_px
    return Recorded(t * rig.instrument.optics.frame_period_s, path_um - path_um[0])


def judged_links(frames: int, seeds: Sequence[int] | int, fibres: int = 180, *, jerks: bool = False) -> list[Judged]:
    """Register successive frames of sparse scenes, each started some pixels off, and compare with the truth.

    Each pair is linked twice, as the tracker does: from a guess, and by a search over all shifts. Pairs between which
    the probe moved so unevenly that no link could be right are left out: the tracker tells them by their velocities.

    Parameters
    ----------
    frames : int
        Of each recording.
    seeds : int or sequence of int
        Of the recordings.
    fibres : int
        In the scene of 4.8 by 4.8 mm; the fewer, the less there is to see.
    jerks : bool
        Whether the probe jerks, and links start farther off; else a hand moves it smoothly at 3 mm/s.
    """
    rig = simulated_rig()
    judged: list[Judged] = []
    for seed in range(seeds) if isinstance(seeds, int) else seeds:
        path = jerky(rig, frames, seed) if jerks else trajectory("hand", speed_um_s=_SPEED_UM_S, seed=seed)
        judged += _links(rig, path, few_fibres(seed, fibres), frames, seed, jerks=jerks)
    return judged


def _links(
    rig: SimulatedRig, path: Trajectory, looked_at: Scene, frames: int, seed: int, *, jerks: bool
) -> Iterator[Judged]:
    front_end = FrontEnd(rig.calibration, rig.instrument.frame_shape)
    grid = front_end.grid
    registrar, shutter, binning = Registrar(grid), grid.shutter, grid.binning
    second = LowTextureFallback(registrar)
    views = []
    for frame in rig.recording(looked_at, path, frames, seed=seed):
        view = registrar.view()
        front_end.image(frame, view.image)
        views.append(registrar.prepare(view))
    places = rig.positions_px(path, frames) / binning
    changes = change_of_view(looked_at, places, grid, binning * rig.um_per_px)
    velocities = _velocities(rig, path, frames, grid)
    random = np.random.default_rng(seed)
    off_px, spread_px = (JERKY_PX, JERKY_PX) if jerks else (SMOOTH_PX, _SMOOTH_SPREAD_PX)
    trust_px = float(np.hypot(_VELOCITY_SIGMA_PX, unevenly(surprise_of(spread_px))))
    for k, step in enumerate(np.diff(places, axis=0)):
        guess = step + random.normal(0, off_px, 2)
        before = velocities[k] + random.normal(0, _VELOCITY_SIGMA_PX, 2)
        jerk = np.diff(places[max(0, k - 1) : k + 3], 3, axis=0)
        if UNEVEN * binning * np.hypot(*jerk.T).max(initial=0.0) > _UNEVEN_PX:
            continue
        known = warp_prior(
            shutter, (Velocity(*before), Velocity(*(2 * guess - before))), Displacement(*guess), spread_px,
            trust_px,
        )  # fmt: skip
        for first, last in _looks(registrar, second, (views[k], views[k + 1]), known, spread_px):
            errors = []
            for link in (first, last):
                found = shutter.displacement(link.warp, shutter.velocities(link.warp)[1])
                errors.append(float(np.hypot(*(np.array(found) - step))) * binning)
            times = needed_times(spread_px)
            needed = times if last is first else 1.0
            accepted = last.stands(needed) and last.correlation > SURE_CORRELATION
            yield Judged(
                first.correlation, first.certainty / times, last.certainty / needed, errors[1], errors[0], accepted,
                bool(changes[k] > TOLD), last.correlation,
            )  # fmt: skip


def _looks(
    registrar: Registrar,
    second: LowTextureFallback,
    pair: tuple[PreparedFrame, PreparedFrame],
    known: WarpPrior,
    spread_px: float,
) -> Iterator[tuple[PairRegistration, PairRegistration]]:
    """Register two frames both ways; each time the link at first sight, and the one in the end."""
    spread = (spread_px / registrar.grid.shutter.line_periods_per_frame,) * 2
    link = registrar.link(*pair, known.expected, spread)
    yield link, link if link.evidence >= DOUBT else second.link(*pair, known) or unlit(link)
    found = registrar.search(*pair, known.expected, spread, 2 * SMOOTH_PX)
    if found is not None:
        yield found, found if found.evidence >= DOUBT else second.search(*pair, known, 2 * SMOOTH_PX) or unlit(found)


def _velocities(rig: SimulatedRig, path: Trajectory, frames: int, grid: Grid) -> NDArray[np.float64]:
    """Velocity of the probe while each frame's disc is read, pixels of the grid per frame."""
    reach = 0.5 * grid.diameter / grid.shutter.line_periods_per_frame
    within = np.linspace(-reach, reach, 15)
    centre_row = grid.origin[0] + grid.binning * grid.centre[0] + (grid.binning - 1) / 2
    middle = centre_row / (grid.binning * grid.shutter.line_periods_per_frame)
    periods = np.maximum(np.arange(frames)[:, None] + middle + within, 0)
    times_s = np.asarray(periods.ravel() * rig.instrument.optics.frame_period_s, np.float64)
    places = path.positions_um(times_s).reshape(frames, len(within), 2) / (rig.um_per_px * grid.binning)
    slopes: NDArray[np.float64] = (within[:, None] * places).sum(axis=1) / (within**2).sum()
    return slopes


def change_of_view(looked_at: Scene, places: NDArray[np.float64], grid: Grid, um_per_px: float) -> NDArray[np.float64]:
    """Change of the overlap of successive frames by a shift that is just wrong, in the least constrained direction.

    Parameters
    ----------
    looked_at : Scene
        Its first plane is looked at, through cores that blur it.
    places : numpy.ndarray
        (T, 2) where the probe was, pixels of the grid.
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
    for before, after in pairwise(places):
        (row, col), (down, across) = (before + after) / 2, (after - before) / 2
        view = texture.sample((row + reach) * um_per_px, (col + reach) * um_per_px)
        seen = cv2.GaussianBlur(np.asarray(view, np.float32), (0, 0), _CORE_PX)
        shared = np.maximum(np.hypot(y - down, x - across), np.hypot(y + down, x + across)) < radius - 2
        slopes = np.stack([slope[shared] for slope in np.gradient(seen)])
        changes.append(wrong_px**2 * float(np.linalg.eigvalsh(slopes @ slopes.T)[0]))
    return np.array(changes)


def gate(links: Sequence[Judged]) -> Gate:
    """Count what the gate caught and kept.

    Examples
    --------
    >>> good = Judged(0.99, 0.5, 3.0, 0.1, 0.1, True, True, 0.99)
    >>> slid = Judged(0.98, 0.1, 0.2, 9.0, 9.0, False, True, 0.98)
    >>> gate([good, slid, slid._replace(accepted=True)])
    Gate(wrong=2, right=1, caught_percent=50.0, kept_percent=100.0, first_caught_percent=100.0, first_kept_percent=0.0)
    """
    table = np.array(links)
    told, accepted, first = table[:, 6] > 0, table[:, 5] > 0, table[:, 1] >= 1
    (right, wrong), (first_right, first_wrong) = (
        ((error < WRONG_PX / 2) & told, error > WRONG_PX) for error in (table[:, 3], table[:, 4])
    )
    return Gate(
        int(wrong.sum()),
        int(right.sum()),
        100 * _part(~accepted, wrong),
        100 * _part(accepted, right),
        100 * _part(~first, first_wrong),
        100 * _part(first, first_right),
    )


def _part(of: NDArray[np.bool_], among: NDArray[np.bool_]) -> float:
    return float(of[among].mean()) if among.any() else float("nan")
