from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from napari_elsplus.processing.motion import RollingShutter, Velocity
from napari_elsplus.processing.registration import Link
from napari_elsplus.processing.shutter_timing import estimate_rows_per_frame

TRUE = RollingShutter(272.4, 0.48)


def links(velocities: np.ndarray, noise: float = 3e-4, seed: int = 0) -> list:
    """Links of a probe with these velocities, their stretch and shear known to so much."""
    rng = np.random.default_rng(seed)
    found = []
    for k, (before, after) in enumerate(pairwise(velocities)):
        step = TRUE.step(Velocity(*before), Velocity(*after))
        warp = TRUE.warp(Velocity(*before), Velocity(*after), step)
        warp = warp._replace(a=warp.a + rng.normal(0, noise), s=warp.s + rng.normal(0, noise))
        found.append((k, k + 1, step, Link(warp, np.eye(4), 0.99, 0.9, 1.0)))
    return found


@pytest.mark.parametrize("assumed", [200.0, 272.4, 400.0])
def test_accelerations_tell_the_rows_per_frame_whatever_was_assumed(assumed: float) -> None:
    t = np.arange(80) * 0.12
    found = estimate_rows_per_frame(
        links(np.stack([25 * np.sin(t), 20 * np.cos(1.3 * t)], 1)), RollingShutter(assumed, 0.48)
    )
    assert found is not None
    assert abs(found.rows - 272.4) < 4 * found.sigma
    assert found.sigma < 4


def test_even_motion_and_short_tracks_tell_nothing() -> None:
    even = np.tile([20.0, 10.0], (80, 1))
    assert estimate_rows_per_frame(links(even), TRUE) is None
    assert estimate_rows_per_frame(links(even[:5]), TRUE) is None
