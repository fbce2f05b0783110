from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior
from napari_elsplus.processing.tracking.motion.prediction import Motion
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, RollingShutter, Velocity
from napari_elsplus.processing.tracking.registration.lucas_kanade import Workspace
from napari_elsplus.processing.tracking.registration.pyramid_descent import later_velocity

SHUTTER = RollingShutter(280.0)
WORK = Workspace.of(16)


def walked(motion: Motion, seed: int, frames: int) -> tuple[Velocity, Displacement, Velocity]:
    """Velocities and displacement of a random walk of the velocity from where the motion is believed to be."""
    rng = np.random.default_rng(seed)
    steps = 64 * frames
    before = np.array(motion.velocity) + rng.normal(0, motion.variance**0.5, 2)
    velocity = before + np.cumsum(rng.normal(0, motion.spread / 64**0.5, (steps, 2)), axis=0)
    return Velocity(*before), Displacement(*velocity.sum(axis=0) / 64), Velocity(*velocity[-1])


def settled() -> Motion:
    motion = Motion(SHUTTER, 210.0)
    for _ in range(3):
        motion.follow(Velocity(9.0, -6.0), 0.04, successive=True)
    return motion


@pytest.mark.parametrize("frames", [1, 4])
def test_the_prior_is_that_of_a_random_walk(frames: int) -> None:
    motion = settled()
    prior = motion.prior(motion.ahead(frames), frames)
    truth = [walked(motion, seed, frames) for seed in range(2000)]
    rows = np.array([(before.row, moved.row, after.row) for before, moved, after in truth])
    assert np.abs(rows.mean(axis=0) - (9.0, 9.0 * frames, 9.0)).max() < 0.1 * prior.covariance[1][1] ** 0.5
    np.testing.assert_allclose(np.cov(rows.T), prior.covariance, rtol=0.12, atol=0.05 * prior.covariance[0][0])


@pytest.mark.parametrize("frames", [1, 4])
def test_the_velocity_follows_from_a_warp_as_well_as_its_variance_states(frames: int) -> None:
    motion = settled()
    prior = motion.prior(motion.ahead(frames), frames)
    errors, stated = [], []
    for seed in range(400):
        before, moved, after = walked(motion, seed, frames)
        warp = SHUTTER.warp(before, after, moved)
        row, col, variance = later_velocity(prior, warp, np.diag([1e7, 1e3, 1e7, 1e3]), WORK)
        errors.append((row - after.row, col - after.col))
        stated.append(variance)
    assert 0.7 < np.sqrt(np.mean(np.square(errors)) / np.mean(stated)) < 1.3


def test_stretch_and_shear_follow_the_shift() -> None:
    """A probe that was faster than expected has gained more velocity, half as much again as its mean."""
    motion = settled()
    motion.variance = 1e-6
    prior = motion.prior(motion.ahead(1), 1)
    _, slope, _ = prior.terms
    assert slope == pytest.approx(1.5 / SHUTTER.line_periods_per_frame, rel=1e-3)


def test_a_global_shutter_has_no_stretch() -> None:
    shutter = RollingShutter(np.inf)
    prior = MotionPrior.between((Velocity(3.0, 1.0),) * 2, Displacement(3.0, 1.0), (1.0, 1.0), 2.0, shutter)
    assert prior.terms[0] > 1e12
    row, col, variance = later_velocity(prior, shutter.warp(*prior[:3]), np.diag([1e18, 1e2, 1e18, 1e2]), WORK)
    assert (row, col) == pytest.approx((3.0, 1.0))
    assert np.isfinite(variance)


def test_a_shift_as_expected_is_more_probable_by_a_known_motion_than_by_an_unknown_one() -> None:
    known, unknown = settled(), Motion(SHUTTER, 210.0)
    narrow, wide = known.prior(known.ahead(1), 1), unknown.prior(Displacement(0.0, 0.0), 1)
    _, b, _, d = narrow.warp
    assert narrow.log_density(b, d) - wide.log_density(b, d) > 4
    assert narrow.log_density(b + 40.0, d) - wide.log_density(b + 40.0, d) < -4
