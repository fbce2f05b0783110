from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Velocity
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, TrackedPair
from napari_elsplus.processing.tracking.registration.shutter_timing import estimate_line_periods_per_frame
from napari_elsplus.workflows.sectioning import RawPairs
from napari_elsplus.workflows.tracked_stack import with_timing
from recordings import record, smooth_path, texture

TRUE = RollingShutter(272.4)


def links(velocities: np.ndarray, noise: float = 3e-4, seed: int = 0) -> list[TrackedPair]:
    """Links of a probe with these velocities, their stretch and shear known to so much."""
    rng = np.random.default_rng(seed)
    found = []
    for k, (before, after) in enumerate(pairwise(velocities)):
        step = TRUE.step(Velocity(*before), Velocity(*after))
        warp = TRUE.warp(Velocity(*before), Velocity(*after), step)
        warp = warp._replace(a=warp.a + rng.normal(0, noise), s=warp.s + rng.normal(0, noise))
        found.append(TrackedPair(k, k + 1, step, PairRegistration(warp, 1e4 * np.eye(4), 0.99, 0.9, 50.0)))
    return found


@pytest.mark.parametrize("assumed", [200.0, 272.4, 400.0])
def test_accelerations_tell_the_rows_per_frame_whatever_was_assumed(assumed: float) -> None:
    t = np.arange(80) * 0.12
    found = estimate_line_periods_per_frame(
        links(np.stack([25 * np.sin(t), 20 * np.cos(1.3 * t)], 1)), RollingShutter(assumed)
    )
    assert found is not None
    assert abs(found.rows - 272.4) < 4 * found.sigma
    assert found.sigma < 4


def test_even_motion_and_short_tracks_tell_nothing() -> None:
    even = np.tile([20.0, 10.0], (80, 1))
    assert estimate_line_periods_per_frame(links(even), TRUE) is None
    assert estimate_line_periods_per_frame(links(even[:5]), TRUE) is None


def test_links_whose_stretch_the_timing_told_tell_nothing_of_it() -> None:
    t = np.arange(80) * 0.12
    found = links(np.stack([25 * np.sin(t), 20 * np.cos(1.3 * t)], 1))
    assert estimate_line_periods_per_frame(found, TRUE) is not None
    little = [link._replace(registration=link.registration._replace(information=10 * np.eye(4))) for link in found]
    assert estimate_line_periods_per_frame(little, TRUE) is None


def test_links_across_lost_frames_tell_nothing_of_the_timing() -> None:
    t = np.arange(80) * 0.12
    found = links(np.stack([25 * np.sin(t), 20 * np.cos(1.3 * t)], 1))
    assert estimate_line_periods_per_frame([link._replace(periods=2) for link in found], TRUE) is None


def untimed(speed: float) -> tuple[float | None, str]:
    """Rows per frame (250) that a recording gives back whose calibration does not know them, and what is said."""
    truth = record(texture(1200, 8, 3.0), smooth_path(50, speed, 1200, 3))
    assert truth.calibration.optics is not None
    unknown = truth.calibration.optics.model_copy(update={"line_periods_per_frame": None})
    calibration = truth.calibration.model_copy(update={"optics": unknown})
    found, said = with_timing(calibration, RawPairs(truth.frames, "els"), "els")
    assert found.optics is not None
    return found.optics.line_periods_per_frame, said


def test_a_fast_recording_gives_back_its_rows_per_frame() -> None:
    rows, said = untimed(33.0)
    assert rows is not None
    assert abs(rows - 250) < 2.5
    assert said == f"rows per frame estimated from the motion: {rows:.1f} +- {said.split()[-1]}"
    assert abs(rows - 250) < 3 * float(said.split()[-1])


def test_a_slow_recording_leaves_the_rolling_shutter_uncorrected_and_says_so() -> None:
    rows, said = untimed(1.0)
    assert rows is None
    assert "the rolling shutter is not corrected" in said
