from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, RollingShutter, Velocity
from napari_elsplus.processing.tracking.pose_graph.refinement import (
    settle,
    with_origins,
    within_segments,
    without_jolts,
)
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, TrackedPair

SHUTTER = RollingShutter(300.0)
STEADY = Velocity(12.0, -5.0)
LOST = Pose(0, np.nan, np.nan, Velocity(np.nan, np.nan), np.nan, np.nan, TrackingState.LOST)


def test_the_origin_of_a_later_segment_lies_its_displacement_before_the_next_frame() -> None:
    """A segment begins at the frame after its origin, which itself had no place while frames came."""
    moved = Displacement(*STEADY)
    link = PairRegistration(SHUTTER.warp(STEADY, STEADY, moved), np.eye(4), 0.98, 0.9, 1.0)
    first = Pose(1, 0.0, 0.0, STEADY, 0.98, 0.1, TrackingState.TRACKED)
    poses = with_origins([LOST, LOST, first], [TrackedPair(1, 2, moved, link)], SHUTTER)
    assert poses[1].state is TrackingState.TRACKED
    np.testing.assert_allclose((poses[2].row - poses[1].row, poses[2].col - poses[1].col), moved)
    np.testing.assert_allclose(poses[1].velocity, STEADY, atol=1e-9)


def test_the_origin_of_a_segment_of_a_probe_that_rotates_has_an_angle() -> None:
    moved = Displacement(*STEADY)
    link = PairRegistration(SHUTTER.warp(STEADY, STEADY, moved), np.eye(4), 0.98, 0.9, turn=0.02, turn_sigma=1e-3)
    first = Pose(0, 0.0, 0.0, STEADY, 0.98, 0.1, TrackingState.TRACKED, angle=np.pi / 2)
    origin, _ = with_origins([LOST, first], [TrackedPair(0, 1, moved, link)], SHUTTER)
    assert origin.angle == np.pi / 2 - 0.02
    np.testing.assert_allclose((origin.row, origin.col), (moved.col, -moved.row))


@pytest.mark.parametrize(
    ("begins", "odds", "stands"),
    [((2, 3), 40.0, True), ((3, 4), 40.0, False), ((4, 5), 40.0, False), ((5, 6), 40.0, True), ((4, 5), 400.0, True)],
    ids=["goes on", "after a jolt", "the first was jolted, too", "later", "sure"],
)
def test_a_segment_does_not_begin_with_a_frame_that_may_have_been_jolted(
    begins: tuple[int, int], odds: float, stands: bool
) -> None:
    """Frames 0 to 2 are tracked, and a registration that begins another segment is withdrawn where that comes soon."""
    moved = Displacement(*STEADY)
    found = PairRegistration(SHUTTER.warp(STEADY, STEADY, moved), np.eye(4), 0.98, 0.9, 40.0)
    before = [TrackedPair(k, k + 1, moved, found) for k in range(2)]
    start = TrackedPair(*begins, moved, found._replace(odds=odds))
    follows = TrackedPair(begins[1], begins[1] + 1, moved, found)
    kept = without_jolts([*before, start, follows])
    assert kept == [*before, *([start] if stands else []), follows]


def test_a_frame_that_is_registered_to_a_lost_one_alone_is_lost() -> None:
    """A jolt within it and the frame before: the registration is sure, but of the middle of neither."""
    moved = Displacement(*STEADY)
    found = PairRegistration(SHUTTER.warp(STEADY, STEADY, moved), np.eye(4), 0.98, 0.9, 700.0)
    links = [TrackedPair(k, k + 1, moved, found) for k in (0, 1, 3, 5)]
    tracked = Pose(0, 0.0, 0.0, STEADY, 0.98, 0.1, TrackingState.TRACKED)
    poses = [tracked, tracked, tracked, LOST, tracked._replace(segment=1), *2 * [tracked._replace(segment=2)]]
    within = within_segments(poses, links)
    assert within == [*links[:2], links[3]]
    states = [pose.state is TrackingState.TRACKED for pose in settle(poses, within)]
    assert states == [True, True, True, False, False, True, True]
