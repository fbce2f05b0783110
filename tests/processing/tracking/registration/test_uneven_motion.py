from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from motion_priors import about
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.middle_rows import (
    WITHIN_FRAMES,
    at_middle_rows,
    mean_shifts,
    of_mean_places,
)
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, RollingShutter, Velocity, Warp
from napari_elsplus.processing.tracking.registration.pair_registration import (
    PairRegistration,
    PreparedFrame,
    Registrar,
    TrackedPair,
)

ROWS_PER_FRAME = 272.0
GRID = Grid(236, 1, (0, 0), (117.5, 117.5), 232.0, RollingShutter(ROWS_PER_FRAME))
MOVED = 5.0, -3.0


def tissue(seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(400, 400)).astype(np.float32)
    scene = cv2.GaussianBlur(noise, (0, 0), 4.0)
    return 40.0 * scene / scene.std()


def read_while_moving(registrar: Registrar, scene: np.ndarray, shift: tuple[float, ...], jerk: float) -> PreparedFrame:
    """A frame at a shift when its middle row is read, whose acceleration along the columns differs by `jerk`."""
    view, random = registrar.view(), np.random.default_rng(int(10 * jerk) + 1000)
    row, col = np.indices(view.image.shape, dtype=np.float32)
    periods = (row - GRID.centre[0]) / ROWS_PER_FRAME
    col_shift = (82 + shift[1] + jerk * periods**2 / 2).astype(np.float32)
    view.image[:] = cv2.remap(scene, col + col_shift, row + 82 + shift[0], cv2.INTER_CUBIC)
    view.image[:] += cv2.GaussianBlur(random.normal(0, 1, view.image.shape).astype(np.float32), (0, 0), 1.0)
    return registrar.prepare(view)


@pytest.mark.parametrize("jerk", [40.0, -35.0])
def test_the_displacement_of_the_middle_rows_is_right_though_the_acceleration_changed(jerk: float) -> None:
    registrar, scene = Registrar(GRID), tissue(3)
    frames = [read_while_moving(registrar, scene, *at) for at in (((0.0, 0.0), 0.0), (MOVED, jerk))]
    motion = about(GRID.shutter, Warp(b=-MOVED[0], d=-MOVED[1]), 1e-3)
    link = registrar.register(*frames, motion)
    evened = registrar.evened(*frames, motion, link, 30.0)
    assert evened is not None
    error, left = (float(np.hypot(warp.b + MOVED[0], warp.d + MOVED[1])) for warp in (link.warp, evened.warp))
    assert error > 0.4
    assert left < 0.05
    assert left < 4 * evened.sigma + 0.02


def test_far_from_the_middle_rows_an_unknown_acceleration_adds_to_their_uncertainty() -> None:
    registrar, scene = Registrar(GRID), np.zeros((400, 400), np.float32)
    cv2.line(scene, (150, 120), (250, 135), 60.0, 5, cv2.LINE_AA)
    frames = [read_while_moving(registrar, scene, (0.0, 0.0), jerk) for jerk in (0.0, 0.1)]
    motion = about(GRID.shutter, Warp(), 1e-3)
    link = registrar.register(*frames, motion)
    loose, tight = (registrar.evened(*frames, motion, link, sigma) for sigma in (60.0, 1e-3))
    assert loose is not None
    assert tight is not None
    assert loose.sigma > 1.2 * tight.sigma


def tracked(at: np.ndarray, state: TrackingState = TrackingState.TRACKED) -> list[Pose]:
    return [Pose(0, z.real, z.imag, Velocity(0.0, 0.0), 0.9, 0.1, state) for z in at.tolist()]


def test_the_shift_of_frames_whose_acceleration_changed_is_that_of_their_mean_places() -> None:
    registrar, scene = Registrar(GRID), tissue(5)
    accelerations = 0.0, 8.0
    frames = [read_while_moving(registrar, scene, MOVED, acceleration) for acceleration in accelerations]
    link = registrar.register(*frames, about(GRID.shutter, Warp(), 1e-3))
    steady = np.arange(5.0) ** 2 / 2
    shifts = [mean_shifts(tracked(1j * a * steady), GRID, {})[2] for a in accelerations]
    assert -link.warp.d == pytest.approx((shifts[1] - shifts[0]).imag, rel=0.15)
    assert abs(link.warp.b) < 0.01


def test_accelerations_count_lost_frames_and_go_on_at_the_ends_of_a_segment() -> None:
    times = np.array([0, 1, 2, 5, 6, 7])
    bend = (0.8 * GRID.diameter / ROWS_PER_FRAME) ** 2 / 32
    steady = mean_shifts(tracked((3 - 2j) * times**2 / 2), GRID, {3: 2})
    assert steady == pytest.approx(np.full(6, bend * (3 - 2j)))
    growing = mean_shifts(tracked((0.4 + 0.1j) * np.arange(6.0) ** 3 / 6), GRID, {})
    assert growing == pytest.approx(bend * (0.4 + 0.1j) * np.arange(6))


def test_short_segments_and_frames_read_at_once_have_no_shift() -> None:
    assert mean_shifts(tracked(np.array([0, 5 + 2j])), GRID, {}).tolist() == [0, 0]
    at_once = replace(GRID, shutter=RollingShutter(np.inf))
    assert not mean_shifts(tracked(np.arange(4.0) ** 2 + 0j), at_once, {}).any()


def test_positions_become_those_at_the_times_of_the_middle_rows() -> None:
    truth = 30 * np.arange(8) + (0.5 + 0.8j) * np.arange(8.0) ** 3
    bend = WITHIN_FRAMES * (0.8 * GRID.diameter / ROWS_PER_FRAME) ** 2 / 32
    poses = tracked(truth + bend * 6 * (0.5 + 0.8j) * np.arange(8))
    poses[3] = poses[3]._replace(state=TrackingState.PREDICTED)
    lost = poses[-1].lost
    found = at_middle_rows([*poses, lost], GRID, {})
    errors = np.array([pose.at for pose in found[:8]]) - truth
    assert np.abs(errors).max() < 0.02
    assert np.abs(np.array([pose.at for pose in poses]) - truth).max() > 0.25
    assert found[0].at == 0
    assert found[8] is lost


def test_registrations_by_the_middle_rows_alone_are_moved_to_the_mean_places() -> None:
    poses = tracked(2j * np.arange(5.0) ** 3)
    registrations = [PairRegistration(Warp(), np.eye(4), 0.9, 1.0, evened=evened) for evened in (False, True)]
    links = [TrackedPair(1, 2, Displacement(0.0, 14.0), registration) for registration in registrations]
    even, moved = of_mean_places(links, poses, GRID, {})
    assert even is links[0]
    bend = (0.8 * GRID.diameter / ROWS_PER_FRAME) ** 2 / 32
    assert moved.displacement == pytest.approx((0.0, 14.0 + 12 * WITHIN_FRAMES * bend))
