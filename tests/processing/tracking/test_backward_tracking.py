from __future__ import annotations

import numpy as np

from benchmarks.studies.acceptance import Row, TruePath, grid_of, recorded
from napari_elsplus.processing.tracking.backward_tracking import completed, reversed_registration
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Warp
from napari_elsplus.processing.tracking.pose_graph.refinement import borne_out, located, without_jolts
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, Registrar
from napari_elsplus.processing.tracking.tracker import Tracker
from tests.processing.tracking.test_standing_pattern import raw_tracking, refined, seen, step_errors

LINK = PairRegistration(Warp(1.03, -21.0, 0.02, 8.0), np.diag([4e4, 30.0, 5e4, 20.0]) + 1.0, 0.98, 0.9, 40.0)


def test_a_reversed_warp_takes_mirrored_pixels_of_the_later_frame_to_the_earlier_one() -> None:
    a, b, s, d = LINK.warp
    back = reversed_registration(LINK).warp
    y, x = np.array([-70.0, 3.0, 55.0]), np.array([12.0, -40.0, 81.0])
    later_y, later_x = a * y + b, x + s * y + d
    np.testing.assert_allclose(back.a * -later_y + back.b, -y)
    np.testing.assert_allclose(later_x + back.s * -later_y + back.d, x)


def test_the_information_of_a_reversed_registration_is_that_of_its_own_warp() -> None:
    """By slopes taken as differences; and twice reversed it is the same."""
    back, step = reversed_registration(LINK), 1e-6
    changed = [
        reversed_registration(LINK._replace(warp=Warp(*(np.array(LINK.warp) + step * axis)))).warp for axis in np.eye(4)
    ]
    slopes = (np.array(changed) - np.array(back.warp)).T / step
    covariance = slopes @ np.linalg.inv(LINK.information) @ slopes.T
    np.testing.assert_allclose(np.linalg.inv(back.information), covariance, rtol=1e-4, atol=1e-9)
    again = reversed_registration(back)
    np.testing.assert_allclose(again.warp, LINK.warp)
    np.testing.assert_allclose(again.information, LINK.information, rtol=1e-6, atol=1e-6)


def test_a_grid_upside_down_has_the_pixels_of_the_images_upside_down() -> None:
    grid = Grid(116, 2, (0, 0), (55.3, 58.1), 108.0, RollingShutter(150.0), (9, 110, 4, 116), 3.5)
    for upright, turned in zip(grid.spans(), grid.upside_down().spans(), strict=True):
        np.testing.assert_array_equal(turned, upright[::-1])


def test_of_frames_that_show_nothing_none_is_tracked_backwards() -> None:
    grid = Grid(116, 2, (0, 0), (57.5, 57.5), 108.0, RollingShutter(150.0))
    tracker, dark = Tracker(Registrar(grid)), np.zeros((116, 116), np.float32)
    poses = []
    for _ in range(4):
        tracker.slot()[:] = dark
        poses.append(tracker.add())
    _, links = completed(poses, tracker, lambda _: dark)
    assert not links


def forwards(row: Row, seed: int) -> tuple[TruePath, Tracker, list[Pose]]:
    """Return a recording of the acceptance study, the tracker that has seen all of it, and the poses."""
    recording, tracker, poses = recorded(row, seed=seed), Tracker(Registrar(grid_of(row))), []
    for image in recording.images:
        tracker.slot()[:] = image
        poses.append(tracker.add())
    return recording, tracker, poses


def test_frames_lost_before_a_segment_are_tracked_from_it_backwards_and_join_it_with_the_one_before() -> None:
    recording, tracker, poses = forwards(Row(60, "hand", 20.0), 2004)
    grid = tracker.grid
    alone = without_jolts(borne_out(poses, tracker.links))
    before = located(poses, alone, grid.shutter)
    after, links = completed(poses, tracker, recording.images.__getitem__)
    tracked = [[pose for pose in found if pose.state is TrackingState.TRACKED] for found in (before, after)]
    assert len(tracked[1]) >= len(tracked[0]) + 3
    assert len({pose.segment for pose in tracked[1]}) < len({pose.segment for pose in tracked[0]})
    assert len(links) > len(alone)
    true = recording.positions
    for earlier, later, moved, *_ in links:
        a, b = after[earlier], after[later]
        assert grid.binning * np.hypot(*(np.array(moved) - true[later] + true[earlier])) < 2.0
        if a.segment == b.segment:
            step = np.array([b.row - a.row, b.col - a.col])
            assert grid.binning * np.hypot(*(step - true[later] + true[earlier])) < 2.0


def test_a_jolt_within_the_first_frame_after_it_leaves_no_wrong_registration() -> None:
    """Fibres were in view of rows read after the jolt only: by them the frame's middle was 22 px off."""
    recording, tracker, poses = forwards(Row(60, "jolted", 240.0), 3002)
    grid = tracker.grid
    after, links = completed(poses, tracker, recording.images.__getitem__)
    misses = [np.subtract(moved, np.diff(recording.positions[[a, b]], axis=0)[0]) for a, b, moved, *_ in links]
    assert grid.binning * np.hypot(*np.transpose(misses)).max() < 3.0
    assert sum(pose.state is TrackingState.TRACKED for pose in after) > 25


def test_a_jolt_within_the_last_frame_leaves_no_wrong_registration() -> None:
    """It lies within the frame before as well; backwards the two came first, compared with none: 19 px off."""
    tracking, frames = raw_tracking(), np.arange(24)
    positions = np.stack([4.0 * frames, -3.0 * frames], axis=1)
    positions[18:] += 0.0, 85.0
    positions[23] += -85.0, -17.0
    poses = refined(tracking, seen(tracking.grid, positions, seed=0, px=3.0))
    errors = step_errors(poses, positions)
    assert len(errors) >= 16
    assert errors.max() < 1
    assert poses[23].state is TrackingState.LOST
