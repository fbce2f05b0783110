"""What stands still in the view does not hold the track of a finished recording, nor is tissue at rest taken for it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from benchmarks.rigs.simulated import simulated_rig
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.tracking.finished.field import FinishedField
from napari_elsplus.processing.tracking.finished.tracking import FinishedTracking
from napari_elsplus.processing.tracking.methods import RegistrationTracking
from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter
from napari_elsplus.processing.tracking.registration.pair_registration import Registrar
from napari_elsplus.processing.tracking.standing_pattern import without_standing_pattern

if TYPE_CHECKING:
    from collections.abc import Iterable

    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.methods import TrackingMethod
    from napari_elsplus.processing.tracking.motion.pose import Pose

FRAMES = 80


def raw_tracking() -> RegistrationTracking:
    """Return the tracking of raw frames of the simulated rig."""
    rig = simulated_rig()
    return RegistrationTracking(rig.calibration, rig.instrument.frame_shape, Mode.ELS)


def circling(px: float) -> np.ndarray:
    """Return positions (T, 2) of a probe that moves so many pixels a frame along a bent path."""
    angle = np.linspace(0.3, 6.0, FRAMES)
    return px * np.cumsum(np.stack([np.sin(angle), np.cos(angle)], axis=1), axis=0)


def seen(grid: Grid, positions: np.ndarray, seed: int, px: float = 7.0) -> np.ndarray:
    """Return images (T, n, n) of tissue, smooth within so many pixels, by a rolling shutter, with noise."""
    random = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(random.standard_normal((900, 900)).astype(np.float32), (0, 0), px)
    tissue, images = np.exp(0.35 * noise / noise.std()), []
    y, x = (np.arange(grid.side) - centre for centre in grid.centre)
    times = np.arange(len(positions))
    for k in times:
        read = k + y / grid.shutter.line_periods_per_frame
        at = [np.interp(read, times, axis) + 450 for axis in positions.T]
        rows, cols = np.broadcast_arrays((at[0] + y)[:, None], at[1][:, None] + x)
        image = 50 * cv2.remap(tissue, cols.astype(np.float32), rows.astype(np.float32), cv2.INTER_CUBIC)
        grain = cv2.GaussianBlur(random.standard_normal(image.shape).astype(np.float32), (0, 0), 1)
        images.append((image + 2 * grain) * disc(grid))
    return np.array(images, np.float32)


def disc(grid: Grid) -> np.ndarray:
    """Return the lit pixels (n, n)."""
    return distance(grid, 0, 0) < grid.diameter / 2


def distance(grid: Grid, row: float, col: float) -> np.ndarray:
    """Return the distance (n, n) from a point that is so far from the centre."""
    y, x = (np.arange(grid.side) - centre for centre in grid.centre)
    return np.hypot(y[:, None] - row, x - col)


def ring(grid: Grid, images: np.ndarray) -> np.ndarray:
    """Return images with a ring three times as bright as the tissue."""
    shape = np.exp(-(((distance(grid, 10, -15) - 0.17 * grid.diameter) / 3) ** 2))
    return (images + 150 * shape * disc(grid)).astype(np.float32)


def shadow(grid: Grid, images: np.ndarray) -> np.ndarray:
    """Return images of which half is dark."""
    y = np.arange(grid.side) - grid.centre[0]
    return (images * (0.1 + 0.9 / (1 + np.exp(-y / 2)))[:, None]).astype(np.float32)


def refined(tracking: TrackingMethod, images: np.ndarray) -> list[Pose]:
    """Return the poses of the finished track."""
    return tracking.refine([tracking.estimate_pose(image) for image in images], images.__getitem__)


def step_errors(poses: list[Pose], positions: np.ndarray) -> np.ndarray:
    """Return the errors of steps between successive frames of one segment."""
    pairs = [
        k
        for k in range(1, len(poses))
        if poses[k].segment == poses[k - 1].segment and {poses[k].state, poses[k - 1].state} == {TrackingState.TRACKED}
    ]
    at = np.array([(pose.row, pose.col) for pose in poses])
    return np.array([np.hypot(*(at[k] - at[k - 1] - positions[k] + positions[k - 1])) for k in pairs])


@pytest.mark.parametrize("seed", [1, 2])
def test_a_bright_ring_that_stands_still_does_not_hold_the_track(seed: int) -> None:
    tracking, positions = raw_tracking(), circling(8.0)
    images = ring(tracking.grid, seen(tracking.grid, positions, seed))
    errors = step_errors(refined(tracking, images), positions)
    assert len(errors) > 0.9 * (FRAMES - 1)
    assert errors.max() < 1


def test_a_second_pass_reports_its_progress_and_can_be_ended() -> None:
    grid, positions = replace(raw_tracking().grid, shutter=RollingShutter(np.inf)), circling(8.0)
    images = ring(grid, seen(grid, positions, 1))
    field = FinishedField.of(list(images))
    raw, finished = raw_tracking(), FinishedTracking(field)
    for tracking, windows in ((raw, images), (finished, np.array([field.window(image) for image in images]))):
        poses, steps = [tracking.estimate_pose(image) for image in windows], list[tuple[str, int]]()

        def progress(numbers: Iterable[int], step: str, /, steps: list[tuple[str, int]] = steps) -> Iterable[int]:
            steps.append((step, len(list(numbers))))
            return numbers

        def ended(numbers: Iterable[int], step: str, /) -> Iterable[int]:
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            tracking.refine(poses, windows.__getitem__, progress=ended)
        tracking.refine(poses, windows.__getitem__, progress=progress)
        assert steps == [("Tracking again, without what stands still", FRAMES)]


@pytest.mark.parametrize("seed", [1, 2])
def test_along_the_edge_of_a_shadow_no_step_is_wrong(seed: int) -> None:
    tracking, positions = raw_tracking(), circling(8.0)
    images = shadow(tracking.grid, seen(tracking.grid, positions, seed))
    errors = step_errors(refined(tracking, images), positions)
    assert len(errors) > 0.2 * (FRAMES - 1)
    assert errors.max() < 2


def test_the_edge_of_a_shadow_does_not_hold_the_track_of_finished_images() -> None:
    grid, positions = replace(raw_tracking().grid, shutter=RollingShutter(np.inf)), circling(8.0)
    images = shadow(grid, seen(grid, positions, 3))
    field = FinishedField.of(list(images))
    tracking = FinishedTracking(field)
    errors = step_errors(refined(tracking, np.array([field.window(image) for image in images])), positions)
    assert len(errors) == FRAMES - 1
    assert errors.max() < 2


def test_light_that_falls_towards_the_rim_does_not_hold_the_track_of_finished_images() -> None:
    grid, positions = replace(raw_tracking().grid, shutter=RollingShutter(np.inf)), circling(12.0)
    vignette = 1 - 0.5 * (distance(grid, 0, 0) / (grid.diameter / 2)) ** 2
    images = (seen(grid, positions, 7, px=11.0) * vignette).astype(np.float32)
    field = FinishedField.of(list(images))
    tracking = FinishedTracking(field)
    errors = step_errors(refined(tracking, np.array([field.window(image) for image in images])), positions)
    assert len(errors) == FRAMES - 1
    assert np.median(errors) < 0.1


def test_tissue_over_which_the_probe_rests_is_tracked_as_it_is() -> None:
    tracking, positions = raw_tracking(), circling(0.03)
    errors = step_errors(refined(tracking, seen(tracking.grid, positions, 4)), positions)
    assert len(errors) == FRAMES - 1
    assert np.median(errors) < 0.02


def test_the_pattern_is_taken_out_in_proportion_to_the_light_of_a_frame() -> None:
    grid = raw_tracking().grid
    images = ring(grid, seen(grid, circling(8.0), 5))
    images[20], images[21], images[22] = 0, images[23] / 2, images[23]
    without = without_standing_pattern(images.__getitem__, Registrar(grid), FRAMES)
    assert without is not None
    assert not without(20).any()
    np.testing.assert_allclose(without(21), without(22) / 2, atol=1e-3)
    around = (abs(distance(grid, 10, -15) - 0.17 * grid.diameter) < 2) & disc(grid)
    ring_left = np.mean([without(k)[around].mean() - without(k)[disc(grid)].mean() for k in range(30, FRAMES)])
    assert abs(ring_left) < 0.05 * 150


def test_few_frames_or_little_that_stands_still_give_no_pattern() -> None:
    grid = raw_tracking().grid
    images = seen(grid, circling(8.0), 6)
    assert without_standing_pattern(images.__getitem__, Registrar(grid), 6) is None
    noise = np.random.default_rng(7).standard_normal(images.shape).astype(np.float32) * disc(grid)
    assert without_standing_pattern(noise.__getitem__, Registrar(grid), FRAMES) is None
